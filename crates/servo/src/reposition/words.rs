//! The end of a run in words.

use super::words_of_reach::{cannot_reach, outside_tolerance};
use super::{Left, Reason, Verdict};
use crate::target::MIN_TARGET_FEATURES;
use crate::words::rival_in_words;
use crate::{Attempt, Contradiction, Known, LimitedBy, Remark, ServoEnd, ServoResult};
use scopeservo_scope::{ObjectiveId, deg_in_words, um_in_words};

/// The answer that the end of the last loop means, at the magnification `at`. `seen_below`: the target was seen at a lower one; `left`: what a
/// stage has left that did not turn.
pub(super) fn answer_of(
    end: &ServoEnd,
    at: f64,
    seen_below: bool,
    left: Option<&Left>,
) -> (Verdict, Reason, String) {
    match end {
        ServoEnd::Converged(result) => converged(result, left),
        ServoEnd::CannotReach { missing, .. } => {
            let message = cannot_reach(missing);
            (Verdict::Refused, Reason::CannotReach, message)
        }
        ServoEnd::OutsideTolerance { .. } => {
            let message = outside_tolerance(end);
            (Verdict::Refused, Reason::OutsideTolerance, message)
        }
        ServoEnd::Lost(reason) => {
            let advice = if seen_below {
                "It was seen at a lower magnification, so look for a bubble, poor focus or a slipping stage"
            } else {
                "Bring the specimen so that the place lies in the field at the lowest magnification"
            };
            let message =
                format!("the saved view was not found at {at}x: {reason}. {advice}, and try again");
            (Verdict::NotFound, Reason::TargetNotInView, message)
        }
        ServoEnd::IterationLimit(result) | ServoEnd::HandedOver { last: result, .. } => {
            let message = format!(
                "at {at}x the view was still {} off after {} iterations; raise the limit or lambda, or look for \
                     vibration",
                um_in_words(result.error.distance_um(), 2),
                result.iterations
            );
            (Verdict::Refused, Reason::IterationLimit, message)
        }
        ServoEnd::Ambiguous { rival, um_per_px } => {
            let message = format!(
                "at {at}x another place looks just like the saved view, {} away, and which is which could not be told: save a view \
                     with something that is there only once, a defect or an edge",
                rival_in_words(rival, Some(*um_per_px))
            );
            (Verdict::Ambiguous, Reason::Ambiguous, message)
        }
        ServoEnd::NothingMoves { moved_um } => {
            let message = format!(
                "at {at}x the stage moved by {}, and nothing in the image moved with it: the stage is stuck, or all that \
                     agrees with the saved view is on the camera (dust, a reticle, burnt-in text)",
                um_in_words(*moved_um, 1)
            );
            (Verdict::Refused, Reason::NothingMoves, message)
        }
        ServoEnd::Unproven(_) => {
            let message = format!(
                "at {at}x the image agrees with the saved view, but too little of what agrees was seen to move with the specimen: the \
                     rest may be on the camera. Clean it, or save a view with more tissue"
            );
            (Verdict::Refused, Reason::Unproven, message)
        }
        ServoEnd::Drifting { um_per_s, .. } => {
            let message = format!(
                "the view drifts by {} per second while the stage stands: wait until it rests, and look for what slips or \
                     warms up, then try again",
                um_in_words(*um_per_s, 2)
            );
            (Verdict::Refused, Reason::Drifting, message)
        }
        ServoEnd::Contradicted { why, .. } => {
            let message = format!("at {at}x the run was stopped: {}", contradiction(*why));
            (Verdict::Refused, Reason::Contradicted, message)
        }
        ServoEnd::Diverged(result) => {
            let message = format!(
                "at {at}x the view moved away, to {:.0} um, and the run was stopped: calibrate again and check that \
                     nothing slips",
                result.error.distance_um()
            );
            (Verdict::Refused, Reason::Diverged, message)
        }
    }
}

/// The place is back; the angle may be left.
fn converged(result: &ServoResult, left: Option<&Left>) -> (Verdict, Reason, String) {
    let off = um_in_words(result.error.distance_um(), 2);
    let off_deg = result.error.angle_deg().abs();
    let limit = match result.limited_by {
        Some(LimitedBy::Repeatability) => ", as near as this stage comes back to a place",
        Some(LimitedBy::Measurement) => ", as near as this little texture tells",
        None => "",
    };
    let Some(left) = left else {
        let message = format!(
            "the saved view is back, {off} and {} off by its own measurement{limit}",
            deg_in_words(off_deg, 4)
        );
        return (Verdict::Arrived, Reason::Converged, message);
    };
    let percent = 100.0 * left.in_view;
    let angle = deg_in_words(off_deg, 2);
    if left.is_too_much {
        let message = format!(
            "the place is back, {off} off, but {angle} are left, and this stage does not turn: {percent:.0} % of the \
             saved view is in view. Turn the specimen back by hand and try again"
        );
        return (Verdict::Refused, Reason::CannotTurn, message);
    }
    let message = format!(
        "the place of the saved view is back, {off} off by its own measurement{limit}; {angle} are left, which this stage \
         does not turn: {percent:.0} % of the saved view is in view"
    );
    (Verdict::Arrived, Reason::Converged, message)
}

/// What was seen of the instrument, as more sentences.
pub(super) fn remarks(all: &[Remark]) -> String {
    all.iter().map(|r| format!(". {}", remark(r))).collect()
}

/// In words, and what to do.
fn remark(remark: &Remark) -> String {
    match remark {
        Remark::Drifted {
            objective,
            scale,
            turned_deg,
            centre_mm,
        } => {
            let shows = |known: &Known| known.value.abs() > 2.0 * known.sigma;
            let mut parts = Vec::new();
            if shows(scale) {
                parts.push(format!("scale {:+.1} %", 100.0 * scale.value));
            }
            if shows(turned_deg) {
                parts.push(format!("angle {:+.2} deg", turned_deg.value));
            }
            if centre_mm.iter().any(shows) {
                let [x, y] = centre_mm.map(|k| k.value);
                parts.push(format!("rotation centre by {x:+.1} and {y:+.1} mm"));
            }
            if parts.is_empty() {
                parts.push(
                    "scale, angle or rotation centre, and these moves do not tell which".into(),
                );
            }
            format!(
                "The calibration drifted: by the moves with {objective}, {}, or the stage goes wrong by as much, or something was moved. \
                 Run `check`, or `calibrate` again",
                parts.join(", ")
            )
        }
        Remark::Beside {
            objective,
            um,
            share_of_way: None,
        } => format!(
            "When {objective} came in the view lay {um:.0} um beside where it was to be: either the slide or the stage was moved meanwhile, or \
             lost steps, or the calibration has drifted, which `check` tells"
        ),
        Remark::Beside {
            objective,
            um,
            share_of_way: Some(share),
        } => format!(
            "When {objective} came in the view lay {um:.0} um {} where it was to be, {:.0} % of its way: either moves come out {}, or the scale \
             of the calibration has drifted, which `check` tells, or the slide or the stage was moved meanwhile",
            if *share < 0.0 { "short of" } else { "past" },
            100.0 * share.abs(),
            if *share < 0.0 { "short" } else { "long" },
        ),
        Remark::ScalesDisagree { objective, factor } => format!(
            "The calibration drifted: beside the target's objective the scale of {objective} is {:+.1} % off. Run `check` for both",
            100.0 * (factor - 1.0)
        ),
        Remark::Blurred {
            objective,
            defocus_um,
            sharpness,
        } => format!(
            "With {objective} the view is less sharp than the saved one, by as much as {} of defocus make ({:.0} % of its fine \
             detail). Focus by hand, and look for dirt or oil on the slide and the objective, and for vibration",
            um_in_words(*defocus_um, 1),
            100.0 * sharpness
        ),
        Remark::Tried { objective, attempt } => tried(objective, attempt),
        Remark::Contradicted { why, .. } => {
            let why = contradiction(*why);
            let mut letters = why.chars();
            let first = letters.next().map(|c| c.to_ascii_uppercase());
            format!(
                "On the way a move did not do what it was to do. {}{}",
                first.map(String::from).unwrap_or_default(),
                letters.as_str()
            )
        }
    }
}

/// What was tried, why, and what would spare it.
fn tried(objective: &ObjectiveId, attempt: &Attempt) -> String {
    match attempt {
        Attempt::ExposureAdapted { from_ms, to_ms } => format!(
            "The view was too {} with {objective}, and was exposed for {to_ms:.3} ms instead of {from_ms:.3} ms, until the run ended. Look at the lamp \
             and at the camera's exposure",
            if to_ms > from_ms { "dark" } else { "bright" }
        ),
        Attempt::FocusWidened { half_range_um } => format!(
            "With {objective} nothing was in focus near the height where it was looked for first, and it was looked for once more within \
             {half_range_um:.0} um"
        ),
        Attempt::DriftWaitedFor { um_per_s } => format!(
            "The view drifted by {} per second with {objective}, and the run waited for it to rest",
            um_in_words(*um_per_s, 2)
        ),
        Attempt::FocusedAgain { defocus_um } => format!(
            "With {objective} the view was less sharp than the saved one, by as much as {} of defocus make, and the run looked for \
             another height",
            um_in_words(*defocus_um, 1)
        ),
        Attempt::OtherSide => format!(
            "Moves with {objective} came no nearer, and from then on each axis went to its goal from below, which takes up its play. `calibrate` \
             measures the play"
        ),
        Attempt::AnotherObjective { to } => {
            format!("The saved view was not seen with {objective}, and was looked for with {to}")
        }
        Attempt::PlacesVisited { with, most } => format!(
            "With {objective} the saved view could not be told from what is around it, and {with} looked where it may be, at {most} place{} at \
             most",
            if *most == 1 { "" } else { "s" }
        ),
    }
}

/// What contradicts the moves, and what to do.
fn contradiction(why: Contradiction) -> String {
    match why {
        Contradiction::NothingMoved => {
            "the stage was moved, and the view stayed where it was. Look for a motor that is off, a stage that stands against \
             something, and a camera that shows an old image"
                .into()
        }
        Contradiction::AxisStands(axis) => format!(
            "the view did not follow {axis}. Look for a motor that is off or stands against something, then `check`"
        ),
        Contradiction::AxisReversed(axis) => format!(
            "{axis} goes the other way than when it was calibrated. Look at its sign in the description, then `calibrate`"
        ),
        Contradiction::Reversed => {
            "x and y go the other way than when they were calibrated. Was the camera turned, or a sign changed? Then `calibrate`"
                .into()
        }
        Contradiction::Swapped => {
            "x and y are exchanged since the calibration. Look at the axes in the description, then `calibrate`".into()
        }
        Contradiction::Turned(rad) => format!(
            "the view went in a direction turned by {:.1} deg. The camera was turned in its mount since the calibration: `calibrate`",
            rad.to_degrees()
        ),
        Contradiction::Scaled(factor) => format!(
            "the image shows the saved view {factor:.2} times as large as this objective does. Another objective is in than is told, as the \
             nosepiece did not turn or was turned by hand, or the camera bins its pixels otherwise: look, then `calibrate`"
        ),
        Contradiction::Late(frames) => format!(
            "what a move did was seen only {frames} frames later, while nothing moved. The camera shows stale images, from a buffer of its \
             driver, or the stage goes on after it says that it stands"
        ),
        Contradiction::Share(share) => format!(
            "the view went {:.0} % of what was asked. Another objective may be in than is told, the images binned otherwise, or a \
             unit changed: look, then `calibrate`",
            100.0 * share
        ),
        Contradiction::Elsewhere => {
            "the view went elsewhere than the stage was sent. The stage lost steps, the slide slipped, or something was moved by hand: \
             see that all is fast, then try again, or `check`"
                .into()
        }
    }
}

/// A target with too little to come back to.
pub(super) fn blank_target(features: usize) -> String {
    format!(
        "the target has {features} features and at least {MIN_TARGET_FEATURES} are needed to recognise it: \
         save a view with more tissue in focus"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PoseError;

    fn ended(um: f64, deg: f64) -> ServoResult {
        ServoResult {
            iterations: 3,
            inliers: 100,
            error: PoseError {
                t_m: [um * 1e-6, 0.0],
                theta_rad: deg.to_radians(),
            },
            sigma_um: 0.001,
            sigma_deg: 0.000_01,
            limited_by: None,
            angle_is_left: false,
        }
    }

    #[test]
    fn what_is_left_is_never_told_as_nothing() {
        let said = |end: &ServoEnd, left: Option<&Left>| answer_of(end, 400.0, true, left).2;
        for (um, deg, words) in [
            (
                0.264,
                0.000_3,
                "the saved view is back, 0.26 um and 0.0003 deg off by its own measurement",
            ),
            (
                0.004,
                -0.000_3,
                "the saved view is back, less than 0.01 um and 0.0003 deg off by its own measurement",
            ),
            (
                0.0,
                0.000_01,
                "the saved view is back, less than 0.01 um and less than 0.0001 deg off by its own measurement",
            ),
        ] {
            let end = ServoEnd::Converged(ended(um, deg));
            assert_eq!(said(&end, None), words);
        }
        let left = Left {
            angle_deg: 0.002,
            in_view: 0.9,
            is_too_much: false,
        };
        assert_eq!(
            said(&ServoEnd::Converged(ended(0.001, 0.002)), Some(&left)),
            "the place of the saved view is back, less than 0.01 um off by its own measurement; less than 0.01 deg are left, which this stage \
             does not turn: 90 % of the saved view is in view"
        );
        let still = said(&ServoEnd::IterationLimit(ended(0.002, 1.0)), None);
        assert!(
            still
                .starts_with("at 400x the view was still less than 0.01 um off after 3 iterations"),
            "{still}"
        );
        let outside = ServoEnd::OutsideTolerance {
            last: ended(0.001, 0.0),
            asked_um: Some(0.0005),
            asked_deg: None,
            stage_um: 0.004,
            stage_deg: 0.000_02,
        };
        let outside = said(&outside, None);
        assert!(
            outside.contains("the place is back, less than 0.01 um and less than 0.0001 deg off")
                && outside
                    .contains("comes back to within less than 0.01 um and less than 0.0001 deg"),
            "{outside}"
        );
    }
}
