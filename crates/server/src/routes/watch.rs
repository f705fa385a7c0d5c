//! The live view, and the connection that lasts.

use super::route::{Route, Shared, file, route};
use crate::error::ApiError;
use crate::live::{Live, parts};
use crate::need::Need;
use crate::people::Caller;
use crate::socket;
use axum::Extension;
use axum::body::Body;
use axum::extract::{State, WebSocketUpgrade};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use std::sync::atomic::Ordering;
use std::time::Duration;

pub(super) fn routes() -> Vec<Route> {
    use Need::View;
    vec![
        route("GET", "/api/v1/frame.jpg", View, get(frame)),
        route("GET", "/api/v1/stream.mjpg", View, get(stream)),
        route("GET", "/api/v1/live", View, get(live)),
    ]
}

/// How long one who asks for a frame waits for it.
const FRAME: Duration = Duration::from_secs(5);

async fn frame(State(app): Shared) -> Result<Response, ApiError> {
    let mut watching = Live::watch(&app.live);
    watching.frames.mark_unchanged();
    let _ = tokio::time::timeout(FRAME, watching.frames.changed()).await;
    let newest = watching.frames.borrow().clone();
    let none = || {
        let message = "the camera shows nothing now";
        ApiError::conflict("no_frame", message)
    };
    let newest = newest.filter(|newest| newest.since.elapsed() < 2 * FRAME);
    Ok(file("image/jpeg", newest.ok_or_else(none)?.jpeg.clone()))
}

/// Frames as browsers and cameras of the network have shown them for thirty years.
async fn stream(State(app): Shared) -> Response {
    let watching = Live::watch(&app.live);
    let parts = parts(watching);
    let kind = "multipart/x-mixed-replace; boundary=frame";
    (
        [(header::CONTENT_TYPE, HeaderValue::from_static(kind))],
        Body::new(parts),
    )
        .into_response()
}

async fn live(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Result<Response, ApiError> {
    let upgrade = upgrade.map_err(|e| ApiError::input(e.to_string()))?;
    if app.ends.load(Ordering::SeqCst) {
        let message = "the server is ending";
        return Err(ApiError::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "ending",
            message,
        ));
    }
    let place = app.socket_place(&caller)?;
    let upgrade = upgrade.max_message_size(64 << 10).max_frame_size(64 << 10);
    Ok(upgrade.on_upgrade(move |socket| async move {
        socket::serve(app, caller, socket).await;
        drop(place);
    }))
}
