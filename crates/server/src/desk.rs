//! The desk: one job at a time, and the last hundred that were done.

use crate::error::ApiError;
use crate::jog::{Hold, Way};
use crate::lock;
use scopeservo_station::{Ended, JobHandle, JobId, JobState};
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
    pub(crate) end: Mutex<Option<End>>,
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

    /// Goes on that way, where this one holds it already.
    ///
    /// # Errors
    /// `busy`, while something else is under way.
    pub(crate) fn goes_on(&self, key: &str, way: Way) -> Result<bool, ApiError> {
        let inner = lock(&self.0);
        let under_way = inner.under_way().filter(|entry| entry.kind == "jog");
        if let (Some(_), Some((holder, hold))) = (under_way, &inner.hold)
            && holder == key
        {
            hold.hold(way);
            return Ok(true);
        }
        inner.is_free()?;
        Ok(false)
    }

    /// Puts a job on the desk, which `begin` starts while nobody else can.
    ///
    /// # Errors
    /// `busy`, and those of `begin`.
    pub(crate) fn put<T>(
        &self,
        begin: impl FnOnce() -> Result<(Arc<Entry>, Option<(String, Hold)>, T), ApiError>,
    ) -> Result<(Arc<Entry>, T), ApiError> {
        let mut inner = lock(&self.0);
        inner.is_free()?;
        let (entry, hold, with) = begin()?;
        if hold.is_some() {
            inner.hold = hold;
        }
        if inner.entries.len() >= REMEMBERED {
            inner.entries.pop_front();
        }
        inner.entries.push_back(entry.clone());
        Ok((entry, with))
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
