//! A server that is killed while it works, whenever that is: nothing that it acknowledged is lost, and what was under way is told.
//! `SCOPESERVO_KILLS=300` for the long form.
#![cfg(all(feature = "serve", unix))]

mod common;

use common::served::serve_twin;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const PATIENCE: Duration = Duration::from_secs(120);
/// It is killed at some moment of so long, mostly early.
const LONGEST: Duration = Duration::from_millis(1800);

/// Between two questions: more at once than a program may ask would be refused.
const LOOK: Duration = Duration::from_millis(20);

/// A server, and how it is asked: by the command line's door, or by a session.
struct Served {
    child: Child,
    address: String,
    key: Option<String>,
    token: String,
}

impl Served {
    fn new(here: &Path) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_scopeservo"))
            .current_dir(here)
            .args(["serve", "--listen", "127.0.0.1:0"])
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        out.read_line(&mut line).unwrap();
        let link = line.trim().strip_prefix("open http://").unwrap();
        let (address, rest) = link.split_once('/').unwrap();
        let door = read(&here.join("scopeservo-data/server/door.json"));
        assert_eq!(door["address"], address);
        Self {
            child,
            address: address.into(),
            key: rest.strip_prefix("#key=").map(str::to_owned),
            token: door["token"].as_str().unwrap().into(),
        }
    }

    /// What is answered, with its head; nothing where the server is gone.
    fn say(&self, how: &str, path: &str, who: &str, body: &Value) -> Option<(u16, String, Value)> {
        let text = match body {
            Value::Null => String::new(),
            body => body.to_string(),
        };
        let request = format!(
            "{how} /api/v1/{path} HTTP/1.1\r\nhost: {}\r\n{who}\r\ncontent-type: application/json\r\ncontent-length: {}\r\nconnection: close\r\n\r\n{text}",
            self.address,
            text.len()
        );
        let mut stream = TcpStream::connect(&self.address).ok()?;
        stream.set_read_timeout(Some(PATIENCE)).ok()?;
        stream.write_all(request.as_bytes()).ok()?;
        let mut said = Vec::new();
        stream.read_to_end(&mut said).ok()?;
        let said = String::from_utf8_lossy(&said);
        let (head, body) = said.split_once("\r\n\r\n")?;
        let status = head.split(' ').nth(1)?.parse().ok()?;
        Some((status, head.into(), serde_json::from_str(body).ok()?))
    }

    /// The same by the command line's door.
    fn ask(&self, how: &str, path: &str, body: &Value) -> Option<(u16, Value)> {
        let who = format!("authorization: Bearer {}", self.token);
        let (status, _, told) = self.say(how, path, &who, body)?;
        Some((status, told))
    }

    fn get(&self, path: &str) -> Value {
        let (status, told) = self.ask("GET", path, &Value::Null).unwrap();
        assert_eq!(status, 200, "{path}: {told}");
        told
    }

    /// Anna's session, who claims the instrument where it has nobody yet; nothing where the server is gone.
    fn anna(&self) -> Option<String> {
        let mut body = json!({"name": "anna", "password": "long enough"});
        let path = match &self.key {
            Some(key) => {
                body["key"] = json!(key);
                "claim"
            }
            None => "login",
        };
        let (status, head, told) = self.say("POST", path, "x: y", &body)?;
        assert_eq!(status, 200, "{told}");
        let cookie = head.lines().find_map(|l| l.strip_prefix("set-cookie: "));
        let session = cookie.unwrap().split(';').next().unwrap();
        Some(format!("cookie: {session}"))
    }

    /// A job's end; nothing where the server is gone before.
    fn done(&self, job: &Value) -> Option<Value> {
        let (status, told) = self.ask("POST", "jobs", job)?;
        assert_eq!(status, 202, "{job}: {told}");
        self.ended(&told)
    }

    fn ended(&self, begun: &Value) -> Option<Value> {
        let (path, began) = (format!("jobs/{}", begun["id"]), Instant::now());
        loop {
            let (_, job) = self.ask("GET", &path, &Value::Null)?;
            if job["state"]["state"] == "ended" {
                return Some(job);
            }
            assert!(began.elapsed() < PATIENCE, "{job}");
            std::thread::sleep(LOOK);
        }
    }

    fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn read(file: &PathBuf) -> Value {
    let text = std::fs::read_to_string(file).unwrap();
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}: {text}", file.display()))
}

/// What was acknowledged, all in all.
#[derive(Default)]
struct Acknowledged {
    targets: BTreeSet<String>,
    tokens: BTreeSet<String>,
    minutes: BTreeSet<u64>,
}

/// Works at it until it is gone.
fn work(served: &Served, round: usize, ended: &AtomicBool, all: &Mutex<Acknowledged>) {
    std::thread::scope(|threads| {
        // Views are saved, one after the other, with a step between them.
        threads.spawn(|| {
            // Whoever was killed while it looked for a sharper height left the stage there.
            let Some(_) = served.done(&json!({"job": "move", "to": {"z_um": 0.0}})) else {
                return;
            };
            for n in 0.. {
                let name = format!("view-{round}-{n}");
                let step = served.done(&json!({"job": "move", "by": {"x_um": 3.0}}));
                let save = json!({"job": "save_target", "name": name});
                let saved = step.and_then(|_| served.done(&save));
                let Some(saved) = saved else { break };
                // A view that was refused for what it shows was not acknowledged.
                let error = &saved["error"];
                assert!(error.is_null() || error["kind"] == "answer", "{saved}");
                if error.is_null() {
                    all.lock().unwrap().targets.insert(name);
                }
            }
        });
        // Meanwhile the file of users is written anew again and again, and so is the log.
        threads.spawn(|| {
            let Some(anna) = served.anna() else { return };
            for n in 0.. {
                let name = format!("token-{round}-{n}");
                let new = json!({"name": name, "role": "viewer"});
                match served.say("POST", "tokens", &anna, &new) {
                    Some((200, _, _)) => all.lock().unwrap().tokens.insert(name),
                    _ => break,
                };
                let minutes = (1 + n % 400) as u64;
                match served.ask("POST", "elsewhere", &json!({"minutes": minutes})) {
                    Some((200, _)) => all.lock().unwrap().minutes.insert(minutes),
                    _ => break,
                };
            }
        });
        threads.spawn(|| {
            while !ended.load(Ordering::SeqCst) {
                let _ = served.ask("GET", "state", &Value::Null);
                std::thread::sleep(LOOK);
            }
        });
    });
}

/// Files as they lie there while nobody has them open.
fn whole(here: &Path, all: &Acknowledged) {
    let server = here.join("scopeservo-data/server");
    read(&server.join("door.json"));
    let people = read(&server.join("people.json"));
    let has = |what: &str| -> BTreeSet<String> {
        let named = people[what].as_array().unwrap().iter();
        named
            .map(|one| one["name"].as_str().unwrap().into())
            .collect()
    };
    assert_eq!(has("users"), BTreeSet::from(["anna".to_owned()]));
    let lost: Vec<_> = all.tokens.difference(&has("tokens")).cloned().collect();
    assert!(lost.is_empty(), "lost tokens: {lost:?}");
    let log = std::fs::read_to_string(server.join("moved.jsonl")).unwrap();
    let lines: Vec<Value> = log
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}")))
        .collect();
    let noted = lines.iter().filter_map(|l| l["what"]["minutes"].as_f64());
    let noted: BTreeSet<u64> = noted.map(|m| m as u64).collect();
    assert!(noted.is_superset(&all.minutes), "the log lacks a line");
}

/// The simulated microscope, faster than life; it stays as it is when the program that serves it is killed.
fn microscope(here: &Path) -> common::served::Served {
    let devices = "[devices]\nstage = \"twin\"\ncamera = \"twin\"\nnosepiece = \"twin\"\n[objective_change]\nretract_z_um = -2000\nmargin_um = 0\n";
    let twin = "name = \"twin\"\n[drivers.twin.twin]\nseed = 4\nobjectives = [\"40x\"]\n";
    std::fs::write(here.join("twin.toml"), format!("{twin}{devices}")).unwrap();
    let served = serve_twin(
        here,
        &[
            "--speed",
            "50",
            "--idle-s",
            "0.3",
            "--described-in",
            "twin.toml",
        ],
    );
    let limits = "[limits]\nx_um = [-3000, 3000]\ny_um = [-3000, 3000]\n";
    let text = format!(
        "name = \"bench\"\n[drivers.twin]\ntcp = \"{}\"\n{limits}{devices}",
        served.address
    );
    std::fs::write(here.join("scopeservo.toml"), text).unwrap();
    served
}

#[test]
#[expect(clippy::print_stdout, reason = "what the long form is run for")]
fn killed_at_any_moment_a_server_loses_nothing_that_it_acknowledged() {
    let kills = std::env::var("SCOPESERVO_KILLS").ok();
    let kills: usize = kills.and_then(|n| n.parse().ok()).unwrap_or(20);
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let twin = microscope(here);
    let all = Mutex::new(Acknowledged::default());
    // Somebody is known before the first one is killed.
    Served::new(here).anna().unwrap();
    let (mut random, mut resumed, mut abandoned) = (7u64, 0, 0);
    for round in 0..kills {
        let served = Served::new(here);
        let left = served.get("instrument")["left"].clone();
        if !left.is_null() {
            // What was under way is told, bars what is new, and goes on or is given up as somebody chooses.
            let (status, bars) = served
                .ask("POST", "jobs", &json!({"job": "focus"}))
                .unwrap();
            assert_eq!(
                (status, &bars["code"]),
                (409, &json!("unfinished")),
                "{bars}"
            );
            let went_on = (round % 2 == 0).then(|| {
                let (status, told) = served
                    .ask("POST", "jobs", &json!({"job": "resume"}))
                    .unwrap();
                (status == 202).then(|| served.ended(&told).unwrap())
            });
            match went_on.flatten() {
                Some(job) => {
                    resumed += 1;
                    // A view that was refused for what it shows was not acknowledged.
                    let error = &job["error"];
                    assert!(
                        error.is_null() || error["kind"] == "answer",
                        "{left}: {job}"
                    );
                    if error.is_null() {
                        let name = job["about"].as_str().unwrap().to_owned();
                        all.lock().unwrap().targets.insert(name);
                    }
                }
                None => {
                    abandoned += 1;
                    assert_eq!(served.ask("POST", "abandon", &json!({})).unwrap().0, 200);
                }
            }
            assert_eq!(served.get("instrument")["left"], json!(null));
        }
        let there = served.get("targets");
        let there: BTreeSet<String> = there
            .as_array()
            .unwrap()
            .iter()
            .map(|t| {
                assert!(t["damaged"].is_null(), "{t}");
                t["name"].as_str().unwrap().to_owned()
            })
            .collect();
        let lost: Vec<_> = all
            .lock()
            .unwrap()
            .targets
            .difference(&there)
            .cloned()
            .collect();
        assert!(lost.is_empty(), "lost after {round} kills: {lost:?}");
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let share = (random >> 33) as f64 / (1u64 << 31) as f64;
        let moment = LONGEST.mul_f64(share.powi(4));
        let (ended, served) = (AtomicBool::new(false), Mutex::new(served));
        std::thread::scope(|threads| {
            let pid = served.lock().unwrap().child.id().to_string();
            let handle = threads.spawn(|| work(&served.lock().unwrap(), round, &ended, &all));
            std::thread::sleep(moment);
            assert!(
                Command::new("kill")
                    .args(["-KILL", &pid])
                    .status()
                    .unwrap()
                    .success()
            );
            ended.store(true, Ordering::SeqCst);
            handle.join().unwrap();
        });
        served.into_inner().unwrap().kill();
        whole(here, &all.lock().unwrap());
    }
    drop(twin);
    let all = all.into_inner().unwrap();
    println!(
        "{kills} kills: {} views, {} tokens and {} lines were acknowledged, and are there; of {} jobs that were under way {resumed} went on",
        all.targets.len(),
        all.tokens.len(),
        all.minutes.len(),
        resumed + abandoned
    );
}
