//! An instrument that a server has: the command is done there, so that two programs never fight for it.

use crate::answer::Answer;
use crate::args::{Command, InstrumentArgs, StageCommand, TargetCommand};
use crate::bar;
use crate::error::CliError;
use scopeservo_setup::Config;
use serde::Deserialize;
use serde_json::{Value, json};
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// The file that a server leaves while it serves, below the data folder.
const DOOR: &str = "server/door.json";
/// No such file is larger, bytes.
const LARGEST: u64 = 1 << 16;
/// How long a server has to answer.
const PATIENCE: Duration = Duration::from_secs(30);
/// How often it is asked whether the job has ended.
const LOOK: Duration = Duration::from_millis(150);

/// Where the server is and what opens it.
#[derive(Debug, Clone, Deserialize)]
struct Door {
    address: String,
    token: String,
}

/// What a server can do of a command: where the instrument is described, the job, and the options that it passes on.
type Asked<'a> = (&'a InstrumentArgs, Value, &'static [&'static str]);

/// Those that every command may have: they say where, and how the answer is told.
const USUAL: [&str; 3] = ["--config", "--json", "--out"];

fn asked(command: &Command) -> Option<Asked<'_>> {
    Some(match command {
        Command::Status(args) => (&args.instrument, Value::Null, &[]),
        Command::Objective(args) => {
            let id = args.objective.as_ref()?;
            let job = json!({"job": "objective", "objective": id});
            (&args.instrument, job, &[])
        }
        Command::Focus(args) => {
            let job = json!({"job": "focus", "objective": args.objective});
            (&args.instrument, job, &["--objective"])
        }
        Command::Calibrate(args) => {
            let job = json!({"job": "calibrate", "objectives": args.objective});
            (&args.instrument, job, &["--objective"])
        }
        Command::Check(args) => (&args.instrument, json!({"job": "check"}), &[]),
        Command::Reposition(args) => {
            let job = json!({"job": "reposition", "target": args.name});
            (&args.instrument, job, &[])
        }
        Command::Stage(StageCommand::Go(args)) => {
            let to = scopeservo_protocol::Place::from(&args.to.pose());
            let options: &[&str] = &[
                "--x-um", "--y-um", "--z-um", "--rx-deg", "--ry-deg", "--rz-deg",
            ];
            (&args.instrument, json!({"job": "move", "to": to}), options)
        }
        Command::Target(TargetCommand::Save(args)) => {
            let job = json!({
                "job": "save_target",
                "name": args.name,
                "objective": args.objective,
                "focus": args.focus,
                "slide": args.slide,
                "note": args.note,
            });
            let options: &[&str] = &["--objective", "--focus", "--slide", "--note"];
            (&args.instrument, job, options)
        }
        _ => return None,
    })
}

/// Does the command at the server that has its instrument; `None` where there is none, or the command needs no instrument.
pub(crate) fn run(command: &Command, answer: &Answer) -> Option<Result<bool, CliError>> {
    let (instrument, job, options) = asked(command)?;
    let config = Config::read(&instrument.description.config).ok()?;
    let door = door(&config.resolve(&config.data_folder).join(DOOR))?;
    // One that was killed left its door.
    let state = door.ask("GET", "/api/v1/state", &Value::Null).ok()?;
    Some(at(&door, &job, options, state, answer))
}

fn door(file: &Path) -> Option<Door> {
    let bytes = scopeservo_files::read(file, LARGEST).ok()?;
    serde_json::from_slice(&bytes).ok()
}

fn at(
    door: &Door,
    job: &Value,
    options: &[&str],
    state: Value,
    answer: &Answer,
) -> Result<bool, CliError> {
    let address = &door.address;
    let mut given = std::env::args().skip(1).take_while(|a| a != "--");
    let other = given.find(|arg| {
        let name = arg.split('=').next().unwrap_or_default();
        arg.starts_with("--") && !USUAL.contains(&name) && !options.contains(&name)
    });
    if let Some(other) = other {
        return Err(CliError::Usage(format!(
            "the instrument is served at http://{address}, and {other} is not passed on there: leave it out, or end that program first"
        )));
    }
    answer.put(json!({"served_at": address}));
    if job.is_null() {
        answer.put(state.clone());
        let owner = state["owner"].as_str().unwrap_or("nobody");
        say!(answer, "served at http://{address}; {owner} drives");
        say!(answer, "  stage      {}", state["at"]);
        say!(answer, "  objective  {}", state["objective"]);
        return Ok(true);
    }
    let interrupt = Arc::new(Interrupt::new(door));
    let pressed = interrupt.clone();
    answer.on_interrupt(move || pressed.press());
    let started = door.ask("POST", "/api/v1/jobs", job)?;
    let id = started["id"].as_u64();
    let id = id.ok_or_else(|| CliError::Internal(format!("the server said {started}")))?;
    interrupt.stops(id);
    let shown = bar::spinner(format!("at the server, http://{address}"));
    let ended = ended(door, id, &interrupt);
    shown.finish_and_clear();
    told(&ended?, answer)
}

/// Ctrl-C while the server has a job of ours: it stops that job from where it is pressed, and waits for nothing that is asked meanwhile.
struct Interrupt {
    door: Door,
    state: Mutex<Pressed>,
}

#[derive(Default)]
struct Pressed {
    /// The job, once the server has said which.
    id: Option<u64>,
    /// Before that was known.
    early: bool,
    failed: Option<CliError>,
}

impl Interrupt {
    fn new(door: &Door) -> Self {
        Self {
            door: door.clone(),
            state: Mutex::default(),
        }
    }

    fn state(&self) -> std::sync::MutexGuard<'_, Pressed> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn press(&self) {
        let id = {
            let mut state = self.state();
            state.early |= state.id.is_none();
            state.id
        };
        if let Some(id) = id {
            self.stop(id);
        }
    }

    /// From now on that job is stopped: at once, where Ctrl-C was pressed before.
    fn stops(&self, id: u64) {
        let early = {
            let mut state = self.state();
            state.id = Some(id);
            state.early
        };
        if early {
            self.stop(id);
        }
    }

    fn stop(&self, id: u64) {
        let path = format!("/api/v1/jobs/{id}/stop");
        if let Err(error) = self.door.ask("POST", &path, &json!({})) {
            self.state().failed = Some(error);
        }
    }

    fn failed(&self) -> Option<CliError> {
        self.state().failed.take()
    }
}

/// Waits for the end of a job. Whoever started it says that it is there.
fn ended(door: &Door, id: u64, interrupt: &Interrupt) -> Result<Value, CliError> {
    let path = format!("/api/v1/jobs/{id}");
    let mut looks = 0u32;
    loop {
        if let Some(error) = interrupt.failed() {
            return Err(error);
        }
        let job = door.ask("GET", &path, &Value::Null)?;
        if job["state"]["state"] == "ended" {
            return Ok(job);
        }
        if looks % 20 == 19 {
            // Somebody else may have taken the seat: then the job tells.
            let _ = door.ask("POST", "/api/v1/lease", &json!({}));
        }
        looks += 1;
        std::thread::sleep(LOOK);
    }
}

/// What came of it, and whether it is what was hoped for.
fn told(job: &Value, answer: &Answer) -> Result<bool, CliError> {
    if let Some(error) = job["error"].as_object() {
        let message = error["message"].as_str().unwrap_or("it failed").to_owned();
        return Err(match error["code"].as_str() {
            Some("stopped") => CliError::Interrupted,
            _ => CliError::AtServer(message),
        });
    }
    answer.put(job["answer"].clone());
    answer.put(json!({"run": job["run"]}));
    let verdict = job["answer"]["verdict"].as_str();
    match (verdict, job["answer"]["message"].as_str()) {
        (Some(verdict), message) => {
            let message = message.unwrap_or_default();
            say!(answer, "{}: {message}", verdict.replace('_', " "));
        }
        _ => say!(answer, "{} is done", job["kind"].as_str().unwrap_or("it")),
    }
    let is_good = job["answer"]["ok"].as_bool().unwrap_or(true);
    Ok(is_good && verdict.is_none_or(|verdict| verdict == "arrived"))
}

impl Door {
    /// One question, on a connection of its own.
    fn ask(&self, method: &str, path: &str, body: &Value) -> Result<Value, CliError> {
        let failed = |e: std::io::Error| {
            CliError::AtServer(format!(
                "the program that serves the instrument at {} does not answer: {e}",
                self.address
            ))
        };
        let text = match body {
            Value::Null => String::new(),
            body => body.to_string(),
        };
        let request = format!(
            "{method} {path} HTTP/1.1\r\nhost: {}\r\nauthorization: Bearer {}\r\ncontent-type: application/json\r\ncontent-length: {}\r\nconnection: close\r\n\r\n{text}",
            self.address,
            self.token,
            text.len()
        );
        let mut stream = TcpStream::connect(&self.address).map_err(failed)?;
        stream.set_read_timeout(Some(PATIENCE)).map_err(failed)?;
        stream.write_all(request.as_bytes()).map_err(failed)?;
        let mut said = Vec::new();
        stream.read_to_end(&mut said).map_err(failed)?;
        let said = String::from_utf8_lossy(&said);
        let (head, body) = said.split_once("\r\n\r\n").unwrap_or((&said, ""));
        let status = head.split(' ').nth(1).unwrap_or_default();
        let told: Value = serde_json::from_str(body).unwrap_or_default();
        match status.starts_with('2') {
            true => Ok(told),
            false => Err(CliError::AtServer(
                told["message"].as_str().unwrap_or("it refused").to_owned(),
            )),
        }
    }
}
