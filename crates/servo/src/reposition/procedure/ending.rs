//! How a run goes on after a loop, or ends.

use super::super::{Left, MagnificationResult, Outcome, Reason, Verdict, words};
use super::Reposition;
use crate::{ServoEnd, ServoError, Target};
use scopeservo_scope::{Instrument, ScopeError};

impl Reposition {
    /// The answer when a loop's end is the run's end. A target that was seen and lost again may be seen better by the next objective.
    pub(super) fn servoed(
        &mut self,
        scope: &Instrument,
        target: &Target,
        end: &ServoEnd,
        seen: bool,
    ) -> Option<Outcome> {
        let so_far = self.so_far(scope, target);
        let next = || self.policy().next(&so_far);
        let handed_over = |d: &MagnificationResult| matches!(d.end, ServoEnd::HandedOver { .. });
        let next = match end {
            ServoEnd::Converged(_) | ServoEnd::HandedOver { .. } => next(),
            // What was handed over and is not there may be seen by the objective in between.
            ServoEnd::Lost(_) if seen || self.done.iter().any(handed_over) => next(),
            ServoEnd::Lost(_) => self.policy().wider(&so_far),
            _ => None,
        };
        match next {
            Some(next) => {
                self.bring(next);
                None
            }
            None => Some(self.end(end, target)),
        }
    }

    /// The answer that the end of the last loop means.
    fn end(&self, end: &ServoEnd, target: &Target) -> Outcome {
        let at = self.done.last().map_or(0.0, |d| d.magnification);
        let seen_below = self.done.iter().any(|d| d.magnification < at);
        let left = self.left(end, target);
        let (verdict, reason, message) = words::answer_of(end, at, seen_below, left.as_ref());
        Outcome {
            angle_left_deg: left.map(|l| l.angle_deg),
            in_view: left.map(|l| l.in_view),
            missing: match end {
                ServoEnd::CannotReach { missing, .. } => Some(missing.clone()),
                _ => None,
            },
            ..self.outcome(verdict, reason, message)
        }
    }

    /// What a stage has left that did not turn.
    fn left(&self, end: &ServoEnd, target: &Target) -> Option<Left> {
        let ServoEnd::Converged(result) = end else {
            return None;
        };
        let view = &self.done.last()?.calibration;
        let um_per_px = self.target_calibration(target)?.um_per_px();
        let size = [target.features.width, target.features.height];
        let size_um = size.map(|px| px as f64 * um_per_px);
        let left = || Left::of(result, size_um, view, self.options.servo.within_deg);
        result.angle_is_left.then(left)
    }

    pub(super) fn outcome(&self, verdict: Verdict, reason: Reason, message: String) -> Outcome {
        let last = self.done.last().and_then(|d| d.end.result());
        Outcome {
            verdict,
            reason,
            message,
            estimated_error_um: last.map(|r| f64::hypot(r.error.distance_um(), r.sigma_um)),
            estimated_error_deg: last.map(|r| r.error.angle_deg().abs()),
            limited_by: last.and_then(|r| r.limited_by),
            angle_left_deg: None,
            in_view: None,
            missing: None,
            unique_within_um: self.done.iter().map(view_um).max_by(wider),
            magnifications: self.done.clone(),
        }
    }

    /// Turns what the method or the limits refuse into an answer; faults and interruptions stay errors.
    pub(super) fn answer(&self, error: ServoError) -> Result<Outcome, ServoError> {
        // A wider view would have taken another medium: what was looked for was not found.
        if let ServoError::Scope(ScopeError::ImmersionNotAgreed { .. }) = &error
            && let Some(end @ ServoEnd::Lost(_)) = self.done.last().map(|d| &d.end)
        {
            let outcome = self.end(end, &*self.target()?);
            let message = format!("{}. For a wider view {error}", outcome.message);
            return Ok(Outcome { message, ..outcome });
        }
        match Reason::of(&error) {
            Some(reason) => Ok(self.outcome(Verdict::Refused, reason, error.to_string())),
            None => Err(error),
        }
    }
}

/// Width and height of a view, um on the specimen.
fn view_um(at: &MagnificationResult) -> [f64; 2] {
    let size = at.calibration.image_size_px;
    size.map(|px| px as f64 * at.calibration.um_per_px())
}

fn wider(a: &[f64; 2], b: &[f64; 2]) -> std::cmp::Ordering {
    a[0].total_cmp(&b[0])
}
