//! A whole microscope: stage, camera, nosepiece and clock, with the waiting that every procedure needs.

use crate::{
    Camera, CheckedStage, Clock, Frame, Motion, Nosepiece, Objective, ObjectiveId, ScopeError,
    StagePose,
};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// How often a running move is asked whether it has ended.
const POLL: Duration = Duration::from_millis(5);
/// No move of these instruments takes longer.
const MOVE_TIMEOUT: Duration = Duration::from_secs(120);

/// A wish to stop, shared between threads: Ctrl-C, a button, a watchdog.
#[derive(Debug, Clone, Default)]
pub struct CancelToken(Arc<AtomicBool>);

impl CancelToken {
    /// Not cancelled yet.
    pub fn new() -> Self {
        Self::default()
    }
    /// Asks for a stop. The running move is stopped and the procedure returns [`ScopeError::Interrupted`].
    pub fn cancel(&self) {
        self.0.store(true, Ordering::SeqCst);
    }
    /// Whether a stop was asked for.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// What an instrument has done so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// Stage moves carried out.
    pub moves: u64,
    /// Frames grabbed.
    pub frames: u64,
    /// Objective changes carried out.
    pub objective_changes: u64,
}

/// Everything that a procedure may touch.
pub struct Instrument {
    stage: CheckedStage,
    camera: Box<dyn Camera>,
    nosepiece: Box<dyn Nosepiece>,
    clock: Arc<dyn Clock>,
    cancel: CancelToken,
    moves: AtomicU64,
    frames: AtomicU64,
    objective_changes: AtomicU64,
}

impl Instrument {
    /// Puts the devices together.
    pub fn new(
        stage: CheckedStage,
        camera: Box<dyn Camera>,
        nosepiece: Box<dyn Nosepiece>,
        clock: Arc<dyn Clock>,
        cancel: CancelToken,
    ) -> Self {
        Self {
            stage,
            camera,
            nosepiece,
            clock,
            cancel,
            moves: AtomicU64::new(0),
            frames: AtomicU64::new(0),
            objective_changes: AtomicU64::new(0),
        }
    }

    /// The stage, behind its limits.
    pub fn stage(&self) -> &CheckedStage {
        &self.stage
    }

    /// The camera.
    pub fn camera(&self) -> &dyn Camera {
        &*self.camera
    }

    /// The nosepiece.
    pub fn nosepiece(&self) -> &dyn Nosepiece {
        &*self.nosepiece
    }

    /// The clock that all devices share.
    pub fn clock(&self) -> &dyn Clock {
        &*self.clock
    }

    /// What was done so far.
    pub fn counters(&self) -> Counters {
        Counters {
            moves: self.moves.load(Ordering::SeqCst),
            frames: self.frames.load(Ordering::SeqCst),
            objective_changes: self.objective_changes.load(Ordering::SeqCst),
        }
    }

    /// The data of one objective.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`].
    pub fn objective(&self, id: &ObjectiveId) -> Result<&Objective, ScopeError> {
        let all = self.nosepiece.objectives();
        all.iter()
            .find(|o| o.id == *id)
            .ok_or_else(|| ScopeError::NoSuchObjective {
                asked: id.clone(),
                available: all
                    .iter()
                    .map(|o| o.id.0.as_str())
                    .collect::<Vec<_>>()
                    .join(", "),
            })
    }

    /// Moves and waits until the stage has settled. Returns where it says it is.
    ///
    /// # Errors
    /// Refused moves as in [`CheckedStage::check`]; [`ScopeError::Interrupted`] after the token was cancelled (the
    /// stage was stopped first); [`ScopeError::MoveAborted`]; [`ScopeError::Timeout`].
    pub fn move_to(&self, to: &StagePose) -> Result<StagePose, ScopeError> {
        self.check_cancel()?;
        self.stage.start_move(to)?;
        self.moves.fetch_add(1, Ordering::SeqCst);
        let settled = self.wait("stage", || self.stage.poll(), || self.stage.stop())?;
        let at = self.stage.position();
        match settled {
            Motion::Settled => at,
            _ => Err(ScopeError::MoveAborted { at: at.ok() }),
        }
    }

    /// Brings an objective into the beam and waits for it. Does nothing when it is there already.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`], and as [`Instrument::move_to`].
    pub fn select_objective(&self, id: &ObjectiveId) -> Result<(), ScopeError> {
        self.check_cancel()?;
        self.objective(id)?;
        if self.nosepiece.current()?.as_ref() == Some(id) {
            return Ok(());
        }
        self.nosepiece.start_change(id)?;
        self.objective_changes.fetch_add(1, Ordering::SeqCst);
        let settled = self.wait(
            "nosepiece",
            || self.nosepiece.poll(),
            || self.nosepiece.stop(),
        )?;
        let now = self.nosepiece.current()?;
        if settled != Motion::Settled || now.as_ref() != Some(id) {
            return Err(ScopeError::Device {
                device: "nosepiece",
                detail: format!(
                    "asked for {id}, but {} is in the beam",
                    now.map_or("nothing known".to_string(), |o| o.0)
                ),
            });
        }
        Ok(())
    }

    /// Grabs a fresh frame.
    ///
    /// # Errors
    /// [`ScopeError::Interrupted`], or what the camera reports.
    pub fn grab(&self) -> Result<Frame, ScopeError> {
        self.check_cancel()?;
        let frame = self.camera.grab()?;
        self.frames.fetch_add(1, Ordering::SeqCst);
        Ok(frame)
    }

    /// An error when a stop was asked for.
    pub fn check_cancel(&self) -> Result<(), ScopeError> {
        if self.cancel.is_cancelled() {
            self.stage.stop()?;
            return Err(ScopeError::Interrupted {
                at: self.stage.position().ok(),
            });
        }
        Ok(())
    }

    fn wait(
        &self,
        device: &'static str,
        poll: impl Fn() -> Result<Motion, ScopeError>,
        stop: impl Fn() -> Result<(), ScopeError>,
    ) -> Result<Motion, ScopeError> {
        let start = self.clock.now();
        loop {
            if self.cancel.is_cancelled() {
                stop()?;
                return Err(ScopeError::Interrupted {
                    at: self.stage.position().ok(),
                });
            }
            match poll() {
                Ok(Motion::Moving) => {}
                Ok(ended) => return Ok(ended),
                Err(fault) => {
                    // A device that cannot say what it does must not go on doing it; its own fault is the news.
                    let _ = stop();
                    return Err(fault);
                }
            }
            if self.clock.now().since(start) > MOVE_TIMEOUT {
                stop()?;
                return Err(ScopeError::Timeout {
                    device,
                    seconds: MOVE_TIMEOUT.as_secs_f64(),
                });
            }
            self.clock.sleep(POLL);
        }
    }
}
