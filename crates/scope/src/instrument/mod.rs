//! A whole microscope: what moves, behind its gate, camera and clock, with the waiting that every procedure needs.

mod grab;
mod memory;
mod moves;
mod objective;
mod same_image;
mod steps;
mod waiting;

pub use objective::ObjectiveChange;

use crate::{
    Absent, AskImmersion, Camera, CancelToken, Clock, Devices, FlatField, Frame, Light, MotionGate,
    Obeying, Objective, ObjectiveId, Rules, ScopeError, StagePose,
};
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

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
    gate: MotionGate,
    camera: Arc<dyn Camera>,
    light: Option<Box<dyn Light>>,
    clock: Arc<dyn Clock>,
    /// What lies on the camera, as far as it was seen.
    flat_field: Mutex<Option<Arc<FlatField>>>,
    /// Where the present command's first move found the stage.
    began: Mutex<Option<StagePose>>,
    moves: AtomicU64,
    frames: AtomicU64,
    objective_changes: AtomicU64,
    /// A frame that nobody waits for any more.
    given_up: Mutex<Option<std::thread::JoinHandle<()>>>,
    /// The last image that was checked to be new.
    shown: Mutex<(Option<same_image::Shown>, same_image::AtRest)>,
    /// Whoever is asked before another medium comes between objective and specimen. Without, it is refused.
    ask_immersion: Option<AskImmersion>,
    /// Let go last, after the devices.
    kept: Vec<Box<dyn std::any::Any + Send + Sync>>,
}

impl Instrument {
    /// Puts the devices together, what moves behind a gate that keeps the rules. Of one that is missing, nothing is had. After `cancel`
    /// was cancelled nothing begins any more.
    ///
    /// # Errors
    /// Those of [`MotionGate::new`].
    pub fn new(devices: Devices, rules: Rules, cancel: CancelToken) -> Result<Self, ScopeError> {
        let none = Absent::new;
        let mut gate = MotionGate::new(
            devices.stage.unwrap_or_else(|| Box::new(none())),
            devices.nosepiece.unwrap_or_else(|| Box::new(none())),
            rules,
        )?;
        gate.obey(cancel);
        Ok(Self {
            gate,
            camera: devices.camera.unwrap_or_else(|| Box::new(none())).into(),
            light: devices.light,
            clock: devices.clock,
            flat_field: Mutex::new(None),
            began: Mutex::new(None),
            moves: AtomicU64::new(0),
            frames: AtomicU64::new(0),
            objective_changes: AtomicU64::new(0),
            given_up: Mutex::new(None),
            shown: Mutex::default(),
            ask_immersion: None,
            kept: Vec::new(),
        })
    }

    /// Keeps something for as long as the instrument is there, and lets it go after the devices: that nobody else may drive them.
    #[must_use]
    pub fn keeping(mut self, what: impl std::any::Any + Send + Sync) -> Self {
        self.kept.push(Box::new(what));
        self
    }

    /// Asks somebody before an objective comes that works in another medium. Without this such a change is refused.
    #[must_use]
    pub fn asking_before_immersion(mut self, ask: AskImmersion) -> Self {
        self.ask_immersion = Some(ask);
        self
    }

    /// A stop for one piece of work on this instrument: cancelling it leaves the instrument as it is for the next. Cancelling the
    /// instrument's own token cancels it as well.
    pub fn job_token(&self) -> CancelToken {
        self.gate.own_token().child()
    }

    /// From now on nothing begins after `cancel` or the instrument's own token was cancelled, until the guard is dropped: then only
    /// the instrument's own counts.
    ///
    /// # Errors
    /// [`ScopeError::Busy`] while another piece of work is under way.
    pub fn obey(&self, cancel: &CancelToken) -> Result<Obeying<'_>, ScopeError> {
        Obeying::begin(&self.gate, cancel)
    }

    /// Notices a camera that has frozen, by what it shows after moves.
    ///
    /// # Errors
    /// [`ScopeError::Frozen`] once the same image has come again twice.
    pub fn check_new(&self, frame: &Frame) -> Result<(), ScopeError> {
        let mut last = self.shown.lock().unwrap_or_else(|e| e.into_inner());
        let Some(at) = self.gate.last_reported() else {
            last.1.forget();
            return Ok(());
        };
        match same_image::Shown::comes_again(&mut last, frame, at) {
            true => Err(ScopeError::Frozen { device: "camera" }),
            false => Ok(()),
        }
    }

    /// Whether the image that [`Instrument::check_new`] saw last is the very same as the one before, of a stage at rest and a camera whose images at
    /// rest have always differed: it tells nothing new, and cannot confirm the other one.
    pub fn shows_again(&self) -> bool {
        let shown = self.shown.lock().unwrap_or_else(|e| e.into_inner());
        shown.1.again()
    }

    /// Whether the image that [`Instrument::check_new`] saw last is the very same as one from before a move that was to change it: once it may be a
    /// frame that was sent twice, and tells nothing of where the stage stands now.
    pub fn shows_from_before(&self) -> bool {
        let shown = self.shown.lock().unwrap_or_else(|e| e.into_inner());
        shown.0.is_some_and(|last| last.is_from_before())
    }

    /// [`Instrument::shows_again`] has been so for long, which a camera that froze and one that has lost its noise do alike: a move will tell. What
    /// shows another image after it lives, and its images at rest may be the same until two differ; what shows the same is told as frozen.
    pub fn doubt_camera(&self) {
        let mut shown = self.shown.lock().unwrap_or_else(|e| e.into_inner());
        shown.1.doubt();
    }

    /// Stage and nosepiece, behind their rules.
    pub fn gate(&self) -> &MotionGate {
        &self.gate
    }

    /// The camera.
    pub fn camera(&self) -> &dyn Camera {
        &*self.camera
    }

    /// The light, where it can be set.
    pub fn light(&self) -> Option<&dyn Light> {
        self.light.as_deref()
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
        self.gate.objective(id)
    }
}
