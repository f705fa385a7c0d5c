//! What was done, with its events and its page.

use crate::app::App;
use crate::error::ApiError;
use scopeservo_library::{RunQuery, RunRow};
use serde_json::{Value, json};

/// No file of a run that is read here is larger, bytes.
const LARGEST: u64 = 256 << 20;

fn told(row: &RunRow) -> Value {
    json!({
        "id": row.id,
        "job": row.job,
        "began": row.began,
        "instrument": row.instrument,
        "user": row.user,
        "slide": row.slide,
        "target": row.target,
        "verdict": row.verdict,
        "message": row.message,
        "seconds": row.seconds,
        "ended": row.ended.is_some(),
        "report": row.report,
        "arrival": row.arrival,
        "pinned": row.pinned,
    })
}

/// The newest ones, or those before one of them; of a target, where one is named.
pub(crate) fn runs(app: &App, wanted: &RunQuery<'_>) -> Result<Value, ApiError> {
    let rows = app.bench.library.runs(wanted)?;
    Ok(rows.iter().map(told).collect())
}

/// One of them with its answer.
pub(crate) fn run(app: &App, id: &str) -> Result<Value, ApiError> {
    let mut run = told(&app.bench.library.run(id)?);
    let (_, answer) = app.bench.library.run_said(id)?;
    run["answer"] = answer.unwrap_or_default();
    Ok(run)
}

/// What happened in it, as an array.
pub(crate) fn events(app: &App, id: &str) -> Result<Vec<u8>, ApiError> {
    let events = app.bench.library.run_events(id)?;
    Ok(format!("[{}]", events.join(",")).into_bytes())
}

/// Its page.
pub(crate) fn report(app: &App, id: &str) -> Result<Vec<u8>, ApiError> {
    let none = || ApiError::missing(format!("the run '{id}' has no report"));
    let place = app.bench.library.run_file(id, "report.html")?;
    scopeservo_files::read(&place.ok_or_else(none)?, LARGEST).map_err(|_| none())
}

/// What the view looked like when it arrived.
pub(crate) fn arrival(app: &App, id: &str) -> Result<Vec<u8>, ApiError> {
    let none = || ApiError::missing(format!("the run '{id}' has no picture of an arrival"));
    let place = app.bench.library.run_file(id, "arrival.jpg")?;
    scopeservo_files::read(&place.ok_or_else(none)?, LARGEST).map_err(|_| none())
}

/// Its report stays whatever room it takes, or no longer.
pub(crate) fn pin(app: &App, id: &str, pinned: bool) -> Result<Value, ApiError> {
    app.bench.library.pin_run(id, pinned)?;
    run(app, id)
}
