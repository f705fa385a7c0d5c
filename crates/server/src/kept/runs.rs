//! What was done, with its events and its page.

use crate::app::App;
use crate::error::ApiError;
use scopeservo_library::Runs as _;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// No file of a run that is read here is larger, bytes.
const LARGEST: u64 = 256 << 20;

fn read(path: &Path) -> Option<Value> {
    let bytes = scopeservo_files::read(path, LARGEST).ok()?;
    serde_json::from_slice(&bytes).ok()
}

fn name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

/// A run by its name.
fn place(app: &App, id: &str) -> Result<PathBuf, ApiError> {
    let all = app.bench.library.runs()?.into_iter();
    let mut found = all.filter(|path| name(path) == id);
    found
        .next()
        .ok_or_else(|| ApiError::missing(format!("there is no run '{id}'")))
}

fn told(path: &Path) -> Value {
    let head = read(&path.join("run.json")).unwrap_or_default();
    let answer = read(&path.join("answer.json"));
    let answer = answer.as_ref();
    let message = answer.and_then(|a| {
        let error = &a["error"];
        a["message"].as_str().or_else(|| error["message"].as_str())
    });
    json!({
        "id": name(path),
        "job": head["job"],
        "began": head["began"],
        "instrument": head["instrument"],
        "user": head["inputs"]["user"],
        "slide": head["inputs"]["slide"],
        "target": head["inputs"]["name"],
        "verdict": answer.map_or(Value::Null, |a| a["verdict"].clone()),
        "message": message,
        "seconds": answer.map_or(Value::Null, |a| a["seconds"].clone()),
        "ended": answer.is_some(),
        "report": path.join("report.html").is_file(),
    })
}

/// The newest ones, or those before one of them.
pub(crate) fn runs(app: &App, limit: usize, before: Option<&str>) -> Result<Value, ApiError> {
    let all = app.bench.library.runs()?.into_iter().rev();
    let older: Vec<PathBuf> = match before {
        None => all.take(limit).collect(),
        Some(before) => {
            let rest = all.skip_while(|path| name(path) != before).skip(1);
            rest.take(limit).collect()
        }
    };
    Ok(older.iter().map(|path| told(path)).collect())
}

/// One of them with its answer.
pub(crate) fn run(app: &App, id: &str) -> Result<Value, ApiError> {
    let path = place(app, id)?;
    let mut run = told(&path);
    run["answer"] = read(&path.join("answer.json")).unwrap_or_default();
    Ok(run)
}

/// What happened in it, as an array.
pub(crate) fn events(app: &App, id: &str) -> Result<Vec<u8>, ApiError> {
    let path = place(app, id)?.join("events.jsonl");
    let lines = scopeservo_files::read(&path, LARGEST);
    let lines = lines.map_err(|e| ApiError::missing(format!("{}: {e}", path.display())))?;
    let mut array = vec![b'['];
    for line in lines.split(|b| *b == b'\n').filter(|line| !line.is_empty()) {
        if array.len() > 1 {
            array.push(b',');
        }
        array.extend(line);
    }
    array.push(b']');
    Ok(array)
}

/// Its page.
pub(crate) fn report(app: &App, id: &str) -> Result<Vec<u8>, ApiError> {
    let path = place(app, id)?.join("report.html");
    scopeservo_files::read(&path, LARGEST)
        .map_err(|_| ApiError::missing(format!("the run '{id}' has no report")))
}
