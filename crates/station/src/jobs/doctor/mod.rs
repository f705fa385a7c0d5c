//! The instrument looked through, device by device; and, where the user allows it, tried by small moves.

mod finding;
mod look;

pub use finding::{Check, Finding, Trouble};
pub use look::look_by_small_moves;

use crate::{JobError, UseCase, Work};
use scopeservo_scope::conformance;
use scopeservo_servo::Progress;
use serde::{Deserialize, Serialize};

/// What is asked.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DoctorInput {
    /// Whether the instrument may be tried: every axis moves a little and comes back, every objective is brought into the beam. The
    /// specimen should be one that does not matter.
    pub allow_motion: bool,
}

/// What was found; each finding was also told as it was reached.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DoctorOutput {
    /// All of it, in the order in which it was looked at.
    pub findings: Vec<Finding>,
}

/// What comes next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Part {
    Stage,
    Nosepiece,
    Camera,
    SmallMoves,
    StageContract,
    CameraContract,
    ContractTogether,
    NosepieceContract,
}

/// The job. Nothing of it can go on after a kill, and a killed job may wait meanwhile: no journal is kept of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DoctorJob {
    input: DoctorInput,
    /// `None` when all was looked at.
    next: Option<Part>,
    findings: Vec<Finding>,
}

impl DoctorJob {
    /// Does what is asked.
    pub fn new(input: DoctorInput) -> Self {
        Self {
            input,
            next: Some(Part::Stage),
            findings: Vec::new(),
        }
    }
}

impl UseCase for DoctorJob {
    type Output = DoctorOutput;

    fn kind(&self) -> &'static str {
        "doctor"
    }

    fn can_go_on(&self) -> bool {
        false
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<DoctorOutput>, JobError> {
        let scope = work.scope();
        let Some(part) = self.next else {
            let findings = std::mem::take(&mut self.findings);
            return Ok(Progress::Done(DoctorOutput { findings }));
        };
        let of_trial = |checks: Vec<conformance::Check>| -> Vec<Finding> {
            let findings = checks.into_iter().map(Finding::from);
            findings.map(Finding::in_trial).collect()
        };
        let (found, next) = match part {
            Part::Stage => (look::stage(scope), Some(Part::Nosepiece)),
            Part::Nosepiece => (look::nosepiece(scope), Some(Part::Camera)),
            Part::Camera => {
                let trial = self.input.allow_motion.then_some(Part::SmallMoves);
                (look::camera(scope), trial)
            }
            // The smallest steps first.
            Part::SmallMoves => {
                let (found, goes_on) = look_by_small_moves(scope);
                (found, goes_on.then_some(Part::StageContract))
            }
            Part::StageContract => {
                let found = of_trial(conformance::check_stage(scope));
                (found, Some(Part::CameraContract))
            }
            Part::CameraContract => {
                let found = of_trial(conformance::check_camera(scope));
                (found, Some(Part::ContractTogether))
            }
            Part::ContractTogether => {
                let found = of_trial(conformance::check_together(scope));
                (found, Some(Part::NosepieceContract))
            }
            Part::NosepieceContract => (of_trial(conformance::check_nosepiece(scope)), None),
        };
        for finding in found {
            work.tell_found(&finding);
            self.findings.push(finding);
        }
        self.next = next;
        Ok(Progress::Continue)
    }
}
