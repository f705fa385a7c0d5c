//! What is kept.

use super::route::{Answer, Named, Route, Shared, Wanted, aside, body, file, route};
use crate::error::ApiError;
use crate::kept;
use crate::need::Need;
use axum::Json;
use axum::extract::{Request, State};
use axum::http::{HeaderName, HeaderValue};
use axum::response::Response;
use axum::routing::{delete, get, patch};
use scopeservo_library::{RunQuery, TargetQuery};
use serde::Deserialize;
use serde_json::json;

/// So many runs at most in one answer.
const RUNS: usize = 500;

pub(super) fn routes() -> Vec<Route> {
    use Need::{Administer, Operate, View};
    vec![
        route("GET", "/api/v1/targets", View, get(targets)),
        route("GET", "/api/v1/targets/{name}", View, get(target)),
        route(
            "PATCH",
            "/api/v1/targets/{name}",
            Operate,
            patch(edit_target),
        ),
        route(
            "DELETE",
            "/api/v1/targets/{name}",
            Operate,
            delete(remove_target),
        ),
        route(
            "GET",
            "/api/v1/targets/{name}/image.png",
            View,
            get(target_picture),
        ),
        route(
            "GET",
            "/api/v1/targets/{name}/thumb.jpg",
            View,
            get(target_thumbnail),
        ),
        route("DELETE", "/api/v1/bin/{name}", Administer, delete(purge)),
        route("GET", "/api/v1/slides", View, get(slides)),
        route("GET", "/api/v1/calibrations", View, get(calibrations)),
        route("GET", "/api/v1/runs", View, get(runs)),
        route("GET", "/api/v1/runs/{id}", View, get(run)),
        route("PATCH", "/api/v1/runs/{id}", Operate, patch(edit_run)),
        route("GET", "/api/v1/runs/{id}/events", View, get(run_events)),
        route(
            "GET",
            "/api/v1/runs/{id}/report.html",
            View,
            get(run_report),
        ),
        route(
            "GET",
            "/api/v1/runs/{id}/arrival.jpg",
            View,
            get(run_arrival),
        ),
    ]
}

/// So many targets in one answer, unless fewer are asked for.
const TARGETS: usize = 500;

#[derive(Deserialize)]
struct Which {
    #[serde(default)]
    text: String,
    slide: Option<String>,
    limit: Option<usize>,
    after: Option<String>,
    after_number: Option<i64>,
    #[serde(default)]
    bin: bool,
    quality: Option<kept::Quality>,
}

async fn targets(State(app): Shared, Wanted(which): Wanted<Which>) -> Answer {
    let all = aside(&app, move |app| {
        let wanted = TargetQuery {
            text: &which.text,
            slide: which.slide.as_deref(),
            limit: which.limit.unwrap_or(TARGETS).clamp(1, TARGETS),
            after: which.after.as_deref(),
            after_number: which.after_number,
            binned: which.bin,
            chance: which.quality.map(kept::Quality::chance),
        };
        kept::targets(app, &wanted)
    });
    Ok(Json(all.await?))
}

async fn slides(State(app): Shared) -> Answer {
    Ok(Json(aside(&app, |app| kept::slides(app)).await?))
}

async fn purge(State(app): Shared, Named(name): Named<String>) -> Answer {
    Ok(Json(aside(&app, move |app| kept::purge(app, &name)).await?))
}

async fn target(State(app): Shared, Named(name): Named<String>) -> Answer {
    Ok(Json(
        aside(&app, move |app| kept::target(app, &name)).await?,
    ))
}

async fn edit_target(State(app): Shared, Named(name): Named<String>, request: Request) -> Answer {
    let edit: kept::Edit = body(request).await?;
    Ok(Json(
        aside(&app, move |app| kept::edit(app, &name, &edit)).await?,
    ))
}

async fn remove_target(State(app): Shared, Named(name): Named<String>) -> Answer {
    aside(&app, move |app| kept::remove(app, &name)).await?;
    Ok(Json(json!({})))
}

async fn target_picture(
    State(app): Shared,
    Named(name): Named<String>,
) -> Result<Response, ApiError> {
    let bytes = aside(&app, move |app| kept::picture(app, &name)).await?;
    Ok(file("image/png", bytes))
}

async fn target_thumbnail(
    State(app): Shared,
    Named(name): Named<String>,
) -> Result<Response, ApiError> {
    let bytes = aside(&app, move |app| kept::thumbnail(app, &name)).await?;
    Ok(file("image/jpeg", bytes))
}

async fn calibrations(State(app): Shared) -> Answer {
    Ok(Json(aside(&app, |app| kept::calibrations(app)).await?))
}

#[derive(Deserialize)]
struct Page {
    limit: Option<usize>,
    before: Option<String>,
    target: Option<String>,
}

async fn runs(State(app): Shared, Wanted(page): Wanted<Page>) -> Answer {
    let all = aside(&app, move |app| {
        let wanted = RunQuery {
            limit: page.limit.unwrap_or(50).clamp(1, RUNS),
            before: page.before.as_deref(),
            target: page.target.as_deref(),
        };
        kept::runs(app, &wanted)
    });
    Ok(Json(all.await?))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RunEdit {
    pinned: bool,
}

async fn edit_run(State(app): Shared, Named(id): Named<String>, request: Request) -> Answer {
    let RunEdit { pinned } = body(request).await?;
    Ok(Json(
        aside(&app, move |app| kept::pin(app, &id, pinned)).await?,
    ))
}

async fn run(State(app): Shared, Named(id): Named<String>) -> Answer {
    Ok(Json(aside(&app, move |app| kept::run(app, &id)).await?))
}

async fn run_events(State(app): Shared, Named(id): Named<String>) -> Result<Response, ApiError> {
    let bytes = aside(&app, move |app| kept::events(app, &id)).await?;
    Ok(file("application/json", bytes))
}

async fn run_arrival(State(app): Shared, Named(id): Named<String>) -> Result<Response, ApiError> {
    let bytes = aside(&app, move |app| kept::arrival(app, &id)).await?;
    Ok(file("image/jpeg", bytes))
}

/// A report is a page of its own that may run nothing.
async fn run_report(State(app): Shared, Named(id): Named<String>) -> Result<Response, ApiError> {
    let bytes = aside(&app, move |app| kept::report(app, &id)).await?;
    let policy = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'";
    let mut response = file("text/html; charset=utf-8", bytes);
    let headers = response.headers_mut();
    let name = HeaderName::from_static("content-security-policy");
    headers.insert(name, HeaderValue::from_static(policy));
    let name = HeaderName::from_static("x-frame-options");
    headers.insert(name, HeaderValue::from_static("SAMEORIGIN"));
    Ok(response)
}
