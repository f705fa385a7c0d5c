//! An instrument that is served, and commands beside it.
#![cfg(feature = "serve")]

mod common;

use common::{code, scopeservo, stderr};
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

/// The instrument of a folder, served until it is dropped.
struct Served(Child);

impl Served {
    fn new(here: &Path) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_scopeservo"))
            .current_dir(here)
            .args(["serve", "--listen", "127.0.0.1:0"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let out = child.stdout.take().unwrap();
        let mut out = BufReader::new(out);
        out.read_line(&mut line).unwrap();
        assert!(line.starts_with("open http://127.0.0.1:"), "{line}");
        // Nobody reads the rest: the program must not mind.
        Self(child)
    }

    fn end(mut self) {
        let id = self.0.id().to_string();
        Command::new("kill").args(["-INT", &id]).status().unwrap();
        assert!(self.0.wait().unwrap().success());
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn commands_are_done_by_the_program_that_serves_the_instrument() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    assert_eq!(code(&scopeservo(here, &["init", "--twin"])), 0);
    let served = Served::new(here);
    let door = here.join("scopeservo-data/server/door.json");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let mode = door.metadata().unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "others can read what opens it");
    }
    let status = scopeservo(here, &["status"]);
    assert_eq!(code(&status), 0, "{}", stderr(&status));
    assert!(
        stdout(&status).contains("served at http://127.0.0.1:"),
        "{}",
        stdout(&status)
    );
    let turned = scopeservo(here, &["objective", "40x"]);
    assert_eq!(code(&turned), 0, "{}", stderr(&turned));
    let saved = scopeservo(here, &["target", "save", "mitosis-3", "--focus"]);
    assert_eq!(code(&saved), 0, "{}", stderr(&saved));
    let back = scopeservo(here, &["reposition", "mitosis-3", "--json"]);
    assert_eq!(code(&back), 0, "{}", stderr(&back));
    let answer: serde_json::Value = serde_json::from_str(&stdout(&back)).unwrap();
    assert_eq!(answer["verdict"], "arrived", "{answer}");
    assert!(answer["served_at"].is_string(), "{answer}");
    // What is refused there is refused here, with its sentence; so is what cannot be passed on.
    let beyond = scopeservo(here, &["stage", "go", "--x-um", "99999"]);
    assert_eq!(code(&beyond), 3, "{}", stderr(&beyond));
    assert!(stderr(&beyond).contains("outside"), "{}", stderr(&beyond));
    let none = scopeservo(here, &["reposition", "nothing"]);
    assert!(
        stderr(&none).contains("there is no target 'nothing'"),
        "{}",
        stderr(&none)
    );
    let other = scopeservo(here, &["reposition", "mitosis-3", "--method", "paper"]);
    assert_eq!(code(&other), 2);
    assert!(
        stderr(&other).contains("--method is not passed on"),
        "{}",
        stderr(&other)
    );
    // What no server does is refused while it has the instrument, and done after.
    let level = scopeservo(here, &["level"]);
    assert_eq!(code(&level), 3, "{}", stderr(&level));
    served.end();
    assert!(!door.exists());
    let status = scopeservo(here, &["status"]);
    assert!(
        !stdout(&status).contains("served at"),
        "{}",
        stdout(&status)
    );
    assert_eq!(code(&status), 0, "{}", stderr(&status));
    // One that was killed leaves its door, and bars nobody's way.
    drop(Served::new(here));
    assert!(door.exists());
    let status = scopeservo(here, &["status"]);
    assert_eq!(code(&status), 0, "{}", stderr(&status));
    assert!(
        !stdout(&status).contains("served at"),
        "{}",
        stdout(&status)
    );
}

#[cfg(unix)]
#[test]
fn ctrl_c_at_a_command_stops_the_job_that_the_server_does_for_it() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let text = "name = \"bench\"\n[drivers.twin.twin]\nseed = 3\nreal_time = true\n[devices]\nstage = \"twin\"\ncamera = \"twin\"\nnosepiece = \"twin\"\n\
                [limits]\nx_um = [-17000, 17000]\ny_um = [-16000, 16000]\nz_um = [-3000, 500]\n[objective_change]\nretract_z_um = -2000\nmargin_um = 50\n";
    std::fs::write(here.join("scopeservo.toml"), text).unwrap();
    let served = Served::new(here);
    let status = || common::ok(here, &["status", "--json"]);
    let mut goes = Command::new(env!("CARGO_BIN_EXE_scopeservo"))
        .current_dir(here)
        .args(["stage", "go", "--x-um", "16000"])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    while status()["moving"] != true {
        assert!(goes.try_wait().unwrap().is_none(), "it never moved");
    }
    let id = goes.id().to_string();
    Command::new("kill").args(["-INT", &id]).status().unwrap();
    let ended = goes.wait_with_output().unwrap();
    assert_eq!(code(&ended), 1, "{}", stderr(&ended));
    assert!(
        stderr(&ended).contains("stopped on request"),
        "{}",
        stderr(&ended)
    );
    let now = status();
    assert_eq!(now["moving"], false, "{now}");
    assert!(now["at"]["x_um"].as_f64().unwrap() < 15_900.0, "{now}");
    assert_eq!(now["jobs"][0]["state"]["how"], "stopped", "{now}");
    served.end();
}
