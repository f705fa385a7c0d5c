//! A simulated microscope that is served, and a client that knows nothing of how.
#![allow(dead_code, reason = "each test uses a part of it")]

use scopeservo_scope::{CancelToken, GateEvent};
use scopeservo_server::{Before, ServeError, Server, Settings};
use scopeservo_setup::{Config, Consent};
use scopeservo_station::{Heard, Listener, News};
use scopeservo_workbench::Workbench;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

pub(crate) const PATIENCE: Duration = Duration::from_secs(120);

/// A served microscope and what is known of it from inside.
pub(crate) struct Bench {
    // Ends first.
    pub(crate) server: Server,
    pub(crate) listener: Listener,
    pub(crate) key: Option<String>,
    pub(crate) folder: Arc<TempDir>,
}

/// A simulated microscope: `twin` are more lines of its table.
pub(crate) fn described(twin: &str) -> String {
    format!(
        "name = \"served\"\n[drivers.twin.twin]\nseed = 3\n{twin}\n[devices]\nstage = \"twin\"\ncamera = \"twin\"\nnosepiece = \"twin\"\nlight = \"twin\"\n\
         [limits]\nx_um = [-17000, 17000]\ny_um = [-16000, 16000]\nz_um = [-3000, 500]\n[objective_change]\nretract_z_um = -2000\nmargin_um = 50\n"
    )
}

/// As long as motion takes.
pub(crate) const REAL: &str = "real_time = true";
/// A minute passes in a second.
pub(crate) const HURRIED: &str = "objectives = [\"10x\", \"40x\"]";

fn opened(description: &str, folder: &Path) -> (Workbench, Before) {
    let path = folder.join("scopeservo.toml");
    let config = Config::parse(description, &path).unwrap();
    let before = Before::default();
    let consent = Consent {
        home: false,
        ask: before.questions.asker(),
        ask_immersion: before.questions.immersion_asker(),
    };
    let bench = Workbench::open(config, &consent, CancelToken::new(), |e| panic!("{e}"));
    (bench.unwrap(), before)
}

/// Why it is not served so.
pub(crate) fn refused(settings: &Settings) -> ServeError {
    let folder = TempDir::new().unwrap();
    let (bench, before) = opened(&described(HURRIED), folder.path());
    match Server::start(bench, before, settings) {
        Ok(_) => panic!("served"),
        Err(error) => error,
    }
}

impl Bench {
    pub(crate) fn demo(twin: &str) -> Self {
        Self::new(twin, true, Arc::new(TempDir::new().unwrap()))
    }

    pub(crate) fn new(twin: &str, demo: bool, folder: Arc<TempDir>) -> Self {
        Self::named(twin, demo, folder, &[])
    }

    /// The same behind a proxy of these names.
    pub(crate) fn named(twin: &str, demo: bool, folder: Arc<TempDir>, names: &[&str]) -> Self {
        let names = names.iter().map(|name| (*name).to_owned()).collect();
        Self::set(twin, demo, folder, |settings| settings.names = names)
    }

    /// The same, served otherwise.
    pub(crate) fn set(
        twin: &str,
        demo: bool,
        folder: Arc<TempDir>,
        set: impl FnOnce(&mut Settings),
    ) -> Self {
        Self::described(&described(twin), demo, folder, set)
    }

    /// Any instrument, of which nothing is known.
    pub(crate) fn of(description: &str, demo: bool) -> Self {
        Self::described(description, demo, Arc::new(TempDir::new().unwrap()), |_| {})
    }

    fn described(
        description: &str,
        demo: bool,
        folder: Arc<TempDir>,
        set: impl FnOnce(&mut Settings),
    ) -> Self {
        let (bench, before) = opened(description, folder.path());
        let listener = before.bus.listen();
        let mut settings = Settings {
            listen: "127.0.0.1:0".parse().unwrap(),
            names: Vec::new(),
            tls: None,
            proxies: Vec::new(),
            limits: Default::default(),
            demo,
            folder: folder.path().join("server"),
        };
        set(&mut settings);
        let server = Server::start(bench, before, &settings).unwrap();
        let link = server.link();
        let key = link.split_once("#key=").map(|(_, key)| key.to_owned());
        Self {
            server,
            listener,
            key,
            folder,
        }
    }

    pub(crate) fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Whoever has the terminal's link of a demonstration.
    pub(crate) fn visitor(&self) -> Client {
        let stranger = self.stranger();
        let key = self.key.as_ref().unwrap();
        let said = stranger.post("/api/v1/enter", &json!({"key": key}));
        assert_eq!(said.status, 200, "{said:?}");
        stranger.with_cookie(&said)
    }

    pub(crate) fn stranger(&self) -> Client {
        Client {
            address: self.address(),
            cookie: None,
        }
    }

    /// Commands to the gate that moved something, so far.
    pub(crate) fn motions(&mut self) -> usize {
        let mut count = 0;
        while let Some(heard) = self.listener.heard() {
            if let Heard::Event(record) = heard
                && let News::Gate(
                    GateEvent::MoveBegan { .. }
                    | GateEvent::HomingBegan { .. }
                    | GateEvent::ChangeBegan { .. },
                ) = &record.news
            {
                count += 1;
            }
        }
        count
    }
}

/// A browser or a program.
#[derive(Clone)]
pub(crate) struct Client {
    pub(crate) address: SocketAddr,
    pub(crate) cookie: Option<String>,
}

#[derive(Debug)]
pub(crate) struct Said {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: Vec<u8>,
}

impl Said {
    pub(crate) fn json(&self) -> Value {
        let text = String::from_utf8_lossy(&self.body);
        serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {} {text}", self.head))
    }

    pub(crate) fn code(&self) -> String {
        self.json()["code"].as_str().unwrap_or_default().to_owned()
    }

    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        self.head.lines().find_map(|line| {
            let (key, value) = line.split_once(": ")?;
            key.eq_ignore_ascii_case(name).then_some(value)
        })
    }
}

impl Client {
    pub(crate) fn with_cookie(&self, said: &Said) -> Self {
        let cookie = said.header("set-cookie").unwrap();
        assert!(cookie.contains("HttpOnly; SameSite=Strict"), "{cookie}");
        Self {
            cookie: Some(cookie.split(';').next().unwrap().to_owned()),
            ..self.clone()
        }
    }

    /// One request as bytes say it, on a connection of its own.
    pub(crate) fn raw(&self, request: &[u8]) -> Said {
        let mut stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.write_all(request).unwrap();
        let mut answer = Vec::new();
        // Who is refused before all was said may hear of it as a reset.
        let _ = stream.read_to_end(&mut answer);
        let end = answer.windows(4).position(|w| w == b"\r\n\r\n");
        let end = end.unwrap_or_else(|| panic!("no answer: {}", String::from_utf8_lossy(&answer)));
        let head = String::from_utf8_lossy(&answer[..end]).into_owned();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        let mut body = answer[end + 4..].to_vec();
        if head.to_lowercase().contains("transfer-encoding: chunked") {
            body = dechunked(&body);
        }
        Said { status, head, body }
    }

    /// `headers` go before those that a browser sends, and replace them by name.
    pub(crate) fn with(
        &self,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: &str,
    ) -> Said {
        let host = self.address.to_string();
        let cookie = self.cookie.clone().unwrap_or_default();
        let usual = [
            ("host", host.as_str()),
            ("content-type", "application/json"),
            ("cookie", cookie.as_str()),
        ];
        let named = |name: &str| headers.iter().any(|(n, _)| n.eq_ignore_ascii_case(name));
        let all = usual.iter().filter(|(name, _)| !named(name)).chain(headers);
        let lines: String = all
            .map(|(name, value)| format!("{name}: {value}\r\n"))
            .collect();
        let length = body.len();
        let request = format!(
            "{method} {path} HTTP/1.1\r\n{lines}connection: close\r\ncontent-length: {length}\r\n\r\n{body}"
        );
        self.raw(request.as_bytes())
    }

    pub(crate) fn get(&self, path: &str) -> Said {
        self.with("GET", path, &[], "")
    }

    pub(crate) fn post(&self, path: &str, body: &Value) -> Said {
        self.with("POST", path, &[], &body.to_string())
    }

    pub(crate) fn state(&self) -> Value {
        self.get("/api/v1/state").json()
    }

    /// Starts a job, and its number.
    pub(crate) fn start(&self, job: &Value) -> u64 {
        let said = self.post("/api/v1/jobs", job);
        assert_eq!(said.status, 202, "{} {}", said.head, said.json());
        said.json()["id"].as_u64().unwrap()
    }

    pub(crate) fn job(&self, id: u64) -> Value {
        self.get(&format!("/api/v1/jobs/{id}")).json()
    }

    /// Waits for a job's end.
    pub(crate) fn ended(&self, id: u64) -> Value {
        self.ended_while(id, || {})
    }

    fn ended_while(&self, id: u64, mut meanwhile: impl FnMut()) -> Value {
        let began = Instant::now();
        loop {
            let job = self.job(id);
            meanwhile();
            if job["state"]["state"] == "ended" {
                return job;
            }
            assert!(began.elapsed() < PATIENCE, "{job}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub(crate) fn run(&self, job: &Value) -> Value {
        // As a page does that is open, however busy the computer is.
        let mut said = Instant::now();
        self.ended_while(self.start(job), || {
            if said.elapsed() > Duration::from_secs(3) {
                said = Instant::now();
                self.post("/api/v1/lease", &json!({}));
            }
        })
    }

    pub(crate) fn socket(&self) -> Socket {
        let url = format!("ws://{}/api/v1/live", self.address);
        let mut request = url.into_client_request().unwrap();
        let cookie = self.cookie.clone().unwrap_or_default();
        request
            .headers_mut()
            .insert("cookie", cookie.parse().unwrap());
        let stream = TcpStream::connect(self.address).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        let (socket, _) = tungstenite::client(request, stream).unwrap();
        Socket(socket)
    }
}

fn dechunked(mut rest: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    while let Some(line) = rest.windows(2).position(|w| w == b"\r\n") {
        let size = std::str::from_utf8(&rest[..line]).unwrap();
        let size = usize::from_str_radix(size, 16).unwrap();
        body.extend(&rest[line + 2..line + 2 + size]);
        rest = &rest[line + 4 + size..];
    }
    body
}

/// A frame as it came.
pub(crate) struct Frame {
    pub(crate) head: Value,
    pub(crate) jpeg: Vec<u8>,
}

pub(crate) struct Socket(pub(crate) WebSocket<TcpStream>);

pub(crate) enum Came {
    Text(Value),
    Frame(Frame),
}

impl Socket {
    pub(crate) fn say(&mut self, what: &Value) {
        self.0.send(Message::text(what.to_string())).unwrap();
    }

    pub(crate) fn next(&mut self) -> Came {
        loop {
            match self.0.read().unwrap() {
                Message::Text(text) => return Came::Text(serde_json::from_str(&text).unwrap()),
                Message::Binary(bytes) => {
                    let head = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
                    return Came::Frame(Frame {
                        head: serde_json::from_slice(&bytes[4..4 + head]).unwrap(),
                        jpeg: bytes[4 + head..].to_vec(),
                    });
                }
                _ => {}
            }
        }
    }

    /// The next message of that type.
    pub(crate) fn text(&mut self, kind: &str) -> Value {
        loop {
            if let Came::Text(text) = self.next()
                && text["type"] == kind
            {
                return text;
            }
        }
    }

    pub(crate) fn frame(&mut self) -> Frame {
        loop {
            if let Came::Frame(frame) = self.next() {
                return frame;
            }
        }
    }
}
