//! Moves that end from one side: the play of an axis is then taken up the same way at each, and what is between them is what was asked for.

use crate::{Calibration, PlanarPose, ServoError};
use scopeservo_scope::{Axis, ErrorKind, Instrument, StagePose};

/// So many times its play an axis goes to take it up.
const RUN_UP: f64 = 1.5;
/// Play that moves the view by less counts for nothing, pixels.
const LEAST_PX: f64 = 0.25;
/// Nor does play that is not known better than to so many standard deviations.
const SIGMAS: f64 = 3.0;

/// More than a stage has play that a servo could work with: m, m, rad.
const PLAY: [f64; 3] = [50e-6, 50e-6, 2e-4];

/// Where to go before `pose`, so that every axis goes up to it, also one whose play nobody has measured.
pub(crate) fn below(pose: &PlanarPose, known: Option<&Calibration>) -> PlanarPose {
    let seen = known.and_then(|c| c.backlash);
    let seen = seen.map_or([0.0; 3], |b| [b.x_m, b.y_m, b.rz_rad]);
    let by = [0, 1, 2].map(|k| PLAY[k].max(RUN_UP * seen[k]));
    PlanarPose {
        x_m: [0, 1].map(|k| pose.x_m[k] - by[k]),
        theta_rad: pose.theta_rad - by[2],
    }
}

/// The play of x, y (m) and rotation (rad) that matters with a calibration.
fn play(calibration: &Calibration) -> [(Axis, f64); 3] {
    let least_m = LEAST_PX * 1e-6 * calibration.um_per_px();
    let lever_m = calibration
        .rotation_centre_m
        .map_or(0.0, |[x, y]| f64::hypot(x, y));
    let [x, y, rz] = calibration.backlash.map_or([0.0; 3], |b| {
        let widths = [b.x_m, b.y_m, b.rz_rad];
        let levers = [1.0, 1.0, lever_m];
        std::array::from_fn(|k| {
            let matters = widths[k] * levers[k] > least_m && widths[k] > SIGMAS * b.sigma[k];
            if matters { widths[k] } else { 0.0 }
        })
    });
    [(Axis::X, x), (Axis::Y, y), (Axis::Rz, rz)]
}

/// Where to go first, so that each axis with play then goes up to `goal`; `None` where all do anyway.
fn run_up(present: &StagePose, goal: &StagePose, calibration: &Calibration) -> Option<StagePose> {
    let mut via = *goal;
    for (axis, play) in play(calibration) {
        if let (Some(here), Some(there)) = (present.si(axis), goal.si(axis))
            && play > 0.0
            && there < here
        {
            via = via.with_si(axis, there - RUN_UP * play);
        }
    }
    (via != *goal).then_some(via)
}

/// Goes where the play is taken up from, where a move may go there.
fn runs_up(scope: &Instrument, via: &StagePose) -> Result<(), ServoError> {
    if scope.gate().allowed(&[*via])? != [true] {
        return Ok(());
    }
    match scope.move_to(via) {
        // The way there is judged when the move begins.
        Err(error) if error.kind() == ErrorKind::Refused => Ok(()),
        gone => Ok(gone.map(drop)?),
    }
}

/// Moves from where the stage stands to a goal, each axis that is known to have play going up at the end. Where the rules leave no room for
/// that it goes straight there.
pub(crate) fn move_from_one_side(
    scope: &Instrument,
    present: &StagePose,
    goal: &StagePose,
    calibration: &Calibration,
) -> Result<StagePose, ServoError> {
    if let Some(via) = run_up(present, goal, calibration) {
        runs_up(scope, &via)?;
    }
    Ok(scope.move_to(goal)?)
}

/// Moves to a goal with all axes going up at the end, also those whose play nobody has measured, where the rules leave room for that.
pub(crate) fn move_from_below(
    scope: &Instrument,
    goal: &StagePose,
    calibration: &Calibration,
) -> Result<StagePose, ServoError> {
    let via = below(&PlanarPose::from(goal), Some(calibration)).request(goal);
    runs_up(scope, &via)?;
    Ok(scope.move_to(goal)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Backlash, CALIBRATION_SCHEMA};
    use scopeservo_geometry::Mat2;
    use scopeservo_scope::ObjectiveId;

    fn calibration(backlash: Option<Backlash>) -> Calibration {
        Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: ObjectiveId("40x".into()),
            image_size_px: [640, 480],
            stage_from_pixel: Mat2([[5e-7, 0.0], [0.0, 5e-7]]),
            rotation_centre_m: Some([0.1, 0.0]),
            covariance: None,
            backlash,
            scatter: None,
        }
    }

    fn at(x: f64, y: f64, rz: f64) -> StagePose {
        StagePose::default()
            .with_si(Axis::X, x)
            .with_si(Axis::Y, y)
            .with_si(Axis::Rz, rz)
    }

    #[test]
    fn only_axes_that_go_down_and_have_play_that_matters_make_a_run_up() {
        let known = calibration(Some(Backlash {
            x_m: 2e-6,
            y_m: 2e-6,
            rz_rad: 1e-6,
            // That of y may be none.
            sigma: [1e-7, 1e-6, 1e-8],
        }));
        let here = at(0.0, 0.0, 0.0);
        assert_eq!(run_up(&here, &at(1e-5, 1e-5, 1e-3), &known), None);
        // The play of the rotation moves the view by 0.1 um, a fifth of a pixel.
        let via = run_up(&here, &at(-1e-5, -1e-5, -1e-3), &known).unwrap();
        assert!((via.si(Axis::X).unwrap() + 1.3e-5).abs() < 1e-12);
        assert_eq!(via.si(Axis::Y), Some(-1e-5));
        assert_eq!(via.si(Axis::Rz), Some(-1e-3));
        assert_eq!(
            run_up(&here, &at(-1e-5, 0.0, 0.0), &calibration(None)),
            None
        );
    }
}
