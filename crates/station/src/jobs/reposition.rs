//! The microscope brought back to a saved view.

use crate::{JobError, MadeCalibration, UseCase, Work};
use scopeservo_scope::{Counters, Instrument, ObjectiveId};
use scopeservo_servo::{
    Calibration, Outcome, Parcentric, Progress, Reposition, RepositionOptions, SwitchingReport,
    Target,
};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What is asked, but for the target itself.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RepositionInput {
    /// By what the target is found again where it is kept: the stored state of the job has no other word of it.
    pub target_id: String,
    /// How.
    pub options: RepositionOptions,
    /// Size of a pixel of a target that another microscope took, um.
    pub foreign_um_per_px: Option<f64>,
    /// Calibrations of this instrument and camera that are known: those objectives are not calibrated on the way.
    pub known: Vec<Calibration>,
    /// What is known of where its objectives look beside each other.
    pub switchings: Vec<SwitchingReport>,
    /// The same by calibrations that are one instrument.
    pub parcentric: Vec<Parcentric>,
}

/// The answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RepositionOutput {
    /// The verdict, and how it came about.
    pub outcome: Outcome,
    /// Calibrations that were made on the way, to be kept; the newest of an objective comes last.
    pub made: Vec<MadeCalibration>,
    /// What the instrument did for it.
    pub counters: Counters,
}

/// The job. Its stored state holds neither the target nor its image: see [`RepositionJob::with_target`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RepositionJob {
    target_id: String,
    run: Reposition,
    made: Vec<MadeCalibration>,
    counters: Counters,
}

impl RepositionJob {
    /// Brings `target` back.
    pub fn new(target: impl Into<Arc<Target>>, input: RepositionInput) -> Self {
        let known = input.known.into_iter();
        let known = known.map(|c| (c.objective.clone(), c));
        let mut run = Reposition::new(target, input.options)
            .with_calibrations(known)
            .with_switchings(input.switchings)
            .with_parcentric(input.parcentric);
        if let Some(um_per_px) = input.foreign_um_per_px {
            run = run.with_foreign_scale(um_per_px);
        }
        Self {
            target_id: input.target_id,
            run,
            made: Vec::new(),
            counters: Counters::default(),
        }
    }

    /// By what the target is found again.
    pub fn target_id(&self) -> &str {
        &self.target_id
    }

    /// A stored job, whole again.
    #[must_use]
    pub fn with_target(self, target: impl Into<Arc<Target>>) -> Self {
        Self {
            run: self.run.with_target(target).after_a_kill(),
            ..self
        }
    }

    fn is_new(&self, (objective, calibration): &(&ObjectiveId, &Calibration)) -> bool {
        let mut before = self.made.iter().rev();
        let last = before.find(|made| made.calibration.objective == **objective);
        last.is_none_or(|made| made.calibration != **calibration)
    }
}

impl UseCase for RepositionJob {
    type Output = RepositionOutput;

    fn kind(&self) -> &'static str {
        "reposition"
    }

    fn leave(&mut self, scope: &Instrument) {
        self.run.leave(scope);
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<RepositionOutput>, JobError> {
        let before = work.scope().counters();
        let ended = work.step(&mut self.run)?;
        let now = work.scope().counters();
        self.counters.moves += now.moves - before.moves;
        self.counters.frames += now.frames - before.frames;
        self.counters.objective_changes += now.objective_changes - before.objective_changes;
        let made = self.run.calibrations_made();
        let new: Vec<Calibration> = made
            .filter(|m| self.is_new(m))
            .map(|m| m.1.clone())
            .collect();
        for calibration in new {
            self.made.push(work.keep_calibration(calibration));
        }
        Ok(match ended {
            Progress::Continue => Progress::Continue,
            Progress::Done(outcome) => Progress::Done(RepositionOutput {
                outcome,
                made: std::mem::take(&mut self.made),
                counters: self.counters,
            }),
        })
    }
}
