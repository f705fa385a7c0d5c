//! How one comes in, and who may.

use super::route::{Answer, Named, Route, Shared, aside, body, route};
use crate::app::App;
use crate::error::ApiError;
use crate::guard::set_cookie;
use crate::need::Need;
use crate::peer::{Peer, Whence};
use crate::people::{Caller, Entered, Role};
use axum::extract::{Request, State};
use axum::response::{IntoResponse, Response};
use axum::routing::{delete, get, post};
use axum::{Extension, Json};
use serde::Deserialize;
use serde_json::{Value, json};

pub(super) fn routes() -> Vec<Route> {
    use Need::{Administer, Nobody, View};
    vec![
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
    ]
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Key {
    key: String,
}

async fn enter(
    State(app): Shared,
    Extension(peer): Extension<Peer>,
    request: Request,
) -> Result<Response, ApiError> {
    let headers = request.headers().clone();
    let Key { key } = body(request).await?;
    match aside(&app, move |app| app.people.enter(&key)).await? {
        Entered::Claim => Ok(Json(json!({"claim": true})).into_response()),
        Entered::Session(session) => Ok((
            set_cookie(Some(&session), &peer, &headers),
            Json(json!({"claim": false})),
        )
            .into_response()),
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Claim {
    key: String,
    name: String,
    password: String,
}

async fn claim(
    State(app): Shared,
    Extension(peer): Extension<Peer>,
    request: Request,
) -> Result<Response, ApiError> {
    let headers = request.headers().clone();
    let Claim {
        key,
        name,
        password,
    } = body(request).await?;
    let session = aside(&app, move |app| app.people.claim(&key, &name, &password)).await?;
    Ok((set_cookie(Some(&session), &peer, &headers), Json(json!({}))).into_response())
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LogIn {
    name: String,
    password: String,
}

async fn log_in(
    State(app): Shared,
    Extension(peer): Extension<Peer>,
    Extension(Whence(place)): Extension<Whence>,
    before: Option<Extension<Caller>>,
    request: Request,
) -> Result<Response, ApiError> {
    let headers = request.headers().clone();
    let LogIn { name, password } = body(request).await?;
    let session = aside(&app, move |app| {
        let session = app.people.log_in(&name, &password, &place)?;
        // Somebody else at the same browser: whoever was there before is there no more.
        if let Some(Extension(before)) = before {
            leave(app, &before);
        }
        Ok(session)
    })
    .await?;
    Ok((set_cookie(Some(&session), &peer, &headers), Json(json!({}))).into_response())
}

/// Ends a session. What it held stands, and its seat is free.
fn leave(app: &App, caller: &Caller) {
    app.people.log_out(caller);
    app.desk.let_go(&caller.key);
    app.seat.leave(caller);
}

async fn log_out(
    State(app): Shared,
    Extension(caller): Extension<Caller>,
    Extension(peer): Extension<Peer>,
    request: Request,
) -> Result<Response, ApiError> {
    let cookie = set_cookie(None, &peer, request.headers());
    aside(&app, move |app| {
        leave(app, &caller);
        Ok(())
    })
    .await?;
    Ok((cookie, Json(json!({}))).into_response())
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

async fn remove_user(State(app): Shared, Named(name): Named<String>) -> Answer {
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

async fn remove_token(State(app): Shared, Named(name): Named<String>) -> Answer {
    aside(&app, move |app| app.people.remove_token(&name)).await?;
    Ok(listed(app.people.tokens()))
}
