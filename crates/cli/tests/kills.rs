//! The program killed at any moment of a job, and the job resumed by a new one on the same microscope, which keeps its place: it ends as if
//! nothing had been. `SCOPESERVO_KILLS=300` for the long form.

mod common;

use common::served::{Served, serve_twin};
use common::{code, json, ok, scopeservo, stderr};
use scopeservo_geometry::SplitMix64;
#[cfg(target_os = "linux")]
use scopeservo_library::{Database, RunQuery};
use scopeservo_protocol::Driver;
use scopeservo_scope::{Axis, Clock, SystemClock};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// No state that is written before a step is larger.
const LARGEST_STATE: u64 = 20_000;
/// Where one ends by its own report: the stage scatters, and 0.0005 deg at the end of a lever of 125 mm are a micrometre, um.
const NOISE_UM: f64 = 3.0;

/// The simulated microscope, faster than life; it stays as it is when the program that drives it is killed.
fn serve(folder: &Path, speed: &str) -> Served {
    let described = folder.join("twin.toml");
    let text = "name = \"twin\"\n[drivers.twin.twin]\nseed = 4\nstage = \"xyz-theta\"\nobjectives = [\"40x\"]\n\
                [devices]\nstage = \"twin\"\ncamera = \"twin\"\nnosepiece = \"twin\"\n\
                [objective_change]\nretract_z_um = -2000\nmargin_um = 0\n";
    fs::write(described, text).unwrap();
    // A busy computer lets it drift no farther than an idle one.
    let patient = ["--speed", speed, "--idle-s", "0.3"];
    serve_twin(
        folder,
        &[&patient[..], &["--described-in", "twin.toml"]].concat(),
    )
}

fn describe(folder: &Path, address: &str) {
    let text = format!(
        "name = \"bench\"\n[drivers.main]\ntcp = \"{address}\"\n\
         [devices]\nstage = \"main\"\ncamera = \"main\"\nnosepiece = \"main\"\n\
         [limits]\nx_um = [-3000, 3000]\ny_um = [-3000, 3000]\n\
         [objective_change]\nretract_z_um = -2000\nmargin_um = 0\n"
    );
    fs::write(folder.join("scopeservo.toml"), text).unwrap();
}

fn go(folder: &Path, x_um: f64, y_um: f64) -> Value {
    let (x, y) = (format!("{x_um}"), format!("{y_um}"));
    ok(
        folder,
        &["stage", "go", "--x-um", &x, "--y-um", &y, "--json"],
    )["at"]
        .clone()
}

/// Where the stage says it is, um.
fn place(twin: &Served) -> [f64; 2] {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let driver = Driver::connect(&twin.address, None).unwrap();
    let stage = driver.devices(&clock).unwrap().stage.unwrap();
    let at = stage.position().unwrap();
    [Axis::X, Axis::Y].map(|axis| at.si(axis).unwrap() * 1e6)
}

/// Starts a job and kills its program after that time; whether it was still at work.
fn killed(folder: &Path, args: &[&str], after: Duration) -> bool {
    let mut child = Command::new(env!("CARGO_BIN_EXE_scopeservo"))
        .current_dir(folder)
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    std::thread::sleep(after);
    let at_work = child.try_wait().unwrap().is_none();
    let _ = child.kill();
    child.wait().unwrap();
    at_work
}

/// Kills a job once or more, and brings it to its end; how often something was left to go on with. `None` when no kill came in time.
fn killed_and_resumed(
    folder: &Path,
    args: &[&str],
    rng: &mut SplitMix64,
    whole: Duration,
) -> Option<(usize, Value)> {
    let mut after = || whole.mul_f64((rng.next_u64() % 1000) as f64 / 1000.0);
    if !killed(folder, args, after()) {
        return None;
    }
    let mut resumed = 0;
    let state = folder.join("scopeservo-data/journal/bench/state.json");
    for kill_again in [true, false] {
        let left = folder
            .join("scopeservo-data/journal/bench/head.json")
            .exists();
        if !left {
            // Killed before its first step, or after its last one.
            return None;
        }
        if let Ok(state) = fs::metadata(&state) {
            assert!(
                state.len() <= LARGEST_STATE,
                "a state of {} bytes",
                state.len()
            );
        } else {
            // Nothing had moved: it is begun anew.
            ok(folder, &["abandon", "--json"]);
            return None;
        }
        // Nothing else begins meanwhile.
        let other = scopeservo(folder, &["focus", "--json"]);
        assert_eq!(
            json(&other)["error"]["code"],
            "unfinished",
            "{}",
            stderr(&other)
        );
        resumed += 1;
        if kill_again && killed(folder, &["resume", "--json"], after()) {
            continue;
        }
        if !folder
            .join("scopeservo-data/journal/bench/head.json")
            .exists()
        {
            return None;
        }
        break;
    }
    Some((resumed, ok(folder, &["resume", "--json"])))
}

fn kills() -> usize {
    let told = std::env::var("SCOPESERVO_KILLS").ok();
    told.map_or(15, |n| n.parse().expect("a number of kills"))
}

/// Most of the time is the microscope's, so that three share the kills.
#[test]
fn a_job_that_is_killed_at_any_moment_ends_as_if_it_had_not_been() {
    let shares = [0, 1, 2].map(|k| std::thread::spawn(move || share(k)));
    for share in shares {
        share.join().expect("each ends as it should");
    }
}

fn share(number: usize) {
    let kills = kills() / 3 + usize::from(number < kills() % 3);
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let twin = serve(here, "10");
    describe(here, &twin.address);
    let mut rng = SplitMix64::new(20261126 + number as u64);
    let timed = |args: &[&str]| {
        let start = Instant::now();
        let answer = ok(here, args);
        (start.elapsed(), answer)
    };
    let calibrate = ["calibrate", "--json"];
    let reposition = ["reposition", "spot", "--lambda", "0.7", "--json"];
    ok(here, &["focus", "--json"]);
    let (calibrating, made) = timed(&calibrate);
    let scale = |made: &Value| {
        let one = &made["calibrations"][0]["calibration"];
        one["um_per_px"].as_f64().expect("a calibration was made")
    };
    let undisturbed = scale(&made);
    go(here, 100.0, 50.0);
    ok(here, &["target", "save", "spot", "--json"]);
    go(here, 130.0, 30.0);
    let (repositioning, _) = timed(&reposition);

    let (mut done, mut tried, mut resumed) = (0, 0, 0);
    let mut known: Option<([f64; 2], Instant)> = None;
    while done < kills {
        tried += 1;
        assert!(
            tried < 4 * kills + 20,
            "kills do not meet a job: {done} of {tried}"
        );
        let far = [100.0 + 0.03 * (rng.next_u64() % 1000) as f64, 35.0];
        let ended = match tried % 4 {
            0 => {
                let ended = killed_and_resumed(here, &calibrate, &mut rng, calibrating);
                if let Some((_, made)) = &ended {
                    let off = (scale(made) / undisturbed - 1.0).abs();
                    assert!(off < 0.02, "{off}");
                }
                ended
            }
            1 => {
                go(here, far[0], far[1]);
                let before = place(&twin);
                let name = format!("spot-{tried}");
                let save = ["target", "save", &name, "--json"];
                let whole = Duration::from_millis(1500);
                let ended = killed_and_resumed(here, &save, &mut rng, whole);
                if ended.is_some() {
                    let at = place(&twin);
                    let moved = f64::hypot(at[0] - before[0], at[1] - before[1]);
                    assert!(moved < NOISE_UM, "saved where it was: {moved}");
                    ok(here, &["reposition", &name, "--lambda", "0.7", "--json"]);
                }
                ended
            }
            _ => {
                // The simulated stage drifts, ten times as fast as in life: one that was not killed tells where it is now.
                let home = match known {
                    Some((home, at)) if at.elapsed() < Duration::from_secs(30) => home,
                    _ => {
                        ok(here, &reposition);
                        place(&twin)
                    }
                };
                known = known
                    .filter(|(at, _)| *at == home)
                    .or(Some((home, Instant::now())));
                go(here, far[0], far[1]);
                let ended = killed_and_resumed(here, &reposition, &mut rng, repositioning);
                if let Some((_, answer)) = &ended {
                    assert_eq!(answer["verdict"], "arrived", "{answer}");
                    let at = place(&twin);
                    let off = f64::hypot(at[0] - home[0], at[1] - home[1]);
                    assert!(off < NOISE_UM, "{at:?} {home:?}");
                }
                ended
            }
        };
        if let Some((times, _)) = ended {
            done += 1;
            resumed += times;
        }
    }
    assert!(resumed >= done);
}

#[test]
fn a_job_does_not_go_on_from_another_place_and_can_be_abandoned() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let twin = serve(here, "10");
    describe(here, &twin.address);
    assert_eq!(code(&scopeservo(here, &["resume"])), 2, "nothing is left");
    // Killed until it is met in the middle.
    let state = here.join("scopeservo-data/journal/bench/state.json");
    let mut after = Duration::from_millis(400);
    while !state.exists() {
        killed(here, &["calibrate", "--json"], after);
        after += Duration::from_millis(100);
        assert!(after < Duration::from_secs(20), "never met at work");
    }
    let told = scopeservo(here, &["target", "save", "spot", "--json"]);
    assert_eq!(code(&told), 3, "{}", stderr(&told));
    let message = json(&told)["error"]["message"].as_str().unwrap().to_owned();
    assert!(
        message.contains("calibrate") && message.contains("resume"),
        "{message}"
    );
    // Somebody moves the stage.
    go(here, 1500.0, -900.0);
    let refused = scopeservo(here, &["resume", "--json"]);
    assert_eq!(code(&refused), 3, "{}", stderr(&refused));
    let message = json(&refused)["error"]["message"]
        .as_str()
        .unwrap()
        .to_owned();
    assert!(message.contains("moved the stage"), "{message}");
    let ended = ok(here, &["abandon", "--json"]);
    assert!(ended["abandoned"].as_str().unwrap().contains("calibrate"));
    assert!(ok(here, &["abandon", "--json"])["abandoned"].is_null());
    // And another begins, whatever it comes to from there.
    let focus = scopeservo(here, &["focus", "--json"]);
    assert!([0, 3].contains(&code(&focus)), "{}", stderr(&focus));
    assert_ne!(json(&focus)["error"]["code"], "unfinished");
}

/// Kills a program that has its answer and cannot tell it: its reader takes no more.
#[cfg(target_os = "linux")]
fn killed_with_its_answer(folder: &Path, args: &[&str]) {
    let ended = || {
        let library = Database::new(folder.join("scopeservo-data"));
        let wanted = RunQuery {
            limit: 100,
            ..RunQuery::default()
        };
        let runs = library.runs(&wanted).unwrap();
        let logs = runs.iter().map(|run| library.run_events(&run.id).unwrap());
        logs.filter(|log| log.iter().any(|line| line.contains("job_ended")))
            .count()
    };
    let (reader, mut writer) = std::io::pipe().unwrap();
    let full = writer.try_clone().unwrap();
    std::thread::spawn(move || while std::io::Write::write(&mut writer, &[0; 4096]).is_ok() {});
    std::thread::sleep(Duration::from_millis(200));
    let before = ended();
    let mut child = Command::new(env!("CARGO_BIN_EXE_scopeservo"))
        .current_dir(folder)
        .args(args)
        .stdin(Stdio::null())
        .stdout(full)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let start = Instant::now();
    while ended() == before {
        assert!(start.elapsed() < Duration::from_secs(300), "{args:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_secs(1));
    assert!(child.try_wait().unwrap().is_none(), "it told its answer");
    child.kill().unwrap();
    child.wait().unwrap();
    drop(reader);
}

#[cfg(target_os = "linux")]
#[test]
fn an_answer_that_a_killed_program_had_is_given_by_the_next() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let twin = serve(here, "10");
    describe(here, &twin.address);
    ok(here, &["focus", "--json"]);
    killed_with_its_answer(here, &["calibrate", "--no-focus"]);
    let made = ok(here, &["resume", "--json"]);
    let file = made["calibrations"][0]["file"].as_str().unwrap();
    assert!(here.join(file).exists(), "{made}");
    assert!(ok(here, &["abandon", "--json"])["abandoned"].is_null());
    // What was kept before is not made again.
    killed_with_its_answer(here, &["target", "save", "spot"]);
    let saved = ok(here, &["resume", "--json"]);
    assert!(
        here.join(saved["file"].as_str().unwrap()).exists(),
        "{saved}"
    );
    let list = ok(here, &["target", "list", "--json"]);
    assert_eq!(list["targets"].as_array().unwrap().len(), 1, "{list}");
    go(here, 20.0, -10.0);
    killed_with_its_answer(here, &["reposition", "spot", "--lambda", "0.7"]);
    let at = place(&twin);
    let back = ok(here, &["resume", "--json"]);
    assert_eq!(back["verdict"], "arrived", "{back}");
    let now = place(&twin);
    let moved = f64::hypot(now[0] - at[0], now[1] - at[1]);
    assert!(moved < NOISE_UM, "it stood there already: {moved} um");
}

#[test]
fn two_instruments_of_one_name_never_share_a_journal() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    // In real time: there is time enough to meet it at work.
    let (first, second) = (serve(here, "1"), serve(here, "10"));
    describe(here, &second.address);
    fs::rename(here.join("scopeservo.toml"), here.join("second.toml")).unwrap();
    describe(here, &first.address);
    let mut at_work = Command::new(env!("CARGO_BIN_EXE_scopeservo"))
        .current_dir(here)
        .arg("calibrate")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let head = here.join("scopeservo-data/journal/bench/head.json");
    while !head.exists() {
        assert!(at_work.try_wait().unwrap().is_none(), "never met at work");
        std::thread::sleep(Duration::from_millis(20));
    }
    let by_second = ["--config", "second.toml", "--json"];
    for command in [&["focus"][..], &["resume"], &["abandon"]] {
        let refused = scopeservo(here, &[command, &by_second].concat());
        let error = json(&refused)["error"].clone();
        assert_eq!(error["code"], "in_use", "{command:?}: {error}");
        let message = error["message"].as_str().unwrap();
        let process = format!("process {}", at_work.id());
        assert!(
            message.contains("'bench'") && message.contains(&process),
            "{message}"
        );
    }
    assert!(head.exists() && at_work.try_wait().unwrap().is_none());
    at_work.kill().unwrap();
    at_work.wait().unwrap();
    // The name is free again, and what waits is told.
    let waits = scopeservo(here, &[&["focus"][..], &by_second].concat());
    assert_eq!(json(&waits)["error"]["code"], "unfinished");
    // With another name it is an instrument of its own.
    let text = fs::read_to_string(here.join("second.toml")).unwrap();
    let text = text.replace("\"bench\"", "\"other bench\"");
    fs::write(here.join("second.toml"), text).unwrap();
    ok(here, &[&["focus"][..], &by_second].concat());
}
