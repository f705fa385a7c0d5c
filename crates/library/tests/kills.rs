//! Programs that are killed while they write: whatever was acknowledged is there, and the library passes its check.

mod common;

use common::{calibration, keep, label};
use scopeservo_library::{Calibrations as _, Database, Targets as _};
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const WHERE: &str = "SCOPESERVO_WRITER";

/// What the program does that is killed: it keeps one thing after the other, and says each when it is kept.
#[test]
fn the_writer() {
    let Ok(place) = std::env::var(WHERE) else {
        return;
    };
    let (folder, who) = place.rsplit_once('|').unwrap();
    let library = Database::new(folder.into());
    let say = |what: &str| {
        let mut out = std::io::stdout().lock();
        writeln!(out, "KEPT {what}").unwrap();
        out.flush().unwrap();
    };
    for k in 0.. {
        let name = format!("{who}-{k}");
        keep(&library, &name, &label(&format!("slide {who}"), "a note")).unwrap();
        say(&format!("target {name}"));
        let id = common::run(&library, "reposition", &name, 20, name.as_bytes());
        say(&format!("run {id}"));
        library
            .keep_calibration("lab", &calibration(&name, 0.2), None, None)
            .unwrap();
        say(&format!("calibration {name}"));
        let to = format!("{name}-renamed");
        library.rename_target(&name, &to).unwrap();
        say(&format!("renamed {to}"));
        if k % 3 == 2 {
            library.remove_target(&to).unwrap();
            say(&format!("removed {to}"));
            library
                .purge_targets(Some(std::slice::from_ref(&to)))
                .unwrap();
            say(&format!("purged {to} {id}"));
        }
    }
}

fn start(folder: &Path, who: &str) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "the_writer", "--nocapture"])
        .env(WHERE, format!("{}|{who}", folder.display()))
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// What a program said before it was killed.
fn said(mut child: Child) -> Vec<String> {
    child.kill().unwrap();
    let out = child.stdout.take().unwrap();
    let lines = BufReader::new(out).lines().map_while(Result::ok);
    let kept = lines.filter_map(|line| Some(line.split_once("KEPT ")?.1.to_owned()));
    let kept = kept.collect();
    child.wait().unwrap();
    kept
}

#[test]
fn nothing_that_was_acknowledged_is_lost_when_programs_are_killed() {
    let kills: usize = std::env::var("SCOPESERVO_KILLS").map_or(20, |n| n.parse().unwrap());
    let dir = tempfile::tempdir().unwrap();
    let mut all = Vec::new();
    for kill in 0..kills {
        let two = [0, 1].map(|k| start(dir.path(), &format!("w{kill}-{k}")));
        // Any moment will do: the later ones are in the middle of things.
        std::thread::sleep(Duration::from_millis(20 + (kill as u64 * 37) % 130));
        for child in two {
            all.extend(said(child));
        }
    }
    let library = Database::new(dir.path().into());
    let checked = library.check(true, &mut |_, _| {}).unwrap();
    assert_eq!(checked.faults, [], "of {} acknowledged", all.len());
    let purged: Vec<&str> = all
        .iter()
        .filter_map(|s| s.strip_prefix("purged "))
        .collect();
    let is_purged = |word: &str| purged.iter().any(|p| p.split(' ').any(|w| w == word));
    for what in &all {
        let (kind, name) = what.split_once(' ').unwrap();
        let renamed = format!("{name}-renamed");
        match kind {
            "target" if is_purged(&renamed) => {}
            // Whoever was killed right after may have gone on without saying so.
            "target" => {
                let there = [name, renamed.as_str()]
                    .iter()
                    .any(|n| library.target(n).is_ok());
                let removed = library.bin().unwrap().iter().any(|row| row.name == renamed);
                let unsaid = all.contains(&format!("removed {renamed}"));
                assert!(there || removed || unsaid, "{what}");
            }
            "run" => {
                let there = library.run(name).is_ok_and(|run| run.ended.is_some());
                assert!(
                    there || is_purged(name) || purge_unsaid(&all, name),
                    "{what}"
                );
            }
            "calibration" => {
                let path =
                    library.calibration_path("lab", &scopeservo_scope::ObjectiveId(name.into()));
                assert!(path.unwrap().is_some(), "{what}");
            }
            _ => {}
        }
    }
    assert!(!all.is_empty());
}

/// Whether the run's target had been removed, and its purge was under way when the program was killed.
fn purge_unsaid(all: &[String], run: &str) -> bool {
    let at = all.iter().position(|s| s == &format!("run {run}")).unwrap();
    let removed = all[at..].iter().take(5).any(|s| s.starts_with("removed "));
    let purged = all[at..].iter().take(5).any(|s| s.starts_with("purged "));
    removed && !purged
}
