//! A stop overtakes everything: a driver that answers nothing until it is told to writes down in which order it was asked.

mod common;

use common::{Bench, Client, PATIENCE};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

/// What the driver was asked, in order, and which calls it keeps waiting.
#[derive(Default)]
struct Log {
    asked: Vec<Value>,
    withheld: BTreeSet<&'static str>,
    goal: Option<Value>,
}

#[derive(Clone, Default)]
struct Driver(Arc<(Mutex<Log>, Condvar)>);

impl Driver {
    /// Listens, and its address.
    fn start() -> (Self, String) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let driver = Self::default();
        let serving = driver.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let serving = serving.clone();
                std::thread::spawn(move || serving.serve(stream.unwrap()));
            }
        });
        (driver, address)
    }

    fn serve(&self, stream: TcpStream) {
        let out = Arc::new(Mutex::new(stream.try_clone().unwrap()));
        for line in BufReader::new(stream).lines() {
            let Ok(line) = line else { return };
            let asked: Value = serde_json::from_str(&line).unwrap();
            let (log, changed) = &*self.0;
            log.lock().unwrap().asked.push(asked.clone());
            changed.notify_all();
            let (driver, out) = (self.clone(), out.clone());
            // Each call on its own: what is withheld keeps no other from its answer.
            std::thread::spawn(move || driver.answer(&asked, &out));
        }
    }

    fn answer(&self, asked: &Value, out: &Mutex<TcpStream>) {
        let call = asked["call"].as_str().unwrap().to_owned();
        let (log, changed) = &*self.0;
        let held = |log: &mut Log| log.withheld.contains(call.as_str());
        let mut log = changed.wait_while(log.lock().unwrap(), held).unwrap();
        let mut said = match call.as_str() {
            "hello" => {
                json!({"protocol": 1, "name": "slow", "stage": {"name": "slow", "moves": "specimen_xy_on_top", "axes": [
                {"axis": "x", "min_um": -50000, "max_um": 50000, "repeatability_um": 1},
                {"axis": "y", "min_um": -50000, "max_um": 50000, "repeatability_um": 1}]},
                "camera": {"name": "slow", "width_px": 64, "height_px": 48, "channels": 1, "bits": 8, "min_exposure_ms": 1, "max_exposure_ms": 100},
                "nosepiece": {"name": "slow", "objectives": [{"id": "10x", "magnification": 100, "numerical_aperture": 0.25, "um_per_px": 2.2}]}})
            }
            "position" => json!({"x_um": 0, "y_um": 0}),
            "motion" => json!({"motion": if log.goal.is_some() { "moving" } else { "stopped" }}),
            "objective" => json!({"objective": "10x", "motion": "settled"}),
            "exposure" => json!({"exposure_ms": 10}),
            "grab" => {
                json!({"width_px": 64, "height_px": 48, "channels": 1, "bits": 8, "exposure_ms": 10, "sequence": asked["id"], "age_ms": 10, "bytes": 64 * 48})
            }
            "move" => {
                log.goal = Some(asked.clone());
                json!({})
            }
            "stop" => {
                log.goal = None;
                json!({})
            }
            _ => json!({}),
        };
        drop(log);
        said["id"] = asked["id"].clone();
        said["ok"] = json!(true);
        let mut out = out.lock().unwrap();
        let _ = out.write_all(format!("{said}\n").as_bytes());
        if call == "grab" {
            let _ = out.write_all(&[128; 64 * 48]);
        }
    }

    /// Keeps these waiting from now on, and nothing else.
    fn withhold(&self, calls: &[&'static str]) {
        let (log, changed) = &*self.0;
        log.lock().unwrap().withheld = calls.iter().copied().collect();
        changed.notify_all();
    }

    /// How often that was asked.
    fn count(&self, call: &str) -> usize {
        let asked = &self.0.0.lock().unwrap().asked;
        asked.iter().filter(|a| a["call"] == call).count()
    }

    /// Waits until that was asked more often than so often.
    fn asked_after(&self, call: &str, before: usize) {
        let since = Instant::now();
        while self.count(call) <= before {
            assert!(since.elapsed() < PATIENCE, "{call} is not asked");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// What came after the last stop, of what moves.
    fn moves_after_the_last_stop(&self) -> usize {
        let asked = &self.0.0.lock().unwrap().asked;
        let after = asked.iter().rev().take_while(|a| a["call"] != "stop");
        let moves = after.filter(|a| ["move", "home", "change"].iter().any(|c| a["call"] == *c));
        moves.count()
    }
}

/// An instrument whose devices are the driver's, served to one who may move it and one who may only look.
struct Served {
    _bench: Bench,
    driver: Driver,
    anna: Client,
    looks: Client,
}

fn served() -> Served {
    let (driver, address) = Driver::start();
    let description = format!(
        "name = \"served\"\n[drivers.slow]\ntcp = \"{address}\"\n[devices]\nstage = \"slow\"\ncamera = \"slow\"\nnosepiece = \"slow\"\n[limits]\nx_um = [-50000, 50000]\ny_um = [-50000, 50000]\n"
    );
    let bench = Bench::of(&description, false);
    let password = "long enough";
    let key = bench.key.clone().unwrap();
    let who = json!({"key": key, "name": "anna", "password": password});
    let anna = bench.stranger().post("/api/v1/claim", &who);
    let anna = bench.stranger().with_cookie(&anna);
    let who = json!({"name": "looks", "password": password, "role": "viewer"});
    assert_eq!(anna.post("/api/v1/users", &who).status, 200);
    let who = json!({"name": "looks", "password": password});
    let looks = bench.stranger().post("/api/v1/login", &who);
    let looks = bench.stranger().with_cookie(&looks);
    Served {
        _bench: bench,
        driver,
        anna,
        looks,
    }
}

const FAR: [f64; 2] = [40_000.0, -40_000.0];

#[test]
fn every_way_to_stop_is_the_drivers_next_call_and_nothing_moves_after_it() {
    let Served {
        _bench,
        driver,
        anna,
        looks,
    } = served();
    let mut socket = looks.socket();
    socket.text("hello");
    for (k, way) in ["rest", "job", "socket", "viewer"].iter().enumerate() {
        let moves = driver.count("move");
        let id = anna.start(&json!({"job": "move", "to": {"x_um": FAR[k % 2]}}));
        driver.asked_after("move", moves);
        let stops = driver.count("stop");
        // Whatever else is asked of it meanwhile is not answered: frames, and the look at how things stand.
        driver.withhold(&["grab", "exposure"]);
        match *way {
            "rest" => assert_eq!(anna.post("/api/v1/stop", &json!({})).status, 200),
            "job" => {
                let path = format!("/api/v1/jobs/{id}/stop");
                assert_eq!(looks.post(&path, &json!({})).status, 200);
            }
            "socket" => socket.say(&json!({"type": "stop"})),
            _ => assert_eq!(looks.post("/api/v1/stop", &json!({})).status, 200),
        }
        driver.asked_after("stop", stops);
        driver.withhold(&[]);
        let ended = anna.ended(id);
        assert_eq!(ended["state"]["how"], "stopped", "{way}: {ended}");
        assert_eq!(ended["error"]["code"], "stopped", "{way}");
        assert_eq!(driver.moves_after_the_last_stop(), 0, "{way}");
    }
}

#[test]
fn a_stop_is_meant_for_what_was_asked_before_it_and_has_not_begun() {
    let Served {
        _bench,
        driver,
        anna,
        ..
    } = served();
    // A job whose words are on their way: the server waits for the rest of them.
    let mut stream = TcpStream::connect(anna.address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let body = json!({"job": "move", "to": {"x_um": FAR[0]}}).to_string();
    let head = format!(
        "POST /api/v1/jobs HTTP/1.1\r\nhost: {}\r\ncookie: {}\r\ncontent-type: application/json\r\ncontent-length: {}\r\nexpect: 100-continue\r\nconnection: close\r\n\r\n",
        anna.address,
        anna.cookie.clone().unwrap(),
        body.len()
    );
    stream.write_all(head.as_bytes()).unwrap();
    let mut lines = BufReader::new(stream.try_clone().unwrap());
    let mut line = String::new();
    lines.read_line(&mut line).unwrap();
    assert!(line.starts_with("HTTP/1.1 100"), "{line}");
    // What is held to move, and waits for what the nosepiece says; and a stop on the same connection.
    driver.withhold(&["objective"]);
    let mut socket = anna.socket();
    socket.text("hello");
    socket.say(&json!({"type": "jog", "x": 1.0}));
    let stops = driver.count("stop");
    socket.say(&json!({"type": "stop"}));
    driver.asked_after("stop", stops);
    driver.withhold(&[]);
    assert_eq!(socket.text("refused")["code"], "stopped");
    stream.write_all(body.as_bytes()).unwrap();
    let mut said = String::new();
    std::io::Read::read_to_string(&mut lines, &mut said).unwrap();
    assert!(said.contains("HTTP/1.1 409"), "{said}");
    assert!(said.contains("\"code\":\"stopped\""), "{said}");
    assert_eq!(driver.count("move") + driver.count("change"), 0);
    // Let go, and what is asked next goes as if nothing had been.
    socket.say(&json!({"type": "jog_end"}));
    let id = anna.start(&json!({"job": "move", "to": {"x_um": FAR[0]}}));
    driver.asked_after("move", 0);
    assert_eq!(anna.post("/api/v1/stop", &json!({})).status, 200);
    assert_eq!(anna.ended(id)["state"]["how"], "stopped");
}

#[test]
fn who_reads_nothing_is_heard_when_they_say_stop() {
    let Served {
        _bench,
        driver,
        anna,
        ..
    } = served();
    let mut socket = anna.socket();
    socket.text("hello");
    // Nobody reads from here on: answers pile up until no more can be sent.
    for _ in 0..40 {
        socket.say(&json!({"type": "ping", "n": "x".repeat(60_000)}));
    }
    let moves = driver.count("move");
    let id = anna.start(&json!({"job": "move", "to": {"x_um": FAR[0]}}));
    driver.asked_after("move", moves);
    let stops = driver.count("stop");
    socket.say(&json!({"type": "stop"}));
    driver.asked_after("stop", stops);
    assert_eq!(anna.ended(id)["state"]["how"], "stopped");
}
