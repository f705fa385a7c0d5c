//! The desk: one job at a time, and the last hundred that were done.

use crate::app::App;
use crate::asked::{Case, Wish};
use crate::ending;
use crate::error::ApiError;
use crate::jog::Hold;
use crate::lock;
use crate::people::Caller;
use scopeservo_station::{Ended, JobHandle, JobId, JobState, UseCase as _};
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// So many jobs are remembered.
const REMEMBERED: usize = 100;

/// One job.
pub(crate) struct Entry {
    pub(crate) kind: &'static str,
    pub(crate) owner: String,
    pub(crate) about: Option<String>,
    pub(crate) handle: JobHandle,
    end: Mutex<Option<End>>,
}

/// What became of it: told when all that is to be kept is kept.
#[derive(Debug, Clone)]
pub(crate) struct End {
    pub(crate) answer: Option<Value>,
    pub(crate) error: Option<ApiError>,
    /// The record of the run.
    pub(crate) run: Option<String>,
}

impl Entry {
    pub(crate) fn id(&self) -> JobId {
        self.handle.id()
    }

    pub(crate) fn is_over(&self) -> bool {
        lock(&self.end).is_some()
    }

    pub(crate) fn finish(&self, end: End) {
        *lock(&self.end) = Some(end);
    }

    /// How it stands: over only when its answer is kept.
    fn state(&self) -> JobState {
        match self.handle.state() {
            JobState::Ended(_) if !self.is_over() => JobState::Running,
            state => state,
        }
    }

    /// In few words.
    pub(crate) fn summary(&self) -> Value {
        json!({
            "id": self.id(),
            "kind": self.kind,
            "owner": self.owner,
            "about": self.about,
            "state": self.state(),
        })
    }

    /// With what came of it.
    pub(crate) fn whole(&self) -> Value {
        let mut whole = self.summary();
        let end = lock(&self.end).clone();
        let end = end.as_ref();
        whole["answer"] = json!(end.and_then(|e| e.answer.clone()));
        whole["error"] = json!(end.and_then(|e| e.error.clone()));
        whole["run"] = json!(end.and_then(|e| e.run.clone()));
        whole
    }

    /// Whether it is a step by hand, during which the live view goes on by itself.
    pub(crate) fn is_by_hand(&self) -> bool {
        matches!(self.kind, "move" | "centre" | "objective" | "home" | "jog")
    }
}

/// The desk.
#[derive(Default)]
pub(crate) struct Desk(Mutex<Inner>);

#[derive(Default)]
struct Inner {
    entries: VecDeque<Arc<Entry>>,
    /// Held to move, while that job is under way.
    hold: Option<(String, Hold)>,
}

impl Desk {
    /// Whether nothing is under way.
    ///
    /// # Errors
    /// `busy`.
    pub(crate) fn is_free(&self) -> Result<(), ApiError> {
        lock(&self.0).is_free()
    }

    /// Starts a job for somebody, who takes the seat if it is free.
    ///
    /// # Errors
    /// `busy` while another job is under way, `held` when somebody else drives, `unfinished` when a killed job waits.
    pub(crate) fn start(
        &self,
        app: &Arc<App>,
        caller: &Caller,
        wish: Wish,
    ) -> Result<JobId, ApiError> {
        let mut inner = lock(&self.0);
        inner.is_free()?;
        let Wish {
            case,
            about,
            mut asked,
        } = wish;
        let is_resumed = asked.as_ref().is_some_and(|asked| asked.resumed);
        if asked.is_some()
            && !is_resumed
            && let Some(standing) = app.bench.waits()?
        {
            let message = format!("{standing}. Resume it or abandon it first");
            return Err(ApiError::conflict("unfinished", message));
        }
        let lease = app.seat.take(caller)?;
        if let Some(asked) = asked.as_mut().filter(|asked| !asked.resumed) {
            asked.inputs["user"] = json!(caller.user);
            asked.inputs["slide"] = json!(*lock(&app.slide));
        }
        let kind = case.kind();
        let keeps_views = kind == "calibrate";
        app.console.forget();
        let inputs = asked.as_ref().map(|asked| asked.inputs.clone());
        let (record, lost) = match asked {
            Some(asked) => {
                let (record, lost) = app.bench.record(kind, asked);
                (Some(record), lost)
            }
            None => (None, None),
        };
        if let Case::Jog(jog) = &case {
            inner.hold = Some((caller.key.clone(), jog.holder()));
        }
        let job = app.console.session().start(&lease, case)?;
        let entry = Arc::new(Entry {
            kind,
            owner: caller.user.clone(),
            about,
            handle: job.handle().clone(),
            end: Mutex::default(),
        });
        let id = entry.id();
        if inner.entries.len() >= REMEMBERED {
            inner.entries.pop_front();
        }
        inner.entries.push_back(entry.clone());
        drop(inner);
        // What the log cannot take keeps nobody from the instrument; it is told with the answer.
        let what = json!({"job": kind, "id": id, "about": entry.about});
        let unnoted = app.audit.note(caller, "started", what).err();
        let warnings: Vec<String> = lost
            .map(|e| e.to_string())
            .into_iter()
            .chain(unnoted.map(|e| format!("the log of who moved what cannot be written: {e}")))
            .collect();
        let (app, task) = (
            app.clone(),
            ending::Task {
                entry,
                record,
                inputs,
                keeps_views,
                warnings,
            },
        );
        std::thread::spawn(move || ending::follow(&app, task, job));
        Ok(id)
    }

    /// Goes on that way while it is said again and again: a job that begins with the first word.
    ///
    /// # Errors
    /// As [`Desk::start`].
    pub(crate) fn jog(
        &self,
        app: &Arc<App>,
        caller: &Caller,
        way: crate::jog::Way,
    ) -> Result<(), ApiError> {
        {
            let inner = lock(&self.0);
            let under_way = inner.under_way().filter(|entry| entry.kind == "jog");
            if let (Some(_), Some((key, hold))) = (under_way, &inner.hold)
                && *key == caller.key
            {
                hold.hold(way);
                return Ok(());
            }
            inner.is_free()?;
        }
        let hold = Hold::default();
        hold.hold(way);
        self.start(app, caller, Wish::jog(&app.bench, hold))
            .map(drop)
    }

    /// Somebody lets go, or is gone: the stage stands at once.
    pub(crate) fn let_go(&self, key: &str) {
        let inner = lock(&self.0);
        let Some((_, hold)) = inner.hold.as_ref().filter(|(holder, _)| holder == key) else {
            return;
        };
        hold.release();
        let jog = inner
            .under_way()
            .filter(|entry| entry.kind == "jog")
            .cloned();
        drop(inner);
        if let Some(jog) = jog {
            // The device's answer is the job's to tell.
            let _ = jog.handle.stop();
        }
    }

    /// Ends a jog that nobody holds any more. Asked often.
    pub(crate) fn end_stale_jog(&self) {
        let inner = lock(&self.0);
        let jog = inner.under_way().filter(|entry| entry.kind == "jog");
        let is_stale = inner
            .hold
            .as_ref()
            .is_some_and(|(_, hold)| hold.way().is_none());
        let jog = jog.filter(|_| is_stale).cloned();
        drop(inner);
        if let Some(jog) = jog {
            let _ = jog.handle.stop();
        }
    }

    /// The job under way.
    pub(crate) fn under_way(&self) -> Option<Arc<Entry>> {
        lock(&self.0).under_way().cloned()
    }

    /// The last ones, the oldest first.
    pub(crate) fn all(&self) -> Vec<Arc<Entry>> {
        lock(&self.0).entries.iter().cloned().collect()
    }

    /// One of them.
    ///
    /// # Errors
    /// `not_found`.
    pub(crate) fn one(&self, id: u64) -> Result<Arc<Entry>, ApiError> {
        let all = self.all().into_iter();
        let mut found = all.filter(|entry| entry.id().0 == id);
        found.next().ok_or_else(|| {
            ApiError::missing(format!("job {id} is not one of the last {REMEMBERED}"))
        })
    }
}

impl Inner {
    fn under_way(&self) -> Option<&Arc<Entry>> {
        self.entries.back().filter(|entry| !entry.is_over())
    }

    fn is_free(&self) -> Result<(), ApiError> {
        match self.under_way() {
            None => Ok(()),
            Some(entry) => {
                let what = match &entry.about {
                    Some(about) => format!("{} of {about}", entry.kind.replace('_', " ")),
                    None => entry.kind.replace('_', " "),
                };
                let message = format!("{what} by {} is under way: wait, or stop it", entry.owner);
                Err(ApiError::conflict("busy", message))
            }
        }
    }
}

/// Whether a job ended because somebody wanted that.
pub(crate) fn was_stopped(entry: &Entry) -> bool {
    matches!(entry.handle.state(), JobState::Ended(Ended::Stopped { .. }))
}
