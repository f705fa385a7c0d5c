//! Many at once, slow ones, and those who say nothing.

mod common;

use common::{Bench, Client, HURRIED, PATIENCE, REAL};
use serde_json::{Value, json};
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;

#[test]
fn who_says_nothing_is_cut_off_and_keeps_nobody_away_for_ever() {
    let bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    // More than there are places, half of them in the middle of a word.
    let mut silent: Vec<TcpStream> = (0..600)
        .filter_map(|k| {
            let mut stream = TcpStream::connect(bench.address()).ok()?;
            if k % 2 == 0 {
                let _ = stream.write_all(b"GET /api/v1/state HTTP/1.1\r\nhost: ");
            }
            Some(stream)
        })
        .collect();
    let since = Instant::now();
    let served = loop {
        let answer = std::panic::catch_unwind(|| visitor.get("/api/v1/state").status);
        if answer.is_ok_and(|status| status == 200) {
            break since.elapsed();
        }
        assert!(since.elapsed() < PATIENCE, "nobody comes in any more");
        std::thread::sleep(Duration::from_millis(200));
    };
    assert!(served < PATIENCE);
    // All of them are gone by then, or soon.
    for stream in &mut silent {
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut rest = Vec::new();
        let _ = stream.read_to_end(&mut rest);
    }
    assert_eq!(visitor.get("/api/v1/state").status, 200);
}

#[test]
fn sleepers_and_slow_readers_cost_the_brisk_one_nothing() {
    let bench = Bench::demo(REAL);
    let visitor = bench.visitor();
    let mut asleep: Vec<_> = (0..10).map(|_| visitor.socket()).collect();
    for socket in &mut asleep {
        socket.say(&json!({"type": "watch", "fps": 60.0}));
    }
    // The simple way, by one who never reads.
    let mut mjpeg = TcpStream::connect(bench.address()).unwrap();
    let cookie = visitor.cookie.as_ref().unwrap();
    let host = bench.address();
    let request =
        format!("GET /api/v1/stream.mjpg HTTP/1.1\r\nhost: {host}\r\ncookie: {cookie}\r\n\r\n");
    mjpeg.write_all(request.as_bytes()).unwrap();
    let mut brisk = visitor.socket();
    brisk.say(&json!({"type": "watch", "fps": 30.0}));
    let mut last = 0;
    for _ in 0..40 {
        let frame = brisk.frame();
        brisk.say(&json!({"type": "ack", "seq": frame.head["seq"]}));
        let seq = frame.head["seq"].as_u64().unwrap();
        assert!(seq > last);
        last = seq;
    }
    // A job runs as it would.
    let moved = visitor.run(&json!({"job": "move", "by": {"x_um": 20.0}}));
    assert_eq!(moved["error"], json!(null), "{moved}");
    // Nor is there room for any number of them.
    let mut more = Vec::new();
    let refused = loop {
        let stream = TcpStream::connect(bench.address()).unwrap();
        let url = format!("ws://{}/api/v1/live", bench.address());
        let mut request = tungstenite::client::IntoClientRequest::into_client_request(url).unwrap();
        request
            .headers_mut()
            .insert("cookie", cookie.parse().unwrap());
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => more.push(socket),
            Err(_) => break more.len(),
        }
        assert!(more.len() < 200, "no bound");
    };
    assert!(refused > 30, "{refused}");
    assert_eq!(visitor.get("/api/v1/state").status, 200);
}

#[test]
fn a_killed_job_is_told_and_goes_on_or_is_abandoned() {
    let folder = Arc::new(TempDir::new().unwrap());
    let bench = Bench::new(HURRIED, true, folder.clone());
    let job = json!({"job": "calibrate", "objectives": ["40x"]});
    let bench = killed(bench, &folder, &job, |_| {});
    let visitor = bench.visitor();
    let left = visitor.get("/api/v1/instrument").json()["left"].clone();
    assert!(left.as_str().unwrap().contains("calibrate"), "{left}");
    let bars = visitor.state()["may_not_start"].clone();
    assert_eq!(bars["code"], "unfinished", "{bars}");
    let other = visitor.post("/api/v1/jobs", &json!({"job": "focus"}));
    assert_eq!((other.status, other.code().as_str()), (409, "unfinished"));
    // A step by hand is no obstacle, and bars none.
    visitor.run(&json!({"job": "objective", "objective": "10x"}));
    assert_eq!(visitor.post("/api/v1/abandon", &json!({})).status, 200);
    assert_eq!(
        visitor.get("/api/v1/instrument").json()["left"],
        json!(null)
    );
    assert_eq!(visitor.state()["may_not_start"], json!(null));
    assert_eq!(
        visitor
            .post("/api/v1/jobs", &json!({"job": "resume"}))
            .code(),
        "nothing_left"
    );
}

/// The same served again, by another program, after one that was killed between two steps of that job: its journal is as it stands while the job
/// waits. `meanwhile` is done after that.
fn killed(
    bench: Bench,
    folder: &Arc<TempDir>,
    job: &Value,
    meanwhile: impl FnOnce(&Client),
) -> Bench {
    let visitor = bench.visitor();
    let id = visitor.start(job);
    let journal = folder.path().join("scopeservo-data/journal");
    let copy = folder.path().join("copy");
    let began = Instant::now();
    let is_begun = || std::fs::read_dir(&journal).is_ok_and(|mut all| all.next().is_some());
    while !is_begun() {
        assert!(began.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(5));
    }
    visitor.post(&format!("/api/v1/jobs/{id}/pause"), &json!({}));
    while visitor.job(id)["state"]["state"] != "paused" {
        assert!(began.elapsed() < PATIENCE, "{}", visitor.job(id));
        std::thread::sleep(Duration::from_millis(5));
    }
    copied(&journal, &copy);
    visitor.post("/api/v1/stop", &json!({}));
    visitor.ended(id);
    meanwhile(&visitor);
    drop(bench);
    copied(&copy, &journal);
    Bench::new(HURRIED, true, folder.clone())
}

/// The journal's files, which lie in one folder.
fn journal_files(journal: &std::path::Path) -> Vec<(std::path::PathBuf, Vec<u8>)> {
    let folders = std::fs::read_dir(journal).into_iter().flatten().flatten();
    let files = folders.flat_map(|folder| {
        let named = ["head.json", "state.json"].map(|name| folder.path().join(name));
        named.map(|path| (path.clone(), std::fs::read(path).unwrap_or_default()))
    });
    files.filter(|(_, bytes)| !bytes.is_empty()).collect()
}

#[test]
fn a_view_that_was_kept_before_the_program_was_killed_is_told_as_kept() {
    let folder = Arc::new(TempDir::new().unwrap());
    let bench = Bench::new(HURRIED, true, folder.clone());
    let save = json!({"job": "save_target", "name": "mitosis-3", "focus": true});
    let journal = folder.path().join("scopeservo-data/journal");
    let visitor = bench.visitor();
    let id = visitor.start(&save);
    let began = Instant::now();
    // As it is before its last step.
    let files = loop {
        let files = journal_files(&journal);
        let saves = |(_, bytes): &(_, Vec<u8>)| {
            let text: String = String::from_utf8_lossy(bytes).split_whitespace().collect();
            text.contains("\"state\":{\"save\":")
        };
        if files.len() == 2 && files.iter().any(saves) {
            break files;
        }
        assert!(began.elapsed() < PATIENCE, "{}", visitor.job(id));
    };
    visitor.ended(id);
    drop((visitor, bench));
    for (path, bytes) in files {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    let bench = Bench::new(HURRIED, true, folder);
    let visitor = bench.visitor();
    let bars = visitor.state()["may_not_start"].clone();
    assert_eq!(bars["code"], "unfinished", "{bars}");
    let resumed = visitor.run(&json!({"job": "resume"}));
    assert_eq!(resumed["error"], json!(null), "{resumed}");
    assert_eq!(resumed["kind"], "save_target");
    let answer = &resumed["answer"];
    assert_eq!(
        (&answer["name"], &answer["was_kept"]),
        (&json!("mitosis-3"), &json!(true)),
        "{answer}"
    );
    assert!(answer["features"].as_u64().unwrap() > 0, "{answer}");
    // Nothing waits any more, and there is one of it.
    assert_eq!(visitor.state()["may_not_start"], json!(null));
    assert_eq!(
        visitor
            .get("/api/v1/targets")
            .json()
            .as_array()
            .unwrap()
            .len(),
        1
    );
    let again = visitor.post("/api/v1/jobs", &json!({"job": "resume"}));
    assert_eq!(again.code(), "nothing_left");
}

/// The name is another view's then: nobody may be told that this one was saved.
#[test]
fn a_save_that_was_killed_before_it_kept_anything_is_not_taken_for_another_of_its_name() {
    let folder = Arc::new(TempDir::new().unwrap());
    let bench = Bench::new(HURRIED, true, folder.clone());
    let save = json!({"job": "save_target", "name": "mitosis-3", "focus": true});
    let bench = killed(bench, &folder, &save, |visitor| {
        assert_eq!(visitor.run(&save)["error"], json!(null));
    });
    let visitor = bench.visitor();
    let refused = visitor.post("/api/v1/jobs", &json!({"job": "resume"}));
    assert_eq!(refused.code(), "unfinished");
    let bars = visitor.state()["may_not_start"].clone();
    assert_eq!(bars["code"], "unfinished", "it waits still: {bars}");
}

fn copied(from: &std::path::Path, to: &std::path::Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().flatten() {
        let (path, to) = (entry.path(), to.join(entry.file_name()));
        match path.is_dir() {
            true => copied(&path, &to),
            false => drop(std::fs::copy(path, to).unwrap()),
        }
    }
}
