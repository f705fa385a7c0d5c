//! The instrument: how it stands, who drives, light, and stop.

use super::route::{Answer, Route, Shared, aside, body, route, said};
use crate::error::ApiError;
use crate::look;
use crate::need::Need;
use crate::people::Caller;
use crate::pictures;
use crate::socket;
use axum::extract::{Request, State};
use axum::routing::{get, post};
use axum::{Extension, Json};
use serde::Deserialize;
use serde_json::{Value, json};
use std::time::{Duration, Instant};

pub(super) fn routes() -> Vec<Route> {
    use Need::{AllowElsewhere, Move, Operate, View};
    vec![
        route("GET", "/api/v1/instrument", View, get(instrument)),
        route("GET", "/api/v1/state", View, get(state)),
        route("POST", "/api/v1/stop", View, post(stop)),
        route("POST", "/api/v1/lease", Move, post(take_lease)),
        route("POST", "/api/v1/lease/ask", Move, post(ask_lease)),
        route("POST", "/api/v1/lease/give", Move, post(give_lease)),
        route(
            "POST",
            "/api/v1/elsewhere",
            AllowElsewhere,
            post(allow_elsewhere),
        ),
        route("POST", "/api/v1/exposure", Move, post(set_exposure)),
        route("POST", "/api/v1/light", Move, post(set_light)),
        route("POST", "/api/v1/slide", Operate, post(set_slide)),
        route("POST", "/api/v1/demo", Move, post(move_slide)),
    ]
}

async fn instrument(State(app): Shared) -> Answer {
    Ok(Json(aside(&app, |app| app.described()).await?))
}

async fn state(State(app): Shared, Extension(caller): Extension<Caller>) -> Json<Value> {
    Json(look::told(&app, &caller))
}

async fn stop(State(app): Shared, Extension(caller): Extension<Caller>) -> Answer {
    aside(&app, move |app| socket::stop(app, &caller)).await?;
    Ok(Json(json!({"stopped": true})))
}

async fn take_lease(State(app): Shared, Extension(caller): Extension<Caller>) -> Answer {
    app.seat.take(&caller)?;
    Ok(Json(json!({"owner": app.seat.owner()})))
}

async fn ask_lease(State(app): Shared, Extension(caller): Extension<Caller>) -> Answer {
    app.seat.ask(&caller);
    Ok(Json(
        json!({"owner": app.seat.owner(), "asked_by": app.seat.asked_by()}),
    ))
}

async fn give_lease(State(app): Shared, Extension(caller): Extension<Caller>) -> Answer {
    app.seat.give(&caller)?;
    Ok(Json(json!({"owner": app.seat.owner()})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Elsewhere {
    minutes: f64,
}

/// The longest time for which motion from other machines is allowed: a working day.
const LONGEST_MIN: f64 = 480.0;

async fn allow_elsewhere(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Answer {
    let Elsewhere { minutes } = body(request).await?;
    if !(0.0..=LONGEST_MIN).contains(&minutes) {
        return Err(ApiError::input("minutes is from 0, which ends it, to 480"));
    }
    let lasting = Duration::from_secs_f64(60.0 * minutes);
    *crate::lock(&app.elsewhere) = (minutes > 0.0).then(|| Instant::now() + lasting);
    app.audit.noted(
        &caller,
        "allowed motion from elsewhere",
        json!({"minutes": minutes}),
    )?;
    Ok(Json(json!({"minutes": minutes})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Exposure {
    ms: f64,
}

async fn set_exposure(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Answer {
    let Exposure { ms } = body(request).await?;
    let set = aside(&app, move |app| {
        app.seat.take(&caller)?;
        app.desk.is_free()?;
        let camera = app.bench.scope.camera();
        if !(ms > 0.0 && ms < 1e9) {
            return Err(ApiError::input("ms is a number above 0"));
        }
        let exposure = Duration::from_secs_f64(ms * 1e-3);
        camera.info().check_exposure(exposure)?;
        let set = camera.set_exposure(exposure)?;
        app.audit
            .noted(&caller, "set the exposure", json!({"ms": ms}))?;
        Ok(set.as_secs_f64() * 1e3)
    });
    Ok(Json(json!({"ms": set.await?})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LightLevel {
    level: f64,
}

async fn set_light(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Answer {
    let LightLevel { level } = body(request).await?;
    let set = aside(&app, move |app| {
        app.seat.take(&caller)?;
        app.desk.is_free()?;
        let light = app.bench.scope.light();
        let light =
            light.ok_or_else(|| ApiError::missing("this instrument has no light to set"))?;
        let set = light.set_level(level)?;
        app.audit
            .noted(&caller, "set the light", json!({"level": level}))?;
        Ok(set)
    });
    Ok(Json(json!({"level": set.await?})))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SlideName {
    name: Option<String>,
}

async fn set_slide(State(app): Shared, request: Request) -> Answer {
    let SlideName { name } = body(request).await?;
    let name = name
        .map(|name| name.trim().to_owned())
        .filter(|name| !name.is_empty());
    if name
        .as_ref()
        .is_some_and(|name| name.chars().count() > 100 || name.chars().any(char::is_control))
    {
        return Err(ApiError::input(
            "the name of a slide has 100 letters at the most, on one line",
        ));
    }
    (*crate::lock(&app.slide)).clone_from(&name);
    Ok(Json(json!({"slide": name})))
}

/// What is done with the demonstration's slide: it is moved, or a picture lies there instead; `null` is what lay there at first.
#[derive(Deserialize)]
struct Demo {
    #[serde(default, deserialize_with = "said")]
    picture: Option<Option<String>>,
}

async fn move_slide(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Answer {
    let Demo { picture } = body(request).await?;
    let told = json!({"slide": if picture.is_some() { "in" } else { "moved" }});
    aside(&app, move |app| {
        app.desk.is_free()?;
        app.seat.take(&caller)?;
        match picture {
            Some(name) => pictures::lay(app, &caller, name.as_deref()),
            None => app.move_demo_slide(),
        }
    })
    .await?;
    Ok(Json(told))
}
