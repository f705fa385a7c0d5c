//! Work by the interface, as a page or a program does it: jobs, the seat, the live view, and stops.

mod common;

use common::{Bench, HURRIED, PATIENCE, REAL};
use scopeservo_library::{Database, RunHead, Runs as _};
use serde_json::json;
use std::time::{Duration, Instant};

/// How much two pictures differ, mean levels of grey.
fn away(one: &[u8], other: &[u8]) -> f64 {
    let [one, other] = [one, other].map(|bytes| image::load_from_memory(bytes).unwrap().to_luma8());
    assert_eq!(one.dimensions(), other.dimensions());
    let sum: f64 = one
        .iter()
        .zip(other.iter())
        .map(|(a, b)| f64::from(a.abs_diff(*b)))
        .sum();
    sum / one.len() as f64
}

#[test]
fn a_view_is_saved_the_slide_is_moved_and_the_view_comes_back() {
    let bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    let said = visitor.post("/api/v1/slide", &json!({"name": "17B"}));
    assert_eq!(said.json()["slide"], "17B");
    let turned = visitor.run(&json!({"job": "objective", "objective": "40x"}));
    assert_eq!(turned["error"], json!(null), "{turned}");
    let saved = visitor.run(&json!({"job": "save_target", "name": "mitosis-3", "focus": true}));
    assert_eq!(saved["answer"]["name"], "mitosis-3", "{saved}");
    // It is there, with its pictures, and its name is taken.
    let targets = visitor.get("/api/v1/targets").json();
    assert_eq!(targets[0]["name"], "mitosis-3");
    assert_eq!(targets[0]["quality"]["word"], "good", "{targets}");
    let thumb = visitor.get("/api/v1/targets/mitosis-3/thumb.jpg");
    assert_eq!(thumb.body[..3], [0xff, 0xd8, 0xff]);
    let image = visitor.get("/api/v1/targets/mitosis-3/image.png");
    assert_eq!(image.body[1..4], *b"PNG");
    let again = visitor.post(
        "/api/v1/jobs",
        &json!({"job": "save_target", "name": "mitosis-3"}),
    );
    assert_eq!((again.status, again.code().as_str()), (409, "taken"));
    assert_eq!(
        visitor
            .post("/api/v1/demo", &json!({"slide": "move"}))
            .status,
        200
    );
    assert_eq!(visitor.state()["demo"]["slide"], "moved");
    let back = visitor.run(&json!({"job": "reposition", "target": "mitosis-3"}));
    let answer = &back["answer"];
    assert_eq!(answer["verdict"], "arrived", "{back}");
    assert!(
        answer["estimated_error_um"].as_f64().unwrap() < 2.0,
        "{answer}"
    );
    // What happened is kept, by its user, with its page.
    let run = back["run"].as_str().unwrap();
    let runs = visitor.get("/api/v1/runs?limit=1").json();
    assert_eq!(runs[0]["id"], run);
    assert_eq!(
        (&runs[0]["user"], &runs[0]["slide"]),
        (&json!("you"), &json!("17B"))
    );
    assert_eq!(runs[0]["verdict"], "arrived");
    let older = visitor.get(&format!("/api/v1/runs?before={run}")).json();
    assert_eq!(older[0]["job"], "save_target");
    let page = visitor.get(&format!("/api/v1/runs/{run}/report.html"));
    assert!(
        page.header("content-security-policy")
            .unwrap()
            .starts_with("sandbox;")
    );
    assert!(
        String::from_utf8(page.body)
            .unwrap()
            .contains("Back to mitosis-3")
    );
    // With what was seen at arrival: the saved view, and the other runs have none.
    assert_eq!(runs[0]["arrival"], true, "{runs}");
    assert_eq!(older[0]["arrival"], false);
    let seen = visitor.get(&format!("/api/v1/runs/{run}/arrival.jpg"));
    assert_eq!(seen.header("content-type"), Some("image/jpeg"));
    assert!(away(&seen.body, &image.body) < 12.0);
    let none = visitor.get(&format!(
        "/api/v1/runs/{}/arrival.jpg",
        older[0]["id"].as_str().unwrap()
    ));
    assert_eq!(none.status, 404);
    let events = visitor.get(&format!("/api/v1/runs/{run}/events")).json();
    let is_iteration = |e: &serde_json::Value| e["event"] == "iteration";
    assert!(
        events.as_array().unwrap().iter().any(is_iteration),
        "{events}"
    );
    // Calibrations that were made on the way are known from now on.
    let instrument = visitor.get("/api/v1/instrument").json();
    let all = instrument["objectives"].as_array().unwrap();
    assert!(all.iter().all(|o| o["calibrated"] == true), "{instrument}");
    let centred = visitor.run(&json!({"job": "centre", "x": 0.6, "y": 0.5}));
    assert_eq!(centred["error"], json!(null), "{centred}");
    // Renamed, and taken out.
    let renamed = visitor.with(
        "PATCH",
        "/api/v1/targets/mitosis-3",
        &[],
        "{\"name\": \"m3\"}",
    );
    assert_eq!(renamed.json()["name"], "m3");
    assert_eq!(
        visitor.with("DELETE", "/api/v1/targets/m3", &[], "").status,
        200
    );
    assert_eq!(visitor.get("/api/v1/targets").json(), json!([]));
}

/// A run of this program or of another: its target stays until it has ended.
#[test]
fn what_a_run_goes_to_cannot_be_taken_away_meanwhile() {
    let bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    let saved = visitor.run(&json!({"job": "save_target", "name": "spot", "focus": false}));
    assert_eq!(saved["error"], json!(null), "{saved}");
    let other = Database::new(bench.folder.path().join("scopeservo-data"));
    let begin = || {
        let head = RunHead {
            job: "reposition".into(),
            instrument: "another".into(),
            version: String::new(),
            inputs: json!({"name": "spot"}),
        };
        other.begin_run(&head).unwrap()
    };
    let refused = |method: &str, path: &str, body: &str| {
        let said = visitor.with(method, path, &[], body);
        assert_eq!((said.status, said.code().as_str()), (409, "in_use"));
        let said = said.json();
        assert_eq!(said["kind"], "refusal", "{said}");
        let message = said["message"].as_str().unwrap();
        assert!(
            message.contains("'spot'") && message.contains("Wait"),
            "{message}"
        );
    };
    let run = begin();
    refused("DELETE", "/api/v1/targets/spot", "");
    refused("PATCH", "/api/v1/targets/spot", "{\"name\": \"m3\"}");
    // What is said of it may change meanwhile.
    let noted = visitor.with("PATCH", "/api/v1/targets/spot", &[], "{\"note\": \"seen\"}");
    assert_eq!(noted.json()["note"], "seen");
    drop(run);
    let removed = visitor.with("DELETE", "/api/v1/targets/spot", &[], "");
    assert_eq!(removed.status, 200);
    let run = begin();
    refused("DELETE", "/api/v1/bin/spot", "");
    assert_eq!(
        visitor.get("/api/v1/targets?bin=true").json()[0]["name"],
        "spot"
    );
    drop(run);
    let purged = visitor.with("DELETE", "/api/v1/bin/spot", &[], "").json();
    assert_eq!(purged["purged"][0]["name"], "spot", "{purged}");
}

#[test]
fn one_drives_and_hands_over_when_asked() {
    let bench = Bench::demo(HURRIED);
    let (anna, bob) = (bench.visitor(), bench.visitor());
    // Two browsers of one person: the second takes the seat along.
    let step = json!({"job": "move", "by": {"x_um": 3.0}});
    anna.run(&step);
    assert_eq!(anna.state()["mine"], true);
    bob.run(&step);
    assert_eq!(
        (&anna.state()["mine"], &bob.state()["mine"]),
        (&json!(false), &json!(true))
    );
    assert_eq!(
        anna.post("/api/v1/lease/give", &json!({})).code(),
        "lease_lost"
    );
    let token = anna.post(
        "/api/v1/tokens",
        &json!({"name": "script", "role": "operator"}),
    );
    let token = token.json()["token"].as_str().unwrap().to_owned();
    let bearer = format!("Bearer {token}");
    let script = |path: &str, body: &serde_json::Value| {
        let stranger = bench.stranger();
        stranger.with(
            "POST",
            path,
            &[("authorization", &bearer)],
            &body.to_string(),
        )
    };
    assert_eq!(script("/api/v1/jobs", &step).code(), "held");
    script("/api/v1/lease/ask", &json!({}));
    assert_eq!(bob.state()["asked_by"], "script");
    assert_eq!(
        bob.post("/api/v1/lease/give", &json!({})).json()["owner"],
        "script"
    );
    assert_eq!(bob.post("/api/v1/jobs", &step).code(), "held");
    assert_eq!(bob.state()["asked_by"], json!(null));
    let goes = script("/api/v1/jobs", &step);
    assert_eq!(goes.status, 202);
    anna.ended(goes.json()["id"].as_u64().unwrap());
}

#[test]
fn one_job_at_a_time_and_a_stop_ends_it_for_whoever_asks() {
    let bench = Bench::demo(REAL);
    let visitor = bench.visitor();
    let id = visitor.start(&json!({"job": "move", "to": {"x_um": 9000.0, "z_um": -2900.0}}));
    let busy = visitor.post("/api/v1/jobs", &json!({"job": "home"}));
    assert_eq!((busy.status, busy.code().as_str()), (409, "busy"));
    let bars = visitor.state()["may_not_start"].clone();
    assert_eq!(bars["code"], "busy", "{bars}");
    assert_eq!(bars["message"], busy.json()["message"]);
    assert_eq!(
        visitor.post("/api/v1/exposure", &json!({"ms": 5.0})).code(),
        "busy"
    );
    assert_eq!(visitor.post("/api/v1/stop", &json!({})).status, 200);
    let ended = visitor.ended(id);
    assert_eq!(ended["state"]["how"], "stopped", "{ended}");
    assert_eq!(ended["error"]["code"], "stopped");
    // The next one runs as if nothing had been.
    let next = visitor.run(&json!({"job": "move", "by": {"x_um": 1.0}}));
    assert_eq!(next["error"], json!(null), "{next}");
}

#[test]
fn who_reads_that_a_job_has_ended_reads_where_it_left_the_instrument() {
    let bench = Bench::demo(REAL);
    let visitor = bench.visitor();
    let x = |state: &serde_json::Value| state["at"]["x_um"].as_f64().unwrap();
    let mut goal = x(&visitor.state());
    for k in 0..20 {
        goal += 40.0;
        let id = visitor.start(&json!({"job": "move", "to": {"x_um": goal}}));
        let state = match k % 2 {
            // By the job, and by the state itself.
            0 => {
                visitor.ended(id);
                visitor.state()
            }
            _ => loop {
                let state = visitor.state();
                let job = &state["jobs"][0];
                if job["id"] == id && job["state"]["state"] == "ended" {
                    break state;
                }
                std::thread::sleep(Duration::from_millis(5));
            },
        };
        assert!((x(&state) - goal).abs() < 3.0, "{goal}: {state}");
        assert_eq!(state["moving"], false);
    }
}

#[test]
fn what_is_held_moves_and_stands_when_it_is_let_go_or_nobody_is_there() {
    let bench = Bench::demo(REAL);
    let visitor = bench.visitor();
    let x = || {
        let since = Instant::now();
        loop {
            // Nobody may have looked yet.
            if let Some(x) = visitor.state()["at"]["x_um"].as_f64() {
                return x;
            }
            assert!(since.elapsed() < PATIENCE, "nobody knows where it is");
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    let mut socket = visitor.socket();
    socket.text("hello");
    let began = x();
    let hold = |socket: &mut common::Socket, times: usize| {
        for _ in 0..times {
            socket.say(&json!({"type": "jog", "x": 0.3}));
            std::thread::sleep(Duration::from_millis(100));
        }
    };
    let stands = || {
        let since = Instant::now();
        while visitor.state()["jobs"][0]["state"]["state"] != "ended" {
            assert!(since.elapsed() < PATIENCE);
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    hold(&mut socket, 8);
    socket.say(&json!({"type": "jog_end"}));
    stands();
    let there = x();
    assert!(there != began, "{began} {there}");
    let jog = visitor.state()["jobs"][0].clone();
    assert_eq!(jog["kind"], "jog");
    assert_eq!(
        visitor.job(jog["id"].as_u64().unwrap())["error"],
        json!(null)
    );
    // No word any more: it stands by itself.
    hold(&mut socket, 4);
    stands();
    // A stop ends it for good, though the program there goes on saying the same, until it lets go.
    hold(&mut socket, 3);
    assert_eq!(visitor.post("/api/v1/stop", &json!({})).status, 200);
    stands();
    let jogs = || visitor.state()["jobs"][0]["id"].clone();
    let before = jogs();
    hold(&mut socket, 4);
    assert_eq!(socket.text("refused")["code"], "stopped");
    assert_eq!(jogs(), before);
    socket.say(&json!({"type": "jog_end"}));
    hold(&mut socket, 4);
    stands();
    assert_ne!(jogs(), before);
    // The browser is gone.
    hold(&mut socket, 4);
    drop(socket);
    stands();
    std::thread::sleep(Duration::from_millis(500));
    let last = x();
    std::thread::sleep(Duration::from_millis(500));
    assert!((x() - last).abs() < 3.0, "{last} {}", x());
    // What is no way to go moves nothing.
    let mut socket = visitor.socket();
    for way in [
        json!({"type": "jog"}),
        json!({"type": "jog", "x": "right"}),
        json!({"type": "fly"}),
    ] {
        socket.say(&way);
    }
    assert_eq!(socket.text("refused")["code"], "bad_input");
}

#[test]
fn frames_come_one_after_the_other_was_drawn_and_stops_are_heard_at_once() {
    let bench = Bench::demo(REAL);
    let visitor = bench.visitor();
    let mut socket = visitor.socket();
    socket.say(&json!({"type": "watch", "fps": 30.0}));
    let first = socket.frame();
    assert_eq!(first.jpeg[..3], [0xff, 0xd8, 0xff]);
    assert_eq!(
        (&first.head["width"], &first.head["height"]),
        (&json!(640), &json!(480))
    );
    assert_eq!(first.head["role"], "live");
    // Undrawn: the next one only comes when nobody can be drawing still, and it is the newest by then.
    let next = socket.frame();
    let skipped = next.head["seq"].as_u64().unwrap() - first.head["seq"].as_u64().unwrap();
    assert!(skipped > 3, "{skipped}");
    for _ in 0..3 {
        let frame = socket.frame();
        socket.say(&json!({"type": "ack", "seq": frame.head["seq"]}));
    }
    socket.say(&json!({"type": "ping", "n": 7}));
    assert_eq!(socket.text("pong")["n"], 7);
    // While it goes, a stop by the same connection.
    let id = visitor.start(&json!({"job": "move", "to": {"z_um": -2900.0}}));
    socket.say(&json!({"type": "stop"}));
    assert_eq!(visitor.ended(id)["state"]["how"], "stopped");
    // What happened meanwhile is told in order, also from the beginning.
    socket.say(&json!({"type": "from", "number": 0}));
    let mut numbers = Vec::new();
    while numbers.last() != Some(&5) {
        let record = &socket.text("event")["record"];
        numbers.push(record["number"].as_u64().unwrap());
    }
    assert_eq!(numbers[numbers.len() - 6..], [0, 1, 2, 3, 4, 5]);
    // The simple way.
    let jpeg = visitor.get("/api/v1/frame.jpg");
    assert_eq!(jpeg.body[..3], [0xff, 0xd8, 0xff]);
}
