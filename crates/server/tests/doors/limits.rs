//! Who asks too much, who guesses, and who sits down where another one was.

use crate::common::{Bench, HURRIED};
use crate::people::{admin, person};
use serde_json::{Value, json};
use std::sync::Arc;
use tempfile::TempDir;

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
