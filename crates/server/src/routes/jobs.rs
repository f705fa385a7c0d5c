//! Jobs, and what they ask.

use super::route::{Answer, Named, Route, Shared, aside, body, route};
use crate::asked::{JobRequest, Wish};
use crate::error::ApiError;
use crate::need::Need;
use crate::people::Caller;
use crate::starting;
use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Extension, Json};
use serde::Deserialize;
use serde_json::{Value, json};
use std::sync::atomic::Ordering;

pub(super) fn routes() -> Vec<Route> {
    use Need::{Move, View};
    vec![
        route("GET", "/api/v1/jobs", View, get(jobs)),
        route("POST", "/api/v1/jobs", Move, post(start)),
        route("GET", "/api/v1/jobs/{id}", View, get(job)),
        route("POST", "/api/v1/jobs/{id}/stop", View, post(stop_job)),
        route("POST", "/api/v1/jobs/{id}/pause", View, post(pause_job)),
        route("POST", "/api/v1/jobs/{id}/resume", Move, post(resume_job)),
        route("POST", "/api/v1/abandon", Move, post(abandon)),
        route("POST", "/api/v1/questions/{id}", Move, post(answer)),
    ]
}

async fn jobs(State(app): Shared) -> Json<Value> {
    let all = app.desk.all();
    Json(all.iter().rev().map(|entry| entry.summary()).collect())
}

async fn start(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Result<Response, ApiError> {
    let stops = app.stops.load(Ordering::SeqCst);
    let asked: JobRequest = body(request).await?;
    let id = aside(&app, move |app| {
        app.desk.is_free()?;
        let wish = Wish::of(&app.bench, asked)?;
        starting::start(app, &caller, wish, stops)
    });
    let id = id.await?;
    Ok((StatusCode::ACCEPTED, Json(json!({"id": id}))).into_response())
}

async fn job(State(app): Shared, Named(id): Named<u64>) -> Answer {
    Ok(Json(app.desk.one(id)?.whole()))
}

async fn stop_job(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    Named(id): Named<u64>,
) -> Answer {
    let entry = app.desk.one(id)?;
    let told = aside(&app, move |app| {
        app.stops.fetch_add(1, Ordering::SeqCst);
        let told = entry.handle.stop();
        app.audit
            .noted(&caller, "stopped a job", json!({"id": id}))?;
        told?;
        Ok(entry.whole())
    });
    Ok(Json(told.await?))
}

async fn pause_job(State(app): Shared, Named(id): Named<u64>) -> Answer {
    let entry = app.desk.one(id)?;
    entry.handle.pause();
    Ok(Json(entry.whole()))
}

async fn resume_job(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    Named(id): Named<u64>,
) -> Answer {
    let entry = app.desk.one(id)?;
    let lease = app.seat.take(&caller)?;
    entry.handle.resume(&lease)?;
    Ok(Json(entry.whole()))
}

async fn abandon(State(app): Shared, Extension(caller): Extension<Caller>) -> Answer {
    aside(&app, move |app| {
        app.desk.is_free()?;
        app.seat.take(&caller)?;
        app.bench.end_left()?;
        app.learn_left();
        app.audit
            .noted(&caller, "abandoned what was under way", Value::Null)
    })
    .await?;
    Ok(Json(json!({})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct YesNo {
    yes: bool,
}

async fn answer(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    Named(id): Named<u64>,
    request: Request,
) -> Answer {
    let YesNo { yes } = body(request).await?;
    let session = app.console.session();
    session.answer(scopeservo_station::QuestionId(id), yes)?;
    app.audit
        .noted(&caller, "answered", json!({"question": id, "yes": yes}))?;
    Ok(Json(json!({})))
}
