//! A job begun for somebody: who may, what waits, and where it is kept.

use crate::app::App;
use crate::asked::{Case, Wish};
use crate::desk::Entry;
use crate::ending::{self, Task};
use crate::error::ApiError;
use crate::jog::{Hold, Way};
use crate::lock;
use crate::people::Caller;
use scopeservo_station::{JobId, UseCase as _};
use scopeservo_workbench::Asked;
use serde_json::json;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

/// Starts a job for somebody, who takes the seat if it is free. `stops`: the stops that there had been when it was asked for. A stop that came since is
/// meant for it too, however long it waited for a device.
///
/// # Errors
/// `busy` while another job is under way, `held` when somebody else drives, `unfinished` when a killed job waits, `stopped`.
pub(crate) fn start(
    app: &Arc<App>,
    caller: &Caller,
    wish: Wish,
    stops: u64,
) -> Result<JobId, ApiError> {
    let Wish {
        case,
        about,
        asked,
        damaged,
    } = wish;
    let kind = case.kind();
    let (entry, (task, job)) = app.desk.put(|| {
        if app.stops.load(Ordering::SeqCst) != stops {
            let message = "a stop came before it began: nothing was started. Start it again";
            return Err(ApiError::conflict("stopped", message));
        }
        let is_new = asked.as_ref().is_some_and(|asked| !asked.resumed);
        if let (true, Some(standing)) = (is_new, app.bench.waits()?) {
            return Err(ApiError::unfinished(&standing));
        }
        if asked.is_some() {
            // What cannot be kept is not begun.
            app.bench.library.try_room()?;
        }
        let lease = app.seat.take(caller)?;
        let asked = asked.map(|asked| with_names(app, caller, asked));
        let inputs = asked.as_ref().map(|asked| asked.inputs.clone());
        app.console.forget();
        let (record, lost) = match asked {
            Some(asked) => {
                let (record, lost) = app.bench.record(kind, asked);
                (Some(record), lost)
            }
            None => (None, None),
        };
        let hold = match &case {
            Case::Jog(jog) => Some((caller.key.clone(), jog.holder())),
            _ => None,
        };
        let job = app.console.session().start(&lease, case)?;
        // A stop counts first and then stops the jobs that there are: whichever of the two came first, this one does not go on.
        if app.stops.load(Ordering::SeqCst) != stops {
            let _ = job.handle().stop();
        }
        let entry = Arc::new(Entry {
            kind,
            owner: caller.user.clone(),
            about,
            handle: job.handle().clone(),
            end: Mutex::default(),
        });
        let task = Task {
            entry: entry.clone(),
            record,
            inputs,
            keeps_views: kind == "calibrate",
            is_whole: damaged.is_empty(),
            warnings: damaged
                .into_iter()
                .chain(lost.map(|lost| lost.to_string()))
                .collect(),
        };
        Ok((entry, hold, (task, job)))
    })?;
    let (id, mut task) = (entry.id(), task);
    // What the log cannot take keeps nobody from the instrument; it is told with the answer.
    let what = json!({"job": kind, "id": id, "about": entry.about});
    if let Err(error) = app.audit.note(caller, "started", what) {
        let warning = format!("the log of who moved what cannot be written: {error}");
        task.warnings.push(warning);
    }
    let app = app.clone();
    std::thread::spawn(move || ending::follow(&app, task, job));
    Ok(id)
}

/// Who asks and what lies on the stage belong to what is kept of it.
fn with_names(app: &App, caller: &Caller, mut asked: Asked) -> Asked {
    if !asked.resumed {
        asked.inputs["user"] = json!(caller.user);
        if asked.inputs["slide"].is_null() {
            asked.inputs["slide"] = json!(*lock(&app.slide));
        }
    }
    asked
}

/// Goes on that way while it is said again and again: a job that begins with the first word.
///
/// # Errors
/// As [`start`].
pub(crate) fn jog(app: &Arc<App>, caller: &Caller, way: Way, stops: u64) -> Result<(), ApiError> {
    if app.desk.goes_on(&caller.key, way)? {
        return Ok(());
    }
    let hold = Hold::default();
    hold.hold(way);
    start(app, caller, Wish::jog(&app.bench, hold), stops).map(drop)
}
