//! Checks of stage and camera together.

use super::check::{Check, ensure, run_and_return, said};
use super::trial::{LONG_M, long_axis, towards_room, trial};
use crate::{Frame, Instrument, StagePose};
use std::time::Duration;

/// No image is on its way for longer.
const LATEST: Duration = Duration::from_secs(3);

/// Checks of stage and camera together: freshness after a move, grabbing during motion. Needs a specimen with structure.
pub fn check_together(scope: &Instrument) -> Vec<Check> {
    vec![
        run_and_return(scope, "a grab after a move shows the new place", || {
            let axis = long_axis(scope.gate())?;
            let (here, there) = towards_room(scope.gate(), axis, trial(axis))?;
            let to = |place: f64| StagePose::default().with_si(axis, place);
            let first = scope.grab().map_err(said)?;
            let same = scope.grab().map_err(said)?;
            scope.move_to(&to(there)).map_err(said)?;
            let moved = scope.grab().map_err(said)?;
            scope.move_to(&to(here)).map_err(said)?;
            let back = scope.grab().map_err(said)?;
            let (still, away) = (
                difference(&first, &same).max(difference(&first, &back)),
                difference(&first, &moved),
            );
            ensure(away > 1.5 * still, || {
                format!(
                    "images differ by {away:.4} after the move and by {still:.4} without it: is a specimen in, in focus?"
                )
            })
        }),
        run_and_return(
            scope,
            "a grab after a move shows where it ended, not the way",
            || {
                let axis = long_axis(scope.gate())?;
                let (_, there) = towards_room(scope.gate(), axis, trial(axis))?;
                let to = StagePose::default().with_si(axis, there);
                let before = scope.grab().map_err(said)?;
                scope.move_to(&to).map_err(said)?;
                let moved = scope.grab().map_err(said)?;
                // Whatever is on its way has come by then.
                scope.clock().sleep(LATEST);
                let later = scope.grab().map_err(said)?;
                let again = scope.grab().map_err(said)?;
                let (early, still) = (difference(&moved, &later), difference(&later, &again));
                let away = difference(&before, &later);
                ensure(away > 1.5 * still, || {
                    format!(
                        "there is too little to see ({away:.4} after the move, {still:.4} without it) to tell whether images are fresh: \
                     put in a specimen that does not matter, in focus"
                    )
                })?;
                ensure(early <= 2.0 * still + 1e-3, || {
                    format!(
                        "the image after a move differs by {early:.4} from one {} s later, where two in a row differ by {still:.4}: \
                     images are older than the camera's driver takes them for, or the stage goes on after it said that it stands",
                        LATEST.as_secs_f64()
                    )
                })
            },
        ),
        run_and_return(scope, "frames can be grabbed during motion", || {
            let axis = long_axis(scope.gate())?;
            let (_, there) = towards_room(scope.gate(), axis, LONG_M)?;
            scope
                .gate()
                .start_move(&StagePose::default().with_si(axis, there))
                .map_err(said)?;
            scope.camera().grab().map(|_| ()).map_err(said)
        }),
    ]
}

/// Mean absolute difference of two frames' luminance.
fn difference(a: &Frame, b: &Frame) -> f64 {
    let (a, b) = (a.luminance(), b.luminance());
    let sum: f64 = a
        .iter()
        .zip(&b)
        .map(|(x, y)| f64::from((x - y).abs()))
        .sum();
    sum / a.len().max(1) as f64
}
