//! The routes, each with what it needs of whoever asks. There is no other way in: the table is the router.

mod instrument;
mod jobs;
mod kept;
mod people;
mod pictures;
mod route;
mod watch;

pub(crate) use route::said;

use crate::app::App;
use crate::error::ApiError;
use crate::guard::{self, require};
use crate::need::Need;
use crate::page;
use axum::Router;
use axum::extract::{Path, Request};
use axum::http::StatusCode;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use route::{Route, file, route};
use std::sync::Arc;

/// All of them.
pub(crate) fn table() -> Vec<Route> {
    let own = vec![
        route("GET", "/api/v1/openapi.json", Need::Nobody, get(openapi)),
        route("GET", "/", Need::Nobody, get(async || page::asset(""))),
        route(
            "GET",
            "/{file}",
            Need::Nobody,
            get(async |Path(file): Path<String>| page::asset(&file)),
        ),
    ];
    let parts = [
        people::routes(),
        instrument::routes(),
        jobs::routes(),
        kept::routes(),
        pictures::routes(),
        watch::routes(),
    ];
    own.into_iter().chain(parts.into_iter().flatten()).collect()
}

/// Method, path and need of every route, for documents and tests.
pub fn routes() -> Vec<[&'static str; 3]> {
    let all = table().into_iter();
    all.map(|route| [route.method, route.path, route.need.word()])
        .collect()
}

/// The router of all routes, behind the guard.
pub(crate) fn router(app: &Arc<App>) -> Router {
    let all = table().into_iter();
    let router = all.fold(Router::new(), |router, route| {
        let need = route.need;
        let guarded = route.handler.layer(from_fn(move |request: Request, next| {
            require(need, request, next)
        }));
        router.route(route.path, guarded)
    });
    router
        .fallback(async || ApiError::missing("there is no such route").into_response())
        .method_not_allowed_fallback(async || {
            let message = "this route has no such method";
            ApiError::new(StatusCode::METHOD_NOT_ALLOWED, "method", message).into_response()
        })
        .layer(from_fn_with_state(app.clone(), guard::guard))
        .with_state(app.clone())
}

/// All routes for programs: OpenAPI 3.1. A test holds it to the table.
pub const OPENAPI: &str = include_str!("../openapi.json");

async fn openapi() -> Response {
    file("application/json", OPENAPI.into())
}
