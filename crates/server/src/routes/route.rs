//! What all routes are made of.

use crate::app::App;
use crate::error::ApiError;
use crate::need::Need;
use axum::Json;
use axum::extract::{FromRequestParts, Path, Query, Request, State};
use axum::http::request::Parts;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::MethodRouter;
use serde::de::DeserializeOwned;
use serde::{Deserialize as _, Deserializer};
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

/// That something was said, if only that there is none.
pub(crate) fn said<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Option<String>>, D::Error> {
    Option::<String>::deserialize(from).map(Some)
}

/// The names in a path.
pub(super) struct Named<T>(pub(super) T);

impl<S: Send + Sync, T: DeserializeOwned + Send> FromRequestParts<S> for Named<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let named = Path::from_request_parts(parts, state).await;
        named
            .map(|Path(named)| Self(named))
            .map_err(|e| ApiError::input(e.body_text()))
    }
}

/// What follows the question mark.
pub(super) struct Wanted<T>(pub(super) T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for Wanted<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let wanted = Query::from_request_parts(parts, state).await;
        wanted
            .map(|Query(wanted)| Self(wanted))
            .map_err(|e| ApiError::input(e.body_text()))
    }
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
