//! What all routes are made of.

use crate::app::App;
use crate::error::ApiError;
use crate::guard::Need;
use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::MethodRouter;
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::sync::Arc;

/// No body is larger, bytes.
const LARGEST_BODY: usize = 1 << 20;

pub(super) type Shared = State<Arc<App>>;
pub(super) type Answer = Result<Json<Value>, ApiError>;

/// One route.
pub(crate) struct Route {
    pub(crate) method: &'static str,
    pub(crate) path: &'static str,
    pub(crate) need: Need,
    pub(super) handler: MethodRouter<Arc<App>>,
}

pub(super) fn route(
    method: &'static str,
    path: &'static str,
    need: Need,
    handler: MethodRouter<Arc<App>>,
) -> Route {
    Route {
        method,
        path,
        need,
        handler,
    }
}

/// The body of a request; what is wrong with it is said.
pub(super) async fn body<T: DeserializeOwned>(request: Request) -> Result<T, ApiError> {
    let bytes = axum::body::to_bytes(request.into_body(), LARGEST_BODY).await;
    let bytes = bytes.map_err(|_| {
        let message = format!("what is sent has {LARGEST_BODY} bytes at the most");
        ApiError::new(StatusCode::PAYLOAD_TOO_LARGE, "too_large", message)
    })?;
    serde_json::from_slice(&bytes).map_err(|e| ApiError::input(format!("that cannot be read: {e}")))
}

/// What may wait for a device or a disk is done elsewhere.
pub(super) async fn aside<T: Send + 'static>(
    app: &Arc<App>,
    what: impl FnOnce(&Arc<App>) -> Result<T, ApiError> + Send + 'static,
) -> Result<T, ApiError> {
    let app = app.clone();
    let done = tokio::task::spawn_blocking(move || what(&app)).await;
    done.unwrap_or_else(|_| {
        Err(ApiError::fault(
            "a mistake of the program, told on its terminal",
        ))
    })
}

/// Bytes of a kind.
pub(super) fn file(kind: &'static str, bytes: Vec<u8>) -> Response {
    (
        [(header::CONTENT_TYPE, HeaderValue::from_static(kind))],
        bytes,
    )
        .into_response()
}
