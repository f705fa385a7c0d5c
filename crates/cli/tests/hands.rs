//! Single steps by hand (status, snap, objective), what is done with targets and files without an instrument, and how it is shown.

mod common;

use common::{assert_bad_input, code, describe, json, ok, scopeservo, stderr};
use serde_json::Value;
use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn status_snap_and_objective_are_single_steps_within_the_rules() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, "made.blank = {}");
    let status = ok(here, &["status", "--json"]);
    assert_eq!(status["instrument"], "test bench");
    assert_eq!(status["simulated"], true);
    assert_eq!(status["at"]["x_um"], 0.0);
    assert_eq!(
        (&status["homed"], &status["moves"]),
        (&Value::Bool(true), &Value::Bool(false))
    );
    assert_eq!(status["objective"], "10x");
    assert!(status["outside"].is_null(), "{status}");
    let lines = stdout(&scopeservo(here, &["status"]));
    for word in [
        "test bench (simulated)",
        "objective  10x, of 10x, 20x, 40x",
        "640 x 480, 10.000 ms",
        "0 targets in",
    ] {
        assert!(lines.contains(word), "{word}: {lines}");
    }
    assert!(
        !here.join("scopeservo-data/library.sqlite3").exists(),
        "a look leaves no record"
    );

    let snapped = ok(here, &["snap", "before.png", "--json"]);
    assert_eq!(
        (&snapped["width"], &snapped["height"]),
        (&640.into(), &480.into())
    );
    let picture = image::open(here.join("before.png")).unwrap();
    assert_eq!((picture.width(), picture.height()), (640, 480));
    let before = fs::read(here.join("before.png")).unwrap();
    for file in ["before.png", "view.jpg", "view", "nowhere/view.png"] {
        assert_bad_input(here, &["snap", file]);
    }
    assert_eq!(fs::read(here.join("before.png")).unwrap(), before);

    assert_eq!(ok(here, &["objective", "--json"])["objective"], "10x");
    let turned = ok(here, &["objective", "40x", "--json"]);
    assert_eq!(turned["objective"], "40x");
    assert!(turned["at"]["z_um"].is_number(), "{turned}");
    let none = scopeservo(here, &["objective", "60x", "--json"]);
    assert_eq!(code(&none), 3);
    assert!(
        json(&none)["error"]["message"]
            .as_str()
            .unwrap()
            .contains("it carries 10x, 20x, 40x")
    );
    // Where a rule forbids it nothing turns.
    let text = fs::read_to_string(here.join("scopeservo.toml")).unwrap();
    fs::write(
        here.join("scopeservo.toml"),
        format!("{text}\n[limits_for.40x]\nz_um = [-100, 100]\n"),
    )
    .unwrap();
    let refused = scopeservo(here, &["objective", "40x"]);
    assert_eq!(code(&refused), 2);
    assert!(
        stderr(&refused).contains("limits_for.40x: the limits of 40x leave out"),
        "{}",
        stderr(&refused)
    );
}

#[test]
fn a_target_is_shown_renamed_removed_and_taken_in_again() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    describe(here, "stage = \"xy\"\nobjectives = [\"40x\"]\n");
    ok(here, &["target", "save", "spot", "--json"]);
    let shown = ok(here, &["target", "show", "spot", "--json"]);
    assert_eq!(
        (&shown["name"], &shown["objective"]),
        (&"spot".into(), &"40x".into())
    );
    assert_eq!(shown["stage"]["x_um"], 0.0);
    assert_eq!(shown["size_px"], serde_json::json!([640, 480]));
    assert_eq!(shown["calibrated"], false);
    let lines = stdout(&scopeservo(here, &["target", "show", "spot"]));
    for word in [
        "objective  40x",
        "640 x 480 px of 0.51",
        "as engraved",
        "coming back is expected in",
    ] {
        assert!(lines.contains(word), "{word}: {lines}");
    }
    let short = ok(here, &["target", "list", "--json"]);
    let long = ok(here, &["target", "list", "--long", "--json"]);
    assert!(short["targets"][0].get("file").is_none() && long["targets"][0]["file"].is_string());
    assert_eq!(long["targets"][0]["id"], shown["id"]);

    let renamed = ok(here, &["target", "rename", "spot", "mitosis-3", "--json"]);
    assert_eq!(
        (&renamed["before"], &renamed["name"]),
        (&"spot".into(), &"mitosis-3".into())
    );
    assert_eq!(
        ok(here, &["target", "show", "mitosis-3", "--json"])["id"],
        shown["id"]
    );
    for (from, to) in [
        ("spot", "new"),
        ("mitosis-3", "con"),
        ("mitosis-3", "a."),
        ("mitosis-3", "MITOSIS-3"),
    ] {
        assert_bad_input(here, &["target", "rename", from, to]);
    }
    // None goes when one of them is not there.
    assert_bad_input(here, &["target", "remove", "mitosis-3", "nothing"]);
    let removed = ok(here, &["target", "remove", "mitosis-3", "--json"]);
    assert_eq!(removed["removed"][0]["name"], "mitosis-3");
    assert_eq!(
        ok(here, &["target", "list", "--json"])["targets"]
            .as_array()
            .unwrap()
            .len(),
        0
    );
    ok(
        here,
        &["target", "restore", "mitosis-3", "--as", "again", "--json"],
    );
    assert_eq!(
        ok(here, &["target", "show", "again", "--json"])["id"],
        shown["id"]
    );
}

#[test]
fn names_that_cannot_be_found_again_are_refused_before_the_instrument_is_opened() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    // Nobody answers there: whoever opened it would say so.
    let text = "name = \"b\"\n[drivers.d]\ntcp = \"127.0.0.1:9\"\n[devices]\nstage = \"d\"\ncamera = \"d\"\nnosepiece = \"d\"\n";
    fs::write(here.join("scopeservo.toml"), text).unwrap();
    let (long, longer) = ("a".repeat(251), "b".repeat(10_000));
    for name in [
        "CON",
        "con.",
        "nul.txt",
        "a.",
        "a ",
        "-rf",
        "--json",
        "..",
        "a/b",
        "a\\b",
        "e\u{301}",
        "\u{1f52c}",
        "a\u{7}",
        "",
        &long,
        &longer,
    ] {
        let output = scopeservo(here, &["target", "save", "--", name]);
        assert_eq!(code(&output), 2, "{name:?}: {}", stderr(&output));
        let said = stderr(&output);
        assert!(said.contains("like mitosis-3"), "{name:?}: {said}");
    }
}

#[test]
fn a_link_that_leads_nowhere_is_told_as_one() {
    #[cfg(unix)]
    {
        let dir = tempfile::tempdir().unwrap();
        let here = dir.path();
        describe(here, "made.blank = {}");
        fs::create_dir_all(here.join("scopeservo-data/targets")).unwrap();
        std::os::unix::fs::symlink("gone", here.join("scopeservo-data/targets/dang.target"))
            .unwrap();
        for args in [
            ["reposition", "dang"].as_slice(),
            &["target", "show", "dang"],
            &["target", "export", "dang", "x.target"],
        ] {
            let output = scopeservo(here, args);
            assert_eq!(code(&output), 2);
            let said = stderr(&output);
            assert!(
                said.contains("it is a link to gone, which is not there"),
                "{said}"
            );
        }
        // It hides nothing, and is told until it is gone.
        assert_eq!(code(&scopeservo(here, &["target", "list"])), 0);
        fs::remove_file(here.join("scopeservo-data/targets/dang.target")).unwrap();
        let list = scopeservo(here, &["target", "list"]);
        assert!(stdout(&list).contains("no target is saved yet") && stderr(&list).is_empty());
    }
}

#[test]
fn numbers_that_no_instrument_has_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    for degrees in ["1e300", "-1e300", "361", "nan", "inf"] {
        assert_bad_input(here, &["demo", "--start-deg", degrees]);
    }
    for (twin, line) in [
        ("turned_deg = 1e300", 2),
        ("turned_deg = -400", 2),
        ("centre_um = [1e300, 0]", 2),
    ] {
        describe(here, twin);
        let output = scopeservo(here, &["status"]);
        assert_eq!(code(&output), 2);
        let said = stderr(&output);
        let begins = format!("scopeservo: scopeservo.toml:{line}: drivers.twin.twin: ");
        assert!(said.starts_with(&begins), "{said}");
    }
    // Outside of its limits a stage is not swept from no number to no number.
    describe(here, "");
    let text = fs::read_to_string(here.join("scopeservo.toml")).unwrap();
    let text = text.replace("retract_z_um = -2000\nmargin_um = 0", "anywhere = true");
    fs::write(
        here.join("scopeservo.toml"),
        format!("{text}\n[limits]\nz_um = [100, 500]\n"),
    )
    .unwrap();
    let output = scopeservo(here, &["focus"]);
    assert_eq!(code(&output), 3);
    let said = stderr(&output);
    assert!(
        said.contains("z is at 0.0 um, outside 100.0 to 500.0 um") && !said.contains("NaN"),
        "{said}"
    );
    let status = ok(here, &["status", "--json"]);
    assert!(
        status["outside"]
            .as_str()
            .unwrap()
            .contains("100.0 to 500.0"),
        "{status}"
    );
}

/// Runs it with lines on stdin and settings of its environment.
fn run(folder: &Path, args: &[&str], lines: &str, environment: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_scopeservo"));
    for name in ["NO_COLOR", "CLICOLOR", "CLICOLOR_FORCE"] {
        command.env_remove(name);
    }
    let mut child = command
        .current_dir(folder)
        .args(args)
        .envs(environment.iter().copied())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Who has no questions reads no answers.
    let _ = child.stdin.take().unwrap().write_all(lines.as_bytes());
    child.wait_with_output().unwrap()
}

#[test]
fn verdicts_have_colours_for_people_who_want_them() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let blank = image::GrayImage::from_pixel(64, 64, image::Luma([128]));
    blank.save(here.join("a.png")).unwrap();
    let register = |environment: &[(&str, &str)]| {
        let output = run(here, &["register", "a.png", "a.png"], "", environment);
        assert_eq!(code(&output), 3, "{}", stderr(&output));
        stdout(&output)
    };
    let forced = ("CLICOLOR_FORCE", "1");
    assert!(register(&[forced]).contains("\u{1b}[31mnot found\u{1b}[0m: "));
    // To a file, and for who asks for none, however loudly others ask.
    for environment in [
        &[][..],
        &[("NO_COLOR", "1")],
        &[("NO_COLOR", "yes"), forced],
        &[("CLICOLOR", "0")],
    ] {
        let said = register(environment);
        assert!(
            said.starts_with("not found: ") && !said.contains('\u{1b}'),
            "{environment:?}: {said:?}"
        );
    }
}

#[test]
fn it_calls_itself_by_its_name_and_tells_shells_and_manuals_about_itself() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let version = stdout(&scopeservo(here, &["--version"]));
    assert_eq!(
        version.trim(),
        format!("scopeservo {}", env!("CARGO_PKG_VERSION"))
    );
    let help = stdout(&scopeservo(here, &["--help"]));
    assert!(
        help.starts_with("Brings a motorised microscope back"),
        "{help}"
    );
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = stdout(&scopeservo(here, &["completions", shell]));
        assert!(
            script.contains("reposition") && script.contains("scopeservo"),
            "{shell}"
        );
    }
    assert_bad_input(here, &["completions", "tcsh"]);
    assert!(stdout(&scopeservo(here, &["man"])).contains(".TH scopeservo 1"));
    assert_eq!(code(&scopeservo(here, &["man", "--out", "pages"])), 0);
    assert!(here.join("pages/scopeservo-target-save.1").exists());
}

#[test]
fn init_asks_and_writes_what_was_answered_or_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let answers = "Upstairs\n\n\n\nnone\n10x 100 0.25 1.1\n\n-8000 8000\n\n\n";
    let output = run(here, &["init", "--ask"], answers, &[]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let text = fs::read_to_string(here.join("scopeservo.toml")).unwrap();
    assert!(
        text.contains("name = 'Upstairs'") && text.contains("x_um = [-8000, 8000]"),
        "{text}"
    );
    // None is overwritten, whatever is answered, and half an answer is none.
    let again = run(here, &["init", "--ask"], answers, &[]);
    assert_eq!(code(&again), 2, "{}", stderr(&again));
    assert_eq!(
        fs::read_to_string(here.join("scopeservo.toml")).unwrap(),
        text
    );
    for (file, answers) in [
        ("a.toml", ""),
        ("b.toml", "Upstairs\ngcs2\n"),
        ("c.toml", "Upstairs\n\n\n\nnone\n10x 100 50 1.1\n\n\n\n\n"),
    ] {
        let output = run(here, &["init", "--ask", file], answers, &[]);
        assert_eq!(code(&output), 2);
        assert!(
            stderr(&output).contains("nothing was written"),
            "{}",
            stderr(&output)
        );
        assert!(!here.join(file).exists());
    }
}
