//! Who may come in, and what strangers cannot do.

mod common;

use common::{Bench, Client, HURRIED};
use scopeservo_server::{OPENAPI, routes};
use serde_json::{Value, json};
use std::sync::Arc;
use tempfile::TempDir;

/// Paths with something in place of their names.
fn path(of: &str) -> String {
    of.replace("{name}", "x")
        .replace("{id}", "0")
        .replace("{file}", "app.js")
}

/// A body that would do something, were it let in.
fn tempting(path: &str) -> Value {
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

fn ask(client: &Client, [method, route, _]: [&str; 3], headers: &[(&str, &str)]) -> common::Said {
    let body = match method {
        "GET" => String::new(),
        _ => tempting(route).to_string(),
    };
    client.with(method, &path(route), headers, &body)
}

/// A person, made by the first admin.
fn person(bench: &Bench, admin: &Client, name: &str, role: &str) -> Client {
    let new = json!({"name": name, "password": "long enough", "role": role});
    assert_eq!(admin.post("/api/v1/users", &new).status, 200);
    let said = bench.stranger().post(
        "/api/v1/login",
        &json!({"name": name, "password": "long enough"}),
    );
    assert_eq!(said.status, 200);
    bench.stranger().with_cookie(&said)
}

fn admin(bench: &Bench) -> Client {
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

#[test]
fn who_asks_too_much_has_to_wait_and_a_stop_is_always_heard() {
    let folder = Arc::new(TempDir::new().unwrap());
    let bench = Bench::set(HURRIED, true, folder, |settings| {
        settings.limits.requests_at_once = 20.0;
        settings.limits.requests_per_s = 0.001;
    });
    let visitor = bench.visitor();
    let mut socket = visitor.socket();
    socket.text("hello");
    let answers: Vec<_> = (0..25).map(|_| visitor.get("/api/v1/state")).collect();
    let let_in = answers.iter().filter(|said| said.status == 200).count();
    // One of the twenty was the socket.
    assert_eq!(let_in, 19);
    let refused = answers.last().unwrap();
    assert_eq!((refused.status, refused.code().as_str()), (429, "too_many"));
    let wait: u64 = refused.header("retry-after").unwrap().parse().unwrap();
    assert!((900..=1000).contains(&wait), "{wait}");
    assert!(refused.json()["message"].as_str().unwrap().contains("wait"));
    // What stops, and what says that somebody is there, is heard all the same; so is what is held to move.
    assert_eq!(visitor.post("/api/v1/stop", &json!({})).status, 200);
    assert_eq!(visitor.post("/api/v1/lease", &json!({})).status, 200);
    for _ in 0..300 {
        socket.say(&json!({"type": "alive"}));
        socket.say(&json!({"type": "jog_end"}));
    }
    socket.say(&json!({"type": "jog", "x": 0.1}));
    let is_jog = |state: &Value| state["state"]["jobs"][0]["kind"] == "jog";
    while !is_jog(&socket.text("state")) {}
    socket.say(&json!({"type": "jog_end"}));
    // Idle talk is not.
    for n in 0..400 {
        socket.say(&json!({"type": "ping", "n": n}));
    }
    assert_eq!(socket.text("refused")["code"], "too_many");
    // Another one has as much as ever.
    assert_eq!(bench.visitor().get("/api/v1/state").status, 200);
}

#[test]
fn who_guesses_passwords_is_told_when_to_come_again() {
    let bench = Bench::new(HURRIED, false, Arc::new(TempDir::new().unwrap()));
    let admin = admin(&bench);
    let stranger = bench.stranger();
    let log_in = |headers: &[(&str, &str)], password: &str| {
        let body = json!({"name": "anna", "password": password}).to_string();
        stranger.with("POST", "/api/v1/login", headers, &body)
    };
    for _ in 0..5 {
        assert_eq!(log_in(&[], "a guess of mine").code(), "not_known");
    }
    let refused = log_in(&[], "long enough");
    assert_eq!((refused.status, refused.code().as_str()), (429, "too_many"));
    let wait: u64 = refused.header("retry-after").unwrap().parse().unwrap();
    assert!((1..=30).contains(&wait), "{wait}");
    // She is let in from another place, and whoever is in stays in.
    let through = [("x-forwarded-for", "10.0.0.7")];
    assert_eq!(log_in(&through, "long enough").status, 200);
    assert_eq!(admin.get("/api/v1/state").status, 200);
}

#[test]
fn somebody_else_sits_down_and_whoever_was_there_holds_nothing_any_more() {
    let bench = Bench::new(HURRIED, false, Arc::new(TempDir::new().unwrap()));
    let anna = admin(&bench);
    let bob = person(&bench, &anna, "bob", "operator");
    let step = json!({"job": "move", "by": {"x_um": 3.0}});
    anna.run(&step);
    let state = anna.state();
    assert_eq!(
        (&state["owner"], &state["mine"]),
        (&json!("anna"), &json!(true))
    );
    assert_eq!(state["may_not_start"], json!(null));
    let held = bob.state()["may_not_start"].clone();
    assert_eq!(held["code"], "held", "{held}");
    assert!(held["message"].as_str().unwrap().contains("anna"), "{held}");
    let mut socket = anna.socket();
    socket.text("hello");
    let _watching = bob.socket();
    assert_eq!(bob.state()["there"], json!(["anna", "bob"]));
    // With a wrong password nothing changes.
    let log_in = |password: &str| {
        let body = json!({"name": "bob", "password": password});
        anna.post("/api/v1/login", &body)
    };
    assert_eq!(log_in("not the one").status, 401);
    assert_eq!(anna.state()["mine"], true);
    let said = log_in("long enough");
    assert_eq!(said.status, 200);
    let changed = bench.stranger().with_cookie(&said);
    let me = changed.get("/api/v1/me").json();
    assert_eq!(
        (&me["user"], &me["role"]),
        (&json!("bob"), &json!("operator"))
    );
    assert_eq!(anna.get("/api/v1/state").status, 401);
    assert_eq!(changed.state()["owner"], json!(null));
    assert_eq!(socket.text("refused")["code"], "not_logged_in");
    // Whoever logs out lets go, too, and goes to whoever asked.
    assert_eq!(changed.run(&step)["error"], json!(null));
    let asked = bench.stranger().with_cookie(&bench.stranger().post(
        "/api/v1/login",
        &json!({"name": "anna", "password": "long enough"}),
    ));
    asked.post("/api/v1/lease/ask", &json!({}));
    assert_eq!(changed.post("/api/v1/logout", &json!({})).status, 200);
    assert_eq!(asked.state()["owner"], "anna");
}

#[test]
fn what_makes_no_sense_is_refused_with_a_sentence() {
    let mut bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    let jobs = [
        json!({}),
        json!({"job": "dance"}),
        json!({"job": "move"}),
        json!({"job": "move", "by": {}}),
        json!({"job": "move", "by": {"w_um": 1.0}}),
        json!({"job": "move", "by": {"x_um": 1.0}, "to": {"x_um": 1.0}}),
        json!({"job": "move", "by": {"x_um": "far"}}),
        json!({"job": "centre", "x": 1.5, "y": 0.5}),
        json!({"job": "objective", "objective": "100x"}),
        json!({"job": "focus", "range_um": -3.0}),
        json!({"job": "calibrate", "objectives": ["100x"]}),
        json!({"job": "save_target", "name": "../../etc/passwd"}),
        json!({"job": "reposition", "target": "nothing"}),
        json!({"job": "resume"}),
        json!({"job": "check"}),
    ];
    for job in jobs {
        let said = visitor.post("/api/v1/jobs", &job);
        assert!((400..500).contains(&said.status), "{job}: {}", said.head);
        let message = said.json()["message"].as_str().unwrap().to_owned();
        assert!(message.len() > 10, "{job}: {message}");
    }
    for (path, body) in [
        ("/api/v1/exposure", "{\"ms\": 1e999}"),
        ("/api/v1/exposure", "{\"ms\": -1}"),
        ("/api/v1/light", "{\"level\": 7}"),
        ("/api/v1/light", "[[[[[["),
        ("/api/v1/slide", "{\"name\": \"a\\u0000b\"}"),
        ("/api/v1/questions/9", "{\"yes\": true}"),
    ] {
        let said = visitor.with("POST", path, &[], body);
        assert!(
            (400..500).contains(&said.status),
            "{path} {body}: {}",
            said.head
        );
        said.code();
    }
    let large = format!("{{\"name\": \"{}\"}}", "x".repeat(2 << 20));
    assert_eq!(
        visitor.with("POST", "/api/v1/slide", &[], &large).status,
        413
    );
    for path in [
        "/api/v1/nothing",
        "/api/v1/targets/%ff",
        "/api/v1/runs/..%2f..",
        "/api/v1/jobs/abc",
        "/nothing.js",
    ] {
        let said = visitor.get(path);
        assert!((400..500).contains(&said.status), "{path}: {}", said.head);
    }
    // Beyond a limit it is the job that is refused.
    let beyond = visitor.run(&json!({"job": "move", "to": {"x_um": 50000.0}}));
    assert_eq!(beyond["error"]["kind"], "refusal", "{beyond}");
    assert_eq!(bench.motions(), 0);
}

#[test]
fn a_page_of_ours_loads_nothing_from_elsewhere_and_is_nobodys_frame() {
    let bench = Bench::demo(HURRIED);
    for path in ["/", "/app.js", "/app.css"] {
        let said = bench.stranger().get(path);
        assert_eq!(said.status, 200, "{path}");
        let policy = said.header("content-security-policy").unwrap();
        assert!(
            policy.starts_with("default-src 'none'; script-src 'self'"),
            "{policy}"
        );
        assert!(policy.contains("frame-ancestors 'none'"), "{policy}");
        assert_eq!(said.header("x-content-type-options"), Some("nosniff"));
    }
    let page = bench.stranger().get("/");
    let text = String::from_utf8(page.body).unwrap();
    assert!(
        !text.contains("http://") && !text.contains("https://"),
        "{text}"
    );
}

#[test]
fn the_document_has_every_route_with_who_may() {
    let document = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/server.md");
    let text = std::fs::read_to_string(document).unwrap();
    let table = text.split("<!-- routes").nth(1).unwrap();
    let rows = table.lines().filter(|line| {
        line.starts_with("| GET") || line.starts_with("| P") || line.starts_with("| DELETE")
    });
    let mut told: Vec<String> = rows
        .map(|row| {
            row.split('|')
                .take(3)
                .map(str::trim)
                .collect::<Vec<_>>()
                .join(" ")
        })
        .collect();
    let mut there: Vec<String> = routes()
        .into_iter()
        .map(|[method, path, need]| format!(" {method} {path} {need}"))
        .collect();
    told.sort();
    there.sort();
    assert_eq!(told, there);
}

#[test]
fn the_description_for_programs_has_every_route_with_who_may() {
    let described: Value = serde_json::from_str(OPENAPI).unwrap();
    let mut told = Vec::new();
    for (path, methods) in described["paths"].as_object().unwrap() {
        for (method, operation) in methods.as_object().unwrap() {
            let who = operation["x-who"].as_str().unwrap();
            told.push([method.to_uppercase(), path.clone(), who.to_owned()]);
            let parameters = operation["parameters"].as_array();
            let named = parameters
                .into_iter()
                .flatten()
                .filter(|p| p["in"] == "path");
            assert_eq!(named.count(), path.matches('{').count(), "{path}");
        }
    }
    let all = routes()
        .into_iter()
        .filter(|[_, path, _]| path.starts_with("/api/"));
    let mut there: Vec<[String; 3]> = all.map(|route| route.map(str::to_owned)).collect();
    told.sort();
    there.sort();
    assert_eq!(told, there);
}
