//! Pictures under the demonstration's microscope.

use super::route::{Answer, Named, Route, Shared, Wanted, aside, route};
use crate::need::Need;
use crate::people::Caller;
use crate::pictures;
use axum::extract::{Request, State};
use axum::routing::{delete, get, put};
use axum::{Extension, Json};
use serde::Deserialize;
use serde_json::json;

pub(super) fn routes() -> Vec<Route> {
    use Need::{Operate, View};
    vec![
        route("GET", "/api/v1/pictures", View, get(all)),
        route("PUT", "/api/v1/pictures/{name}", Operate, put(bring)),
        route("DELETE", "/api/v1/pictures/{name}", Operate, delete(remove)),
    ]
}

async fn all(State(app): Shared) -> Answer {
    Ok(Json(aside(&app, |app| pictures::all(app)).await?))
}

#[derive(Deserialize)]
struct Scale {
    um_per_px: f64,
}

async fn bring(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    Named(name): Named<String>,
    Wanted(Scale { um_per_px }): Wanted<Scale>,
    request: Request,
) -> Answer {
    let ending = pictures::ending(request.headers())?;
    let named = name.clone();
    // What will not be kept need not come.
    aside(&app, move |app| pictures::may_come(app, &named, um_per_px)).await?;
    let _place = pictures::place(&app)?;
    let (head, body) = request.into_parts();
    let bytes = pictures::received(&app, &head.headers, body).await?;
    let kept = aside(&app, move |app| {
        pictures::keep(app, &caller, (&name, um_per_px), &bytes, ending)
    });
    Ok(Json(kept.await?))
}

async fn remove(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    Named(name): Named<String>,
) -> Answer {
    aside(&app, move |app| pictures::remove(app, &caller, &name)).await?;
    Ok(Json(json!({})))
}
