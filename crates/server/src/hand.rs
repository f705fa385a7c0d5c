//! Single steps by hand, as jobs: one goes somewhere, changes the objective, or lets the stage find its reference.

use scopeservo_protocol::Place;
use scopeservo_scope::{Axis, Instrument, ObjectiveId, ScopeError, StagePose};
use scopeservo_servo::{Calibration, Motion2, PlanarPose, Progress, ServoError, pose_after};
use scopeservo_station::{JobError, UseCase, Work};
use serde::Serialize;

/// A step by hand.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Hand {
    /// There.
    Go(Place),
    /// By so much from where it is.
    Shift(Place),
    /// What lies there in the view comes to its middle: pixels from the middle, and the calibration that says where that is.
    Centre([f64; 2], Box<Calibration>),
    /// An objective comes into the beam.
    Objective(ObjectiveId),
    /// The stage finds its reference.
    Home,
}

impl UseCase for Hand {
    type Output = ();

    fn kind(&self) -> &'static str {
        match self {
            Self::Go(_) | Self::Shift(_) => "move",
            Self::Centre(..) => "centre",
            Self::Objective(_) => "objective",
            Self::Home => "home",
        }
    }

    fn can_go_on(&self) -> bool {
        false
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<()>, JobError> {
        let scope = work.scope();
        let here = || scope.gate().position();
        let to = match self {
            Self::Objective(id) => {
                scope.select_objective(id)?;
                return Ok(Progress::Done(()));
            }
            Self::Home => {
                scope.home()?;
                return Ok(Progress::Done(()));
            }
            Self::Go(to) => StagePose::from(*to),
            Self::Shift(by) => shifted(&here()?, &StagePose::from(*by))?,
            Self::Centre(pixels, calibration) => {
                shown_in_the_middle(scope, &here()?, *pixels, calibration)
            }
        };
        scope.move_to(&to)?;
        Ok(Progress::Done(()))
    }
}

/// The axes of `by`, from where they stand.
fn shifted(here: &StagePose, by: &StagePose) -> Result<StagePose, ServoError> {
    let asked = Axis::ALL.iter().filter_map(|a| Some((*a, by.si(*a)?)));
    let mut to = StagePose::default();
    for (axis, by) in asked {
        let from = here.si(axis).ok_or_else(|| ScopeError::BadSetting {
            what: format!("the stage has no axis {axis:?}"),
        })?;
        to = to.with_si(axis, from + by);
    }
    Ok(to)
}

/// Where the stage stands with what lies so many pixels from the middle of the view in its middle.
pub(crate) fn shown_in_the_middle(
    scope: &Instrument,
    here: &StagePose,
    pixels: [f64; 2],
    calibration: &Calibration,
) -> StagePose {
    let motion = Motion2 {
        alpha_rad: 0.0,
        d_m: calibration.stage_from_pixel * pixels,
    };
    let kinematics = scope.gate().info().kinematics;
    let goal = pose_after(kinematics, &PlanarPose::from(here), &motion);
    let goal = goal.request(here);
    // What does not turn is not asked to.
    StagePose { rz: None, ..goal }
}
