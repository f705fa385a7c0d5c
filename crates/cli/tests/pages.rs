//! Every command that the pages tell people to type is run as it stands, in the order of the page, on the simulated instrument. The walk-through of
//! README.md, its picture and its figures are what comes of that; `SCOPESERVO_PAGES=write` writes them anew, without it they are compared.

#![cfg(unix)]
#![expect(clippy::print_stdout, reason = "a test may tell what it left out")]

mod common;
mod walk;

use common::page::{commands, fences, filled, inline, page};
use common::{save_gray8, tissue_gray};
use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A folder like the checkout of somebody who reads: with images of their own, the program on the path, and a cargo that runs it.
struct Reader {
    folder: tempfile::TempDir,
}

/// Building is what was done before this test; tests are not run by a test.
const CARGO: &str = "#!/bin/sh
case \"$*\" in
'run --release -- '*) shift 3; exec scopeservo \"$@\" ;;
'build '*) ;;
*) echo \"cargo $*: not by this test\" >&2; exit 9 ;;
esac
";

impl Reader {
    fn new() -> Self {
        let reader = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        let bin = reader.path("bin");
        fs::create_dir(&bin).unwrap();
        symlink(env!("CARGO_BIN_EXE_scopeservo"), bin.join("scopeservo")).unwrap();
        fs::write(bin.join("cargo"), CARGO).unwrap();
        fs::set_permissions(bin.join("cargo"), fs::Permissions::from_mode(0o755)).unwrap();
        let slide = tissue_gray(3, [0.0, 0.0], 2600, 2000);
        save_gray8(&reader.path("slide.png"), 2600, 2000, slide);
        for (name, centre) in [("target.png", [0.0, 0.0]), ("view.png", [20.0, -15.0])] {
            save_gray8(
                &reader.path(name),
                320,
                240,
                tissue_gray(3, centre, 320, 240),
            );
        }
        reader
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs what a page says in `folder`.
    fn types(&self, block: &str, folder: &Path) -> Output {
        let path = std::env::var("PATH").unwrap_or_default();
        let mut shell = Command::new("bash");
        shell
            .args(["-eu", "-o", "pipefail", "-c", block])
            .env("PATH", format!("{}:{path}", self.path("bin").display()))
            .env(
                "PYTHONPATH",
                Path::new(env!("CARGO_MANIFEST_DIR")).join("../../python"),
            )
            .env_remove("SCOPESERVO_CONFIG");
        shell.current_dir(folder).output().expect("bash is there")
    }

    /// The lines of a block of commands that must do what they say.
    fn done(&self, page: &str, block: &str) -> Vec<String> {
        let output = self.types(block, self.folder.path());
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        let wrong = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{page}:\n{block}\n{said}{wrong}");
        said.lines().map(str::to_owned).collect()
    }

    /// A command from within a sentence. It answers, be it by a refusal; it is never misused.
    fn mentions(&self, page: &str, command: &str) {
        let command = filled(command);
        let fresh = tempfile::tempdir().unwrap();
        // Whoever describes an instrument has none there yet.
        let folder = match command.starts_with("scopeservo init") {
            true => fresh.path(),
            false => self.folder.path(),
        };
        let output = self.types(&command, folder);
        let nothing_to_resume = command == "scopeservo resume" && output.status.code() == Some(2);
        let answered = matches!(output.status.code(), Some(0 | 3));
        assert!(
            answered || nothing_to_resume,
            "{page}: {command}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
}

/// The blocks of a page: what runs, and what is left out with the reason.
fn read(reader: &Reader, name: &str) {
    let text = page(name);
    for fence in fences(&text) {
        match &*fence.info {
            "sh" => {
                let needs_python = fence.body.contains("python3");
                if needs_python && !has_python() {
                    println!(
                        "{name}: left out, as there is no Python 3.10: {}",
                        fence.body
                    );
                } else {
                    reader.done(name, &fence.body);
                }
            }
            "sh device" | "sh install" | "sh ci" => {
                println!("{name}: left out ({}):\n{}", fence.info, fence.body)
            }
            "python" => fs::write(reader.path("my_driver.py"), &fence.body).unwrap(),
            _ => assert!(
                commands(&fence.body).is_empty(),
                "{name}: say what this needs:\n{}",
                fence.body
            ),
        }
    }
}

fn has_python() -> bool {
    let asked = Command::new("python3")
        .args(["-c", "import sys; sys.exit(sys.version_info < (3, 10))"])
        .status();
    asked.is_ok_and(|status| status.success())
}

#[test]
fn every_command_of_the_pages_runs_as_it_stands() {
    let reader = Reader::new();
    walk::through(&reader);
    // What the sentences speak of: an exported copy, whose name is free, and a target that may go.
    reader.done(
        "before the sentences",
        "scopeservo target export mitosis-3 mitosis-3.target; scopeservo target rename mitosis-3 spare",
    );
    let blocks = fences(&page("README.md"));
    let walked = blocks.iter().filter(|fence| fence.info == "sh");
    let mut said: Vec<String> = walked.flat_map(|fence| commands(&fence.body)).collect();
    for name in [
        "README.md",
        "docs/troubleshooting.md",
        "docs/adding-a-device.md",
    ] {
        for command in inline(&page(name)).iter().flat_map(|code| commands(code)) {
            if said.contains(&command) {
                continue;
            }
            match skipped(&command) {
                Some(why) => println!("{name}: {command}: {why}"),
                None => reader.mentions(name, &command),
            }
            said.push(command);
        }
    }
    for name in [
        "docs/adding-a-device.md",
        "docs/driver-protocol.md",
        "docs/hardware.md",
        "python/README.md",
    ] {
        read(&reader, name);
    }
}

/// Commands that other tests run, and why not here.
fn skipped(command: &str) -> Option<&'static str> {
    let all = [
        ("scopeservo grid", "over a pattern slide, by grid.rs"),
        (
            "scopeservo driver check",
            "with a driver of its own, by the pages about drivers",
        ),
        (
            "scopeservo twin serve",
            "does not end by itself; by twin tests",
        ),
        (
            "scopeservo serve",
            "does not end by itself; by serve.rs and the page's walk",
        ),
        ("scopeservo COMMAND", "stands for any command"),
    ];
    all.iter()
        .find(|(begin, _)| command.starts_with(begin))
        .map(|(_, why)| *why)
}
