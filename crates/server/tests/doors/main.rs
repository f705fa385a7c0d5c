//! Who may come in, and what strangers cannot do.

#[path = "../common/mod.rs"]
mod common;
mod documents;
mod limits;
mod people;

use common::{Bench, Client, HURRIED};
use people::{admin, ask, person};
use scopeservo_server::routes;
use serde_json::{Value, json};
use std::sync::Arc;
use tempfile::TempDir;

#[test]
fn no_route_lets_in_who_may_not_and_nothing_moves_for_them() {
    let mut bench = Bench::new(HURRIED, false, Arc::new(TempDir::new().unwrap()));
    let admin = admin(&bench);
    let viewer = person(&bench, &admin, "vera", "viewer");
    let own = format!("http://{}", bench.address());
    for route in routes() {
        let [method, at, need] = route;
        if need == "nobody" {
            continue;
        }
        let stranger = ask(&bench.stranger(), route, &[]);
        assert_eq!(stranger.status, 401, "{method} {at}: {}", stranger.head);
        assert_eq!(stranger.code(), "not_logged_in", "{method} {at}");
        // Watching goes on for ever, and logging out ends it.
        if at.ends_with("logout") || at.ends_with("mjpg") {
            continue;
        }
        let seen = ask(&viewer, route, &[]);
        let is_let_in = !matches!(seen.status, 401 | 403 | 500);
        match need {
            "viewer" => assert!(is_let_in, "{method} {at}: {}", seen.head),
            _ => {
                assert_eq!(seen.status, 403, "{method} {at}");
                assert_eq!(seen.code(), "role", "{method} {at}");
            }
        }
    }
    assert_eq!(viewer.post("/api/v1/stop", &json!({})).status, 200);
    assert_eq!(viewer.state()["may_not_start"]["code"], "role");
    // Whoever may: from another page, under another name, in another form.
    for route in routes() {
        let [method, at, _] = route;
        for (headers, status, code) in [
            ([("host", "evil.example")], 403, "wrong_host"),
            ([("origin", "http://evil.example")], 403, "wrong_origin"),
            ([("origin", "null")], 403, "wrong_origin"),
        ] {
            let said = ask(&admin, route, &headers);
            assert_eq!(
                (said.status, said.code().as_str()),
                (status, code),
                "{method} {at}"
            );
        }
        if matches!(method, "POST" | "PATCH") {
            for kind in ["text/plain", "application/x-www-form-urlencoded", ""] {
                let said = ask(&admin, route, &[("content-type", kind)]);
                assert_eq!(
                    (said.status, said.code().as_str()),
                    (415, "not_json"),
                    "{method} {at}"
                );
            }
        }
        if method != "GET" {
            let said = ask(&admin, route, &[("sec-fetch-site", "cross-site")]);
            assert_eq!(said.code(), "wrong_origin", "{method} {at}");
        }
    }
    assert_eq!(bench.motions(), 0);
    // The same with our own origin does move.
    let route = ["POST", "/api/v1/jobs", ""];
    let said = ask(&admin, route, &[("origin", &own)]);
    assert_eq!(said.status, 202, "{}", said.json());
    admin.ended(said.json()["id"].as_u64().unwrap());
    assert_eq!(bench.motions(), 1);
}

#[test]
fn a_token_is_a_person_without_a_browser() {
    let mut bench = Bench::new(HURRIED, false, Arc::new(TempDir::new().unwrap()));
    let admin = admin(&bench);
    let token = |name: &str, role: &str| {
        let said = admin.post("/api/v1/tokens", &json!({"name": name, "role": role}));
        let token = said.json()["token"].as_str().unwrap().to_owned();
        move |client: &Client, method: &str, path: &str, body: &Value| {
            let bearer = format!("Bearer {token}");
            client.with(
                method,
                path,
                &[("authorization", &bearer)],
                &body.to_string(),
            )
        }
    };
    let (looks, moves) = (token("watcher", "viewer"), token("mover", "operator"));
    let stranger = bench.stranger();
    let goes = json!({"job": "move", "by": {"x_um": 5.0}});
    assert_eq!(
        looks(&stranger, "GET", "/api/v1/state", &json!({})).status,
        200
    );
    assert_eq!(
        looks(&stranger, "POST", "/api/v1/jobs", &goes).code(),
        "role"
    );
    let started = moves(&stranger, "POST", "/api/v1/jobs", &goes);
    assert_eq!(started.status, 202);
    admin.ended(started.json()["id"].as_u64().unwrap());
    assert_eq!(bench.motions(), 1);
    // Somebody else drives now.
    assert_eq!(admin.post("/api/v1/jobs", &goes).code(), "held");
    assert_eq!(
        admin.with("DELETE", "/api/v1/tokens/mover", &[], "").status,
        200
    );
    assert_eq!(moves(&stranger, "POST", "/api/v1/jobs", &goes).status, 401);
    let log = bench.folder.path().join("server/moved.jsonl");
    let log = std::fs::read_to_string(log).unwrap();
    assert!(
        log.contains("\"user\":\"mover\"") && log.contains("\"did\":\"started\""),
        "{log}"
    );
}

#[test]
fn from_elsewhere_nothing_moves_until_somebody_here_allows_it() {
    let mut bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    let step = json!({"job": "move", "by": {"x_um": 5.0}}).to_string();
    let through = [("x-forwarded-for", "10.0.0.7")];
    let far = |path: &str, body: &str| visitor.with("POST", path, &through, body);
    assert_eq!(far("/api/v1/jobs", &step).code(), "not_here");
    let state = visitor.with("GET", "/api/v1/state", &through, "").json();
    assert_eq!(state["may_not_start"]["code"], "not_here", "{state}");
    assert_eq!(far("/api/v1/stop", "{}").status, 200);
    // Nor can they allow it themselves.
    assert_eq!(
        far("/api/v1/elsewhere", "{\"minutes\": 5}").code(),
        "not_here"
    );
    assert_eq!(bench.motions(), 0);
    let allow = |minutes: f64| visitor.post("/api/v1/elsewhere", &json!({"minutes": minutes}));
    assert_eq!(allow(-1.0).status, 400);
    assert_eq!(allow(5.0).status, 200);
    let begun = far("/api/v1/jobs", &step);
    assert_eq!(begun.status, 202);
    visitor.ended(begun.json()["id"].as_u64().unwrap());
    assert_eq!(bench.motions(), 1);
    allow(0.0);
    assert_eq!(far("/api/v1/jobs", &step).code(), "not_here");
}

#[test]
fn what_came_by_tls_goes_by_no_other_way() {
    let folder = Arc::new(TempDir::new().unwrap());
    let bench = Bench::named(HURRIED, true, folder, &["scope-3.lab:443"]);
    let key = json!({"key": bench.key.clone().unwrap()}).to_string();
    let enter = |headers: &[(&str, &str)]| {
        bench
            .stranger()
            .with("POST", "/api/v1/enter", headers, &key)
    };
    let plain = enter(&[]);
    assert!(!plain.header("set-cookie").unwrap().contains("Secure"));
    let headers = [
        ("host", "scope-3.lab:443"),
        ("origin", "https://scope-3.lab:443"),
    ];
    let by_tls = enter(&headers);
    assert_eq!(by_tls.status, 200);
    assert!(by_tls.header("set-cookie").unwrap().contains("; Secure"));
    // And is elsewhere, whoever it is.
    let visitor = bench.stranger().with_cookie(&by_tls);
    let me = visitor.with("GET", "/api/v1/me", &headers, "").json();
    assert_eq!(
        (&me["here"], &me["may_move"]),
        (&json!(false), &json!(false))
    );
}
