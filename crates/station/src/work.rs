//! A job as it sees itself: a use case that is stepped, and what it may touch.

use crate::control::Control;
use crate::jobs::Finding;
use crate::shared::Shared;
use crate::{Bus, JobError, Kept, MadeCalibration, QuestionKind, StationEvent, lock};
use scopeservo_scope::{Frame, Immersion, Instrument, Objective, ObjectiveId};
use scopeservo_servo::{Calibration, Event, FrameRole, Procedure, Progress, Sink, Stamped};
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::Arc;

/// What any front end can have done: a step machine like the procedures it is made of. Its serialised state is what the journal keeps, and
/// a use case that is made from it again goes on.
pub trait UseCase: Serialize + Send + 'static {
    /// What it answers.
    type Output: Send + 'static;

    /// A word for programs.
    fn kind(&self) -> &'static str;

    /// Whether it can go on after its program was killed. Of one that cannot nothing is kept in the journal, where a killed job may wait.
    fn can_go_on(&self) -> bool {
        true
    }

    /// Does the next small piece of work: a step of a procedure.
    ///
    /// # Errors
    /// Where there is no answer.
    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<Self::Output>, JobError>;

    /// Leaves the instrument set as it was found, however the job ends: also by a stop between two steps. What fails is no answer to the job.
    fn leave(&mut self, _scope: &Instrument) {}
}

/// What a use case may touch.
pub struct Work<'a> {
    shared: &'a Shared,
    control: &'a Control,
    ears: Ears,
}

/// Tells all to the bus, and remembers what events alone tell.
struct Ears {
    bus: Bus,
    residual_px: BTreeMap<ObjectiveId, f64>,
    target: Option<Arc<Frame>>,
}

impl Sink for Ears {
    fn event(&mut self, event: Stamped) {
        if let Event::Calibrated {
            calibration,
            residual_px,
            ..
        } = &event.event
        {
            self.residual_px
                .insert(calibration.objective.clone(), *residual_px);
        }
        self.bus.event(event);
    }
    fn frame(&mut self, frame: &Frame, role: FrameRole) {
        self.shared_frame(&Arc::new(frame.clone()), role);
    }
    fn shared_frame(&mut self, frame: &Arc<Frame>, role: FrameRole) {
        if role == FrameRole::Target {
            self.target = Some(frame.clone());
        }
        self.bus.shared_frame(frame, role);
    }
}

impl<'a> Work<'a> {
    pub(crate) fn new(shared: &'a Shared, control: &'a Control) -> Self {
        let ears = Ears {
            bus: shared.bus.clone(),
            residual_px: BTreeMap::new(),
            target: None,
        };
        Self {
            shared,
            control,
            ears,
        }
    }

    /// The instrument.
    pub fn scope(&self) -> &'a Instrument {
        &self.shared.scope
    }

    /// Whether an objective is in the beam: after a pause or a kill another one may be.
    pub(crate) fn is_in(&self, objective: &ObjectiveId) -> Result<bool, JobError> {
        let current = self.scope().gate().current_objective()?;
        Ok(current.as_ref() == Some(objective))
    }

    /// Where events and frames go.
    pub fn sink(&mut self) -> &mut dyn Sink {
        &mut self.ears
    }

    /// One step of a procedure. Shadows that it found on the camera are kept.
    ///
    /// # Errors
    /// Those of the step.
    pub fn step<P: Procedure>(
        &mut self,
        procedure: &mut P,
    ) -> Result<Progress<P::Output>, JobError> {
        let before = self.scope().flat_field();
        let ended = procedure.step(self.scope(), &mut self.ears);
        if let Some(seen) = self.scope().flat_field()
            && before.is_none_or(|before| !Arc::ptr_eq(&before, &seen))
        {
            self.keep(Kept::Shadows(seen));
        }
        Ok(ended?)
    }

    /// Keeps something, however the job ends.
    pub fn keep(&mut self, kept: Kept) {
        if let Err(error) = self.shared.journal.kept(&self.control.info, &kept) {
            self.shared.not_kept(self.control, &error);
        }
        lock(&self.control.kept).push(kept);
    }

    /// A calibration with what else is known of it; it is kept.
    pub fn keep_calibration(&mut self, calibration: Calibration) -> MadeCalibration {
        let objective = &calibration.objective;
        let focus = self.scope().focus_positions();
        let made = MadeCalibration {
            residual_px: self.ears.residual_px.get(objective).copied(),
            focus_z_um: focus.get(objective).map(|z| z.um()),
            calibration,
        };
        self.keep(Kept::Calibration(Box::new(made.clone())));
        made
    }

    /// Tells what a doctor found.
    pub fn tell_found(&mut self, finding: &Finding) {
        let finding = Box::new(finding.clone());
        self.shared.bus.station(StationEvent::Found { finding });
    }

    /// The last frame that was grabbed as a target.
    pub fn target_frame(&self) -> Option<Arc<Frame>> {
        self.ears.target.clone()
    }

    /// What is on the specimen, where that is known.
    ///
    /// # Errors
    /// What the nosepiece reports.
    pub fn immersion(&self) -> Result<Option<Immersion>, JobError> {
        let media = self.scope().gate().immersions()?;
        Ok(media.first().copied().filter(|_| media.len() == 1))
    }

    /// The objective of that name; the one that is active when none is named.
    ///
    /// # Errors
    /// [`JobError::NoObjective`], and what the nosepiece reports.
    pub fn objective(&self, named: Option<&ObjectiveId>) -> Result<Objective, JobError> {
        let gate = self.scope().gate();
        let id = match named {
            Some(id) => id.clone(),
            None => gate.current_objective()?.ok_or_else(|| {
                let names: Vec<_> = gate.objectives().iter().map(|o| o.id.0.as_str()).collect();
                let available = names.join(", ");
                JobError::NoObjective { available }
            })?,
        };
        Ok(self.scope().objective(&id)?.clone())
    }

    /// Asks somebody, and waits for the answer.
    ///
    /// # Errors
    /// [`JobError::Stopped`] when a stop came first.
    pub fn ask(&mut self, kind: QuestionKind) -> Result<bool, JobError> {
        let wanted = || !self.control.cancel.is_cancelled();
        let answer = self.shared.questions.ask(kind, &wanted);
        self.scope().check_cancel()?;
        answer.ok_or(JobError::Stopped { at: None })
    }
}
