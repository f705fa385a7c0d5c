//! A document's commands: those in its fences, and those between backticks in its sentences.
//!
//! A fence of commands says what it needs: `sh` nothing, it runs as it stands; `sh device` a device that is not simulated; `sh install` something
//! from the network; `sh ci` is a step of CI itself. Words in capitals stand for what the reader puts there.

use std::fs;
use std::path::Path;

/// A fenced block.
#[derive(Debug, Clone)]
pub struct Fence {
    /// What follows the backticks.
    pub info: String,
    /// Its lines.
    pub body: String,
}

/// A page of the repository.
pub fn page(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .join(name);
    fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Its fences, in order.
pub fn fences(text: &str) -> Vec<Fence> {
    let mut all = Vec::new();
    let mut open: Option<Fence> = None;
    for line in text.lines() {
        match (line.trim_start().strip_prefix("```"), &mut open) {
            (Some(_), Some(_)) => all.extend(open.take()),
            (Some(info), None) => {
                open = Some(Fence {
                    info: info.trim().into(),
                    body: String::new(),
                });
            }
            (None, Some(fence)) => fence.body += &format!("{line}\n"),
            (None, None) => {}
        }
    }
    all
}

/// What stands between backticks in its sentences, in order.
pub fn inline(text: &str) -> Vec<String> {
    let mut sentences = String::new();
    let mut in_fence = false;
    for line in text.lines() {
        match line.trim_start().starts_with("```") {
            true => in_fence = !in_fence,
            false if in_fence => {}
            false => sentences += &format!("{line} "),
        }
    }
    let quoted = sentences.split('`').skip(1).step_by(2);
    quoted.map(str::to_owned).collect()
}

/// The commands of this program in a block: up to a comment, a pipe, or what follows.
pub fn commands(block: &str) -> Vec<String> {
    let whole = block.replace("\\\n", " ");
    let lines = whole.lines().flat_map(|line| {
        let line = line.split(" #").next().unwrap_or(line);
        let parts = line
            .split("&&")
            .flat_map(|part| part.split(['|', ';', '>']));
        parts.map(str::trim).collect::<Vec<_>>()
    });
    let ours = lines.filter_map(|line| {
        let cargo = line.strip_prefix("cargo run --release -- ");
        let ours = cargo.map(|rest| format!("scopeservo {rest}"));
        ours.or_else(|| line.starts_with("scopeservo ").then(|| line.to_owned()))
    });
    ours.collect()
}

/// What a reader may put for the words in capitals.
pub fn filled(command: &str) -> String {
    let words = command.split_whitespace().map(|word| match word {
        "ID" => "10x",
        "NAME" => "spare",
        "FILE" => "mitosis-3.target",
        "DIR" => "elsewhere",
        "VIEW" => "view.png",
        "TARGET" => "target.png",
        "MEDIUM" => "water",
        "X,Y" => "120,-80",
        "N,M" => "0,0",
        "F" => "0.5",
        "N" => "2",
        "T" | "X" | "Y" | "Z" | "UM" | "DEG" => "1",
        "ADDRESS" => "127.0.0.1:7414",
        word => word,
    });
    words.collect::<Vec<_>>().join(" ")
}
