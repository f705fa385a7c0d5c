//! How a run goes on after a loop, or ends.

use super::super::{Left, Leg, MagnificationResult, Outcome, Reason, Verdict, words};
use super::{Reposition, State, Work};
use crate::target::MIN_TARGET_FEATURES;
use crate::{
    Attempt, ErrorCode, ErrorKind, Identify, Identity, Progress, ServoEnd, ServoError, Sink, Target,
};
use scopeservo_registration::NotFound;
use scopeservo_scope::{Instrument, ObjectiveId, ScopeError};

impl Reposition {
    /// The answer when a loop's end is the run's end. A target that was seen and lost again may be seen better by the next objective.
    pub(super) fn servoed(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        target: &Target,
        (leg, end): (Leg, &ServoEnd),
        seen: bool,
    ) -> Result<Option<Outcome>, ServoError> {
        let lost = matches!(end, ServoEnd::Lost(_));
        // What was looked for in the dark was not looked for, and what is measured there scatters.
        let unsure = matches!(
            end,
            ServoEnd::OutsideTolerance { .. } | ServoEnd::IterationLimit(_) | ServoEnd::Diverged(_)
        );
        if (lost || unsure) && self.adapts_exposure(scope, sink)? {
            self.done.pop();
            return Ok(None);
        }
        if matches!(end, ServoEnd::Converged(_)) {
            let seen = self.watch.remarks().len();
            let before = self.remarks.len() - seen;
            let told = self.remarks.split_off(before);
            // The same loop goes on, and tells them when it ends.
            if self.sharpens(scope, sink)? {
                self.done.pop();
                return Ok(None);
            }
            self.remarks.extend(told);
            self.tells_blur(scope, sink);
        }
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
        Ok(match next {
            Some(next) => {
                if lost {
                    let to = next.objective().clone();
                    let attempt = Attempt::AnotherObjective { to };
                    self.tell_attempt(scope, sink, leg.objective().clone(), attempt);
                }
                self.bring(scope, next);
                None
            }
            // Before a view is said not to be there: is it seen with the objective that is said to be in?
            None if lost => {
                let identify = Identify::new(leg.objective().clone(), self.options.vision.clone());
                let work = Work::Identify(Box::new(identify));
                self.state = State::Under { leg, work };
                None
            }
            None => Some(self.end(end, target)),
        })
    }

    /// A step failed: what is left to try, or the answer that the failure is.
    pub(super) fn failed(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        error: ServoError,
    ) -> Result<Option<Outcome>, ServoError> {
        let answer = match self.goes_on_after(scope, sink, &error) {
            Ok(true) => return Ok(None),
            Ok(false) => self
                .withdraw(scope, &error)
                .and_then(|()| self.answer(error)),
            Err(error) => Err(error),
        };
        if answer.is_err() {
            self.exposes_as_before(scope);
        }
        answer.map(Some)
    }

    fn goes_on_after(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        error: &ServoError,
    ) -> Result<bool, ServoError> {
        Ok(self.tries_again(scope, sink, error)?
            || self.went_astray(scope, error)?
            || self.passes_by(error)
            || self.widens_focus(scope, sink, error)?)
    }

    /// What a look at the objective says to a target that was not seen.
    pub(super) fn looked_at(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        told: &ObjectiveId,
        seen: Result<Progress<Identity>, ServoError>,
    ) -> Result<Option<Outcome>, ServoError> {
        let target = self.target()?;
        match seen {
            Ok(Progress::Continue) => Ok(None),
            Ok(Progress::Done(identity)) if !identity.as_told => Err(ServoError::WrongObjective {
                told: told.clone(),
                looks_like: identity.looks_like,
                um_per_px: identity.um_per_px,
            }),
            Err(error @ ServoError::PictureStays { .. }) => Err(error),
            Err(error) if matches!(error.kind(), ErrorKind::Interruption | ErrorKind::Fault) => {
                Err(error)
            }
            // It is, or that could not be seen either.
            Ok(Progress::Done(_)) | Err(_) => {
                if self.begins_visit(scope, sink, told)? {
                    return Ok(None);
                }
                self.leave_as_found(scope)?;
                Ok(self.done.last().map(|d| self.end(&d.end, &target)))
            }
        }
    }

    /// What contradicts the stage's moves ends where the run began, on axes that were seen to obey; else the stage stands still.
    pub(super) fn go_back(&self, scope: &Instrument, end: &ServoEnd) -> Result<(), ServoError> {
        match end {
            ServoEnd::Contradicted { why, .. } if !why.leaves_standing() => {
                self.to_the_start(scope)
            }
            _ => Ok(()),
        }
    }

    /// A view that was not found where moves led that nobody has seen the end of: it is left as it was found.
    pub(super) fn leave_as_found(&mut self, scope: &Instrument) -> Result<(), ServoError> {
        if self.leaves_places(scope)? {
            return Ok(());
        }
        match self.watch.promise {
            Some(_) => self.to_the_start(scope),
            None => Ok(()),
        }
    }

    /// The same where the camera shows nothing any more, and the stage says that it obeys.
    pub(super) fn withdraw(
        &self,
        scope: &Instrument,
        error: &ServoError,
    ) -> Result<(), ServoError> {
        match error {
            ServoError::Scope(ScopeError::Frozen { .. } | ScopeError::Stale { .. }) => {
                self.to_the_start(scope)
            }
            _ => Ok(()),
        }
    }

    /// Nothing is in focus where one move led to another objective's view: it led elsewhere than it was to, off the slide for instance. The stage
    /// goes back, once, and the lowest objective sees what moves do.
    pub(super) fn went_astray(
        &mut self,
        scope: &Instrument,
        error: &ServoError,
    ) -> Result<bool, ServoError> {
        let unfocused = matches!(error.code(), ErrorCode::NoFocus | ErrorCode::AtLimit);
        if self.came_back {
            return Ok(false);
        }
        let (
            State::Under {
                leg,
                work: Work::Bring(_),
            },
            true,
        ) = (&self.state, unfocused)
        else {
            return Ok(false);
        };
        let (leg, target) = (leg.clone(), self.target()?);
        let Some(ServoEnd::HandedOver { .. }) = self.done.last().map(|d| &d.end) else {
            return Ok(false);
        };
        let calibration = self.calibrations.get(leg.objective()).cloned();
        let lowest = self.policy().outlook(&self.so_far(scope, &target));
        let (Some(calibration), Some(lowest), Some(before)) =
            (calibration, lowest.first(), self.watch.led_astray())
        else {
            return Ok(false);
        };
        self.came_back = true;
        let present = scope.gate().position()?;
        scope.return_to(&before.request(&present))?;
        self.done.push(MagnificationResult {
            magnification: scope.objective(leg.objective())?.magnification,
            objective: leg.objective().clone(),
            end: ServoEnd::Lost(NotFound::TooFewFeatures {
                view: 0,
                target: target.features.len(),
                needed: MIN_TARGET_FEATURES,
            }),
            calibration,
        });
        self.bring(scope, Leg::Servo(lowest.clone()));
        Ok(true)
    }

    fn to_the_start(&self, scope: &Instrument) -> Result<(), ServoError> {
        if let Some(began) = self.began {
            let present = scope.gate().position()?;
            scope.return_to(&began.request(&present))?;
        }
        Ok(())
    }

    /// The answer that the end of the last loop means.
    pub(super) fn end(&self, end: &ServoEnd, target: &Target) -> Outcome {
        let at = self.done.last().map_or(0.0, |d| d.magnification);
        let seen = |d: &MagnificationResult| d.magnification < at && d.end.result().is_some();
        let seen_below = self.done.iter().any(seen);
        let left = self.left(end, target);
        let (verdict, reason, mut message) = words::answer_of(end, at, seen_below, left.as_ref());
        if !matches!(end, ServoEnd::Contradicted { .. }) {
            message.push_str(&words::remarks(&self.remarks));
        }
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
        let seen = self.done.iter().filter(|d| d.end.result().is_some());
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
            remarks: self.remarks.clone(),
            unique_within_um: seen.map(view_um).max_by(wider),
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
