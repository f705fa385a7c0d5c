//! The motion gate: the one way to move a stage or turn a nosepiece. It refuses with a reason, and never clips.

mod begin;
mod immersion;
mod obeying;
mod objective;
mod state;
mod verdict;

pub use obeying::Obeying;
pub use state::AtWork;
pub use verdict::Goals;

use crate::knowledge::Knowledge;
use crate::reported::Reported;
use crate::{
    AxisRange, CancelToken, GateEvent, Nosepiece, ObjectiveId, Observer, PositiveZ, Rules,
    ScopeError, Stage, StageInfo, StagePose,
};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard};

/// What the stage was sent on.
#[derive(Debug, Clone, Copy)]
enum Way {
    /// A move.
    Between { from: StagePose, to: StagePose },
    /// To its reference, wherever that is.
    Homing,
}

/// Stage and nosepiece behind their rules. There is no way to move an [`crate::Instrument`] but through this type: a request is
/// carried out whole, or refused whole with the reason.
///
/// What is checked is still true when the move begins: checking and beginning happen under one lock, for stage and nosepiece
/// together. Stopping never waits for it, and what begins while somebody stops is stopped as well.
pub struct MotionGate {
    stage: Box<dyn Stage>,
    nosepiece: Box<dyn Nosepiece>,
    rules: Rules,
    /// Limits for all objectives, one for each axis that the stage has.
    ranges: Vec<AxisRange>,
    begin: Mutex<()>,
    /// What was begun last.
    way: Mutex<Option<Way>>,
    reported: Reported,
    stops: AtomicU64,
    knowledge: Knowledge,
    /// Once cancelled, nothing begins any more.
    cancel: CancelToken,
    /// That of the work under way: once cancelled, nothing of it begins any more.
    job: Mutex<Option<CancelToken>>,
    /// Is told of every command.
    observer: Mutex<Option<Observer>>,
}

impl MotionGate {
    /// Puts stage and nosepiece behind the stage's own travel and the user's rules, whichever is narrower.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] when a rule makes no sense for them, [`ScopeError::NoSuchAxis`] when it names an axis that the
    /// stage lacks.
    pub fn new(
        stage: Box<dyn Stage>,
        nosepiece: Box<dyn Nosepiece>,
        rules: Rules,
    ) -> Result<Self, ScopeError> {
        let ids: Vec<ObjectiveId> = nosepiece
            .objectives()
            .iter()
            .map(|o| o.id.clone())
            .collect();
        let ranges = rules.ranges(stage.info(), &ids)?;
        let knowledge = Knowledge::new(nosepiece.known_by());
        Ok(Self {
            stage,
            nosepiece,
            rules,
            ranges,
            begin: Mutex::new(()),
            way: Mutex::new(None),
            reported: Reported::default(),
            stops: AtomicU64::new(0),
            knowledge,
            cancel: CancelToken::new(),
            job: Mutex::new(None),
            observer: Mutex::new(None),
        })
    }

    /// From now on nothing begins after `cancel` was cancelled.
    pub(crate) fn obey(&mut self, cancel: CancelToken) {
        self.cancel = cancel;
    }

    /// The token that ends everything.
    pub(crate) fn own_token(&self) -> &CancelToken {
        &self.cancel
    }

    pub(crate) fn job_mut(&self) -> MutexGuard<'_, Option<CancelToken>> {
        self.job.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Whether a stop was asked for, of everything or of the work under way.
    pub(crate) fn is_cancelled(&self) -> bool {
        let job = || self.job_mut().as_ref().is_some_and(|j| j.is_cancelled());
        self.cancel.is_cancelled() || job()
    }

    /// From now on `observer` is told of every command; nobody with `None`. See [`Observer`] for what it may do.
    pub fn observe(&self, observer: Option<Observer>) {
        *self.observer.lock().unwrap_or_else(|e| e.into_inner()) = observer;
    }

    pub(crate) fn tell(&self, event: impl FnOnce() -> GateEvent) {
        let observer = self.observer.lock();
        let observer = observer.unwrap_or_else(|e| e.into_inner()).clone();
        if let Some(observer) = observer {
            observer(event());
        }
    }

    /// What the stage is.
    pub fn info(&self) -> &StageInfo {
        self.stage.info()
    }

    /// The rules in force.
    pub fn rules(&self) -> &Rules {
        &self.rules
    }

    /// The limits for all objectives, one for each axis that the stage has.
    pub fn ranges(&self) -> &[AxisRange] {
        &self.ranges
    }

    /// What the instrument has learnt.
    pub(crate) fn knowledge(&self) -> &Knowledge {
        &self.knowledge
    }

    pub(crate) fn positive_z(&self) -> PositiveZ {
        self.info().positive_z
    }

    /// Stops stage and nosepiece at once, from any thread. Harmless when nothing moves.
    ///
    /// # Errors
    /// What the devices report; both were told all the same.
    pub fn stop(&self) -> Result<(), ScopeError> {
        self.stops.fetch_add(1, Ordering::SeqCst);
        self.knowledge.change_ended(None);
        // Neither waits for the other: they may be on different boards, and one may be past hearing.
        let told = std::thread::scope(|s| {
            let nosepiece = s.spawn(|| self.nosepiece.stop());
            let stage = self.stage.stop();
            let nosepiece = nosepiece.join().unwrap_or_else(|_| {
                Err(ScopeError::Device {
                    device: "nosepiece",
                    detail: "its driver broke down".into(),
                })
            });
            nosepiece.and(stage)
        });
        self.tell(|| GateEvent::Stopped {
            fault: told.as_ref().err().map(ToString::to_string),
        });
        told
    }
}
