//! People at the doors, and what they ask.

#![allow(unreachable_pub, reason = "a part of one test")]

use crate::common::{Bench, Client, Said};
use serde_json::{Value, json};

/// Paths with something in place of their names.
pub fn path(of: &str) -> String {
    of.replace("{name}", "x")
        .replace("{id}", "0")
        .replace("{file}", "app.js")
}

/// A body that would do something, were it let in.
pub fn tempting(path: &str) -> Value {
    match path {
        "/api/v1/jobs" => json!({"job": "move", "by": {"x_um": 50.0}}),
        "/api/v1/exposure" => json!({"ms": 3.0}),
        "/api/v1/elsewhere" => json!({"minutes": 1.0}),
        "/api/v1/light" => json!({"level": 0.1}),
        "/api/v1/users" => json!({"name": "eve", "password": "long enough", "role": "admin"}),
        "/api/v1/tokens" => json!({"name": "eve", "role": "admin"}),
        _ => json!({}),
    }
}

pub fn ask(client: &Client, [method, route, _]: [&str; 3], headers: &[(&str, &str)]) -> Said {
    let body = match method {
        "GET" => String::new(),
        _ => tempting(route).to_string(),
    };
    client.with(method, &path(route), headers, &body)
}

/// A person, made by the first admin.
pub fn person(bench: &Bench, admin: &Client, name: &str, role: &str) -> Client {
    let new = json!({"name": name, "password": "long enough", "role": role});
    assert_eq!(admin.post("/api/v1/users", &new).status, 200);
    let said = bench.stranger().post(
        "/api/v1/login",
        &json!({"name": name, "password": "long enough"}),
    );
    assert_eq!(said.status, 200);
    bench.stranger().with_cookie(&said)
}

pub fn admin(bench: &Bench) -> Client {
    let key = bench.key.clone().unwrap();
    let stranger = bench.stranger();
    assert_eq!(
        stranger.post("/api/v1/enter", &json!({"key": key})).json()["claim"],
        true
    );
    let claim = json!({"key": key, "name": "anna", "password": "long enough"});
    let said = stranger.post("/api/v1/claim", &claim);
    assert_eq!(said.status, 200, "{}", said.json());
    stranger.with_cookie(&said)
}
