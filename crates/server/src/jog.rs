//! Held to move: the stage goes on while somebody says so again and again, and stands 300 ms after the last word.

use crate::hand::shown_in_the_middle;
use crate::lock;
use scopeservo_scope::{Axis, Instrument, StagePose};
use scopeservo_servo::{Calibration, Progress};
use scopeservo_station::{JobError, UseCase, Work};
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// The last word counts for so long.
pub(crate) const HOLD: Duration = Duration::from_millis(300);
/// A full deflection moves the view by so much of its width in a second.
const FIELDS_PER_S: f64 = 0.6;
/// The focus goes by so many um per um of a pixel in a second.
const FOCUS_PER_PX: f64 = 80.0;
/// The rotation, degrees in a second.
const TURN_DEG_PER_S: f64 = 2.0;
/// One move of the stage is that of so long.
const STEP_S: f64 = 0.15;

/// Which way, each from -1 to 1: the view on the screen to the right and down, the focus away from the specimen, the rotation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Way {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) z: f64,
    pub(crate) rz: f64,
}

impl Way {
    /// Bounded; nothing of what is no number.
    pub(crate) fn bounded(self) -> Self {
        let one = |v: f64| match v.is_finite() {
            true => v.clamp(-1.0, 1.0),
            false => 0.0,
        };
        Self {
            x: one(self.x),
            y: one(self.y),
            z: one(self.z),
            rz: one(self.rz),
        }
    }
}

/// What whoever holds it and the job share.
#[derive(Clone, Default)]
pub(crate) struct Hold(Arc<Mutex<Option<(Way, Instant)>>>);

impl Hold {
    /// Which way from now on.
    pub(crate) fn hold(&self, way: Way) {
        *lock(&self.0) = Some((way.bounded(), Instant::now()));
    }

    /// Nobody holds it any more.
    pub(crate) fn release(&self) {
        *lock(&self.0) = None;
    }

    /// Which way, while somebody holds it.
    pub(crate) fn way(&self) -> Option<Way> {
        let held = *lock(&self.0);
        held.filter(|(_, since)| since.elapsed() < HOLD)
            .map(|(way, _)| way)
    }
}

/// The job.
#[derive(Serialize)]
pub(crate) struct Jog {
    #[serde(skip)]
    hold: Hold,
    #[serde(skip)]
    map: Map,
}

/// How the view goes by the stage.
#[derive(Clone)]
pub(crate) enum Map {
    /// As the calibration of the objective says.
    Calibrated(Box<Calibration>),
    /// Nobody knows which way the camera looks: by the axes of the stage, and the engraved size of a pixel, um.
    ByAxes(f64),
}

impl Jog {
    /// Who says which way.
    pub(crate) fn holder(&self) -> Hold {
        self.hold.clone()
    }

    pub(crate) fn new(hold: Hold, map: Map) -> Self {
        Self { hold, map }
    }

    /// Where the next move ends.
    fn goal(&self, scope: &Instrument, here: &StagePose, way: Way) -> StagePose {
        let info = scope.camera().info();
        let px = FIELDS_PER_S * STEP_S * info.width as f64;
        // What lies on that side comes nearer to the middle: the view moves there.
        let pixels = [way.x * px, way.y * px];
        let (um_per_px, across) = match &self.map {
            Map::Calibrated(calibration) => (
                calibration.um_per_px(),
                shown_in_the_middle(scope, here, pixels, calibration),
            ),
            Map::ByAxes(um_per_px) => {
                let m = |k: usize| pixels[k] * um_per_px * 1e-6;
                let to = |pose: StagePose, axis: Axis, by: f64| match here.si(axis) {
                    Some(from) => pose.with_si(axis, from + by),
                    None => pose,
                };
                let x = to(StagePose::default(), Axis::X, m(0));
                (*um_per_px, to(x, Axis::Y, m(1)))
            }
        };
        let mut goal = match way.x == 0.0 && way.y == 0.0 {
            true => StagePose::default(),
            false => across,
        };
        let away = scope.gate().info().positive_z;
        let focus_m = way.z * FOCUS_PER_PX * um_per_px * STEP_S * 1e-6;
        let by = [
            (Axis::Z, away.away(0.0, focus_m)),
            (Axis::Rz, way.rz * TURN_DEG_PER_S.to_radians() * STEP_S),
        ];
        for (axis, by) in by {
            if let (true, Some(from)) = (by != 0.0, here.si(axis)) {
                goal = goal.with_si(axis, from + by);
            }
        }
        goal
    }
}

impl UseCase for Jog {
    type Output = ();

    fn kind(&self) -> &'static str {
        "jog"
    }

    fn can_go_on(&self) -> bool {
        false
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<()>, JobError> {
        let Some(way) = self.hold.way() else {
            return Ok(Progress::Done(()));
        };
        let scope = work.scope();
        let here = scope.gate().position()?;
        let goal = self.goal(scope, &here, way);
        match goal == StagePose::default() {
            true => Ok(Progress::Done(())),
            false => {
                scope.move_to(&goal)?;
                Ok(Progress::Continue)
            }
        }
    }
}
