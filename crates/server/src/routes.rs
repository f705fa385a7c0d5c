//! The routes, each with what it needs of whoever asks. There is no other way in: the table is the router.

use crate::app::App;
use crate::asked::{JobRequest, Wish};
use crate::error::ApiError;
use crate::guard::{self, Need, require, set_cookie};
use crate::kept;
use crate::live::Live;
use crate::page;
use crate::people::{Caller, Entered, Role};
use crate::socket;
use axum::body::Body;
use axum::extract::{Path, Query, Request, State, WebSocketUpgrade};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, delete, get, patch, post};
use axum::{Extension, Json, Router};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// No body is larger, bytes.
const LARGEST_BODY: usize = 1 << 20;
/// So many runs at most in one answer.
const RUNS: usize = 500;

type Shared = State<Arc<App>>;
type Answer = Result<Json<Value>, ApiError>;

/// One route.
pub(crate) struct Route {
    pub(crate) method: &'static str,
    pub(crate) path: &'static str,
    pub(crate) need: Need,
    handler: MethodRouter<Arc<App>>,
}

fn route(
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

/// All of them.
pub(crate) fn table() -> Vec<Route> {
    use Need::{Administer, AllowElsewhere, Move, Nobody, Operate, View};
    vec![
        route("GET", "/", Nobody, get(async || page::asset(""))),
        route(
            "GET",
            "/{file}",
            Nobody,
            get(async |Path(file): Path<String>| page::asset(&file)),
        ),
        route("POST", "/api/v1/enter", Nobody, post(enter)),
        route("POST", "/api/v1/claim", Nobody, post(claim)),
        route("POST", "/api/v1/login", Nobody, post(log_in)),
        route("POST", "/api/v1/logout", View, post(log_out)),
        route("GET", "/api/v1/me", View, get(me)),
        route("GET", "/api/v1/users", Administer, get(users)),
        route("POST", "/api/v1/users", Administer, post(add_user)),
        route(
            "DELETE",
            "/api/v1/users/{name}",
            Administer,
            delete(remove_user),
        ),
        route("GET", "/api/v1/tokens", Administer, get(tokens)),
        route("POST", "/api/v1/tokens", Administer, post(add_token)),
        route(
            "DELETE",
            "/api/v1/tokens/{name}",
            Administer,
            delete(remove_token),
        ),
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
        route("GET", "/api/v1/jobs", View, get(jobs)),
        route("POST", "/api/v1/jobs", Move, post(start)),
        route("GET", "/api/v1/jobs/{id}", View, get(job)),
        route("POST", "/api/v1/jobs/{id}/stop", View, post(stop_job)),
        route("POST", "/api/v1/jobs/{id}/pause", View, post(pause_job)),
        route("POST", "/api/v1/jobs/{id}/resume", Move, post(resume_job)),
        route("POST", "/api/v1/abandon", Move, post(abandon)),
        route("POST", "/api/v1/questions/{id}", Move, post(answer)),
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
        route("GET", "/api/v1/calibrations", View, get(calibrations)),
        route("GET", "/api/v1/runs", View, get(runs)),
        route("GET", "/api/v1/runs/{id}", View, get(run)),
        route("GET", "/api/v1/runs/{id}/events", View, get(run_events)),
        route(
            "GET",
            "/api/v1/runs/{id}/report.html",
            View,
            get(run_report),
        ),
        route("GET", "/api/v1/frame.jpg", View, get(frame)),
        route("GET", "/api/v1/stream.mjpg", View, get(stream)),
        route("GET", "/api/v1/live", View, get(live)),
    ]
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

/// The body of a request; what is wrong with it is said.
async fn body<T: DeserializeOwned>(request: Request) -> Result<T, ApiError> {
    let bytes = axum::body::to_bytes(request.into_body(), LARGEST_BODY).await;
    let bytes = bytes.map_err(|_| {
        let message = format!("what is sent has {LARGEST_BODY} bytes at the most");
        ApiError::new(StatusCode::PAYLOAD_TOO_LARGE, "too_large", message)
    })?;
    serde_json::from_slice(&bytes).map_err(|e| ApiError::input(format!("that cannot be read: {e}")))
}

/// What may wait for a device or a disk is done elsewhere.
async fn aside<T: Send + 'static>(
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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Key {
    key: String,
}

async fn enter(State(app): Shared, request: Request) -> Result<Response, ApiError> {
    let Key { key } = body(request).await?;
    match aside(&app, move |app| app.people.enter(&key)).await? {
        Entered::Claim => Ok(Json(json!({"claim": true})).into_response()),
        Entered::Session(session) => {
            Ok((set_cookie(Some(&session)), Json(json!({"claim": false}))).into_response())
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Claim {
    key: String,
    name: String,
    password: String,
}

async fn claim(State(app): Shared, request: Request) -> Result<Response, ApiError> {
    let Claim {
        key,
        name,
        password,
    } = body(request).await?;
    let session = aside(&app, move |app| app.people.claim(&key, &name, &password)).await?;
    Ok((set_cookie(Some(&session)), Json(json!({}))).into_response())
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LogIn {
    name: String,
    password: String,
}

async fn log_in(State(app): Shared, request: Request) -> Result<Response, ApiError> {
    let LogIn { name, password } = body(request).await?;
    let session = aside(&app, move |app| app.people.log_in(&name, &password)).await?;
    Ok((set_cookie(Some(&session)), Json(json!({}))).into_response())
}

async fn log_out(State(app): Shared, Extension(caller): Extension<Caller>) -> Response {
    app.people.log_out(&caller);
    (set_cookie(None), Json(json!({}))).into_response()
}

async fn me(Extension(caller): Extension<Caller>) -> Json<Value> {
    let may_move = Need::Move.met_by(Some(&caller)).is_ok();
    Json(json!({
        "user": caller.user,
        "role": caller.role,
        "here": caller.here,
        "may_move": may_move,
    }))
}

fn listed(all: Vec<(String, Role)>) -> Json<Value> {
    let all = all.into_iter();
    let all = all.map(|(name, role)| json!({"name": name, "role": role}));
    Json(all.collect())
}

async fn users(State(app): Shared) -> Json<Value> {
    listed(app.people.users())
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NewUser {
    name: String,
    password: String,
    role: Role,
}

async fn add_user(State(app): Shared, request: Request) -> Answer {
    let new: NewUser = body(request).await?;
    let added = aside(&app, move |app| {
        app.people.add_user(&new.name, &new.password, new.role)
    });
    added.await?;
    Ok(listed(app.people.users()))
}

async fn remove_user(State(app): Shared, Path(name): Path<String>) -> Answer {
    aside(&app, move |app| app.people.remove_user(&name)).await?;
    Ok(listed(app.people.users()))
}

async fn tokens(State(app): Shared) -> Json<Value> {
    listed(app.people.tokens())
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NewToken {
    name: String,
    role: Role,
}

async fn add_token(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Answer {
    let new: NewToken = body(request).await?;
    let token = aside(&app, move |app| {
        app.people.add_token(&caller.user, &new.name, new.role)
    });
    Ok(Json(json!({"token": token.await?})))
}

async fn remove_token(State(app): Shared, Path(name): Path<String>) -> Answer {
    aside(&app, move |app| app.people.remove_token(&name)).await?;
    Ok(listed(app.people.tokens()))
}

async fn instrument(State(app): Shared) -> Answer {
    Ok(Json(aside(&app, |app| app.described()).await?))
}

async fn state(State(app): Shared, Extension(caller): Extension<Caller>) -> Json<Value> {
    let standing = app.standing.borrow().clone();
    Json(standing.told_to(&app, &caller))
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

async fn move_slide(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Answer {
    let _: Value = body(request).await?;
    aside(&app, move |app| {
        app.desk.is_free()?;
        app.seat.take(&caller)?;
        app.move_demo_slide()
    })
    .await?;
    Ok(Json(json!({"slide": "moved"})))
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
    let asked: JobRequest = body(request).await?;
    let id = aside(&app, move |app| {
        app.desk.is_free()?;
        let wish = Wish::of(&app.bench, asked)?;
        app.desk.start(app, &caller, wish)
    });
    let id = id.await?;
    Ok((StatusCode::ACCEPTED, Json(json!({"id": id}))).into_response())
}

async fn job(State(app): Shared, Path(id): Path<u64>) -> Answer {
    Ok(Json(app.desk.one(id)?.whole()))
}

async fn stop_job(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    Path(id): Path<u64>,
) -> Answer {
    let entry = app.desk.one(id)?;
    let told = aside(&app, move |app| {
        let told = entry.handle.stop();
        app.audit
            .noted(&caller, "stopped a job", json!({"id": id}))?;
        told?;
        Ok(entry.whole())
    });
    Ok(Json(told.await?))
}

async fn pause_job(State(app): Shared, Path(id): Path<u64>) -> Answer {
    let entry = app.desk.one(id)?;
    entry.handle.pause();
    Ok(Json(entry.whole()))
}

async fn resume_job(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    Path(id): Path<u64>,
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
    Path(id): Path<u64>,
    request: Request,
) -> Answer {
    let YesNo { yes } = body(request).await?;
    let session = app.console.session();
    session.answer(scopeservo_station::QuestionId(id), yes)?;
    app.audit
        .noted(&caller, "answered", json!({"question": id, "yes": yes}))?;
    Ok(Json(json!({})))
}

#[derive(Deserialize)]
struct Wanted {
    #[serde(default)]
    text: String,
}

async fn targets(State(app): Shared, Query(wanted): Query<Wanted>) -> Answer {
    Ok(Json(
        aside(&app, move |app| kept::targets(app, &wanted.text)).await?,
    ))
}

async fn target(State(app): Shared, Path(name): Path<String>) -> Answer {
    Ok(Json(
        aside(&app, move |app| kept::target(app, &name)).await?,
    ))
}

async fn edit_target(State(app): Shared, Path(name): Path<String>, request: Request) -> Answer {
    let edit: kept::Edit = body(request).await?;
    Ok(Json(
        aside(&app, move |app| kept::edit(app, &name, &edit)).await?,
    ))
}

async fn remove_target(State(app): Shared, Path(name): Path<String>) -> Answer {
    aside(&app, move |app| kept::remove(app, &name)).await?;
    Ok(Json(json!({})))
}

/// Bytes of a kind.
fn file(kind: &'static str, bytes: Vec<u8>) -> Response {
    (
        [(header::CONTENT_TYPE, HeaderValue::from_static(kind))],
        bytes,
    )
        .into_response()
}

async fn target_picture(
    State(app): Shared,
    Path(name): Path<String>,
) -> Result<Response, ApiError> {
    let bytes = aside(&app, move |app| kept::picture(app, &name)).await?;
    Ok(file("image/png", bytes))
}

async fn target_thumbnail(
    State(app): Shared,
    Path(name): Path<String>,
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
}

async fn runs(State(app): Shared, Query(page): Query<Page>) -> Answer {
    let limit = page.limit.unwrap_or(50).min(RUNS);
    let all = aside(&app, move |app| {
        kept::runs(app, limit, page.before.as_deref())
    });
    Ok(Json(all.await?))
}

async fn run(State(app): Shared, Path(id): Path<String>) -> Answer {
    Ok(Json(aside(&app, move |app| kept::run(app, &id)).await?))
}

async fn run_events(State(app): Shared, Path(id): Path<String>) -> Result<Response, ApiError> {
    let bytes = aside(&app, move |app| kept::events(app, &id)).await?;
    Ok(file("application/json", bytes))
}

/// A report is a page of its own that may run nothing.
async fn run_report(State(app): Shared, Path(id): Path<String>) -> Result<Response, ApiError> {
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

/// How long one who asks for a frame waits for it.
const FRAME: Duration = Duration::from_secs(5);

async fn frame(State(app): Shared) -> Result<Response, ApiError> {
    let mut watching = Live::watch(&app);
    watching.frames.mark_unchanged();
    let _ = tokio::time::timeout(FRAME, watching.frames.changed()).await;
    let newest = watching.frames.borrow().clone();
    let none = || {
        let message = "the camera shows nothing now";
        ApiError::new(StatusCode::SERVICE_UNAVAILABLE, "no_frame", message)
    };
    let newest = newest.filter(|newest| newest.since.elapsed() < 2 * FRAME);
    Ok(file("image/jpeg", newest.ok_or_else(none)?.jpeg.clone()))
}

/// Frames as browsers and cameras of the network have shown them for thirty years.
async fn stream(State(app): Shared) -> Response {
    let watching = Live::watch(&app);
    let parts = crate::live::parts(watching);
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
    let place = app.socket_place()?;
    let upgrade = upgrade.max_message_size(64 << 10).max_frame_size(64 << 10);
    Ok(upgrade.on_upgrade(move |socket| async move {
        socket::serve(app, caller, socket).await;
        drop(place);
    }))
}
