//! The lowest objective does not tell where the target lies, but where it may: a higher one looks at these places, the most likely first.
//!
//! All that are as likely as the one where it is seen are looked at, too: seen twice it is ambiguous. Where it is seen once a leg begins there as
//! anywhere else, and claims nothing that it does not prove. Seen nowhere, all is left as it was.

use super::super::places::{Seen, Visit};
use super::super::{Leg, MagnificationResult, Outcome};
use super::{Reposition, State, Work};
use crate::event::tell;
use crate::servo::may_lie::leads_to;
use crate::vision::{grab_from_here, gray};
use crate::{
    Attempt, ErrorCode, Event, Expected, FixedPlaces, FrameRole, PlanarPose, PoseError, ServoEnd,
    ServoError, ServoTask, Sink, Target,
};
use scopeservo_geometry::Affine2;
use scopeservo_registration::Rival;
use scopeservo_scope::{Instrument, ObjectiveId};

impl Reposition {
    /// Goes to the most likely place and brings the objective that looks, where there is one and that was not tried before.
    pub(super) fn begins_visit(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        from: &ObjectiveId,
    ) -> Result<bool, ServoError> {
        let Some(at) = self.may_lie_at.take() else {
            return Ok(false);
        };
        let attempt = Attempt::PlacesVisited {
            with: at.to.clone(),
            most: at.places.len(),
        };
        if !self.calibrations.contains_key(&at.to) || !self.tried.first(&attempt) {
            return Ok(false);
        }
        self.tell_attempt(scope, sink, from.clone(), attempt);
        let leg = Leg::Servo(at.to.clone());
        self.visited_from = Some((from.clone(), PlanarPose::from(&scope.gate().position()?)));
        self.visit = Some(Visit::of(at));
        self.goes_to_next(scope)?;
        self.bring(scope, leg);
        Ok(true)
    }

    /// Whether places are looked at with this objective.
    pub(super) fn visits(&self, with: &ObjectiveId) -> bool {
        self.visit.as_ref().is_some_and(|v| v.at.to == *with)
    }

    fn goes_to_next(&self, scope: &Instrument) -> Result<(), ServoError> {
        if let Some(next) = self.visit.as_ref().and_then(Visit::next) {
            let present = scope.gate().position()?;
            scope.move_to(&next.stage.request(&present))?;
        }
        Ok(())
    }

    /// Nothing is in focus at a place: it is not there.
    pub(super) fn passes_by(
        &mut self,
        scope: &Instrument,
        error: &ServoError,
    ) -> Result<bool, ServoError> {
        let unfocused = matches!(error.code(), ErrorCode::NoFocus | ErrorCode::AtLimit);
        let State::Under {
            leg,
            work: Work::Bring(_),
        } = &self.state
        else {
            return Ok(false);
        };
        let leg = leg.clone();
        let Some(visit) = self.visit.as_mut().filter(|_| unfocused) else {
            return Ok(false);
        };
        visit.looked += 1;
        match visit.next() {
            Some(_) => {
                self.goes_to_next(scope)?;
                self.bring(scope, leg);
            }
            None => {
                let work = Work::Visit;
                self.state = State::Under { leg, work };
            }
        }
        Ok(true)
    }

    /// Looks at one place, or concludes.
    pub(super) fn visited(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        target: &Target,
        leg: Leg,
    ) -> Result<Option<Outcome>, ServoError> {
        let Some(visit) = &self.visit else {
            return Err(super::cannot_go_on(
                "a stored run lacks the places that it looks at",
            ));
        };
        let Some(next) = visit.next().copied() else {
            return self.concludes(scope, sink, target, leg);
        };
        let number = visit.looked;
        self.goes_to_next(scope)?;
        let goal = self.looks(scope, sink, target, (&leg, number))?;
        let seen = goal.map(|goal| Seen { from: next, goal });
        let here = self.calibrations.get(leg.objective());
        if let (Some(visit), Some(here)) = (&mut self.visit, here) {
            let kinematics = scope.gate().info().kinematics;
            visit.take(seen, kinematics, here);
        }
        Ok(None)
    }

    /// Where the stage brings the target back that is seen where it stands, at any angle.
    fn looks(
        &self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        target: &Target,
        (leg, number): (&Leg, usize),
    ) -> Result<Option<PlanarPose>, ServoError> {
        let objective = leg.objective();
        let frame = grab_from_here(scope, sink, FrameRole::Servo, objective)?;
        let view = gray(scope, &frame)?;
        let at_target = self.target_calibration(target);
        let calibrations = self.calibrations.get(objective).zip(at_target.as_ref());
        let Some((here, at_target)) = calibrations else {
            return Err(super::cannot_go_on(
                "a stored run lacks a calibration; start it anew",
            ));
        };
        let task = ServoTask {
            target,
            view_calibration: here,
            target_calibration: at_target,
            hand_overs: &[],
            vision: &self.options.vision,
            options: &self.options.servo,
            law: None,
            localizer: None,
        };
        let expected = Expected {
            prior: task.before_any_frame(),
            fixed: &FixedPlaces::default(),
        };
        let stands = PlanarPose::from(&scope.gate().position()?);
        match task.locate(&view, &expected)? {
            Ok(seen) => {
                let seen = (
                    &seen.estimate.target_from_view,
                    [view.width(), view.height()],
                );
                Ok(leads_to(&task, scope, seen, [0.0; 2], &stands))
            }
            Err(reason) => {
                let event = Event::Lost {
                    objective: objective.clone(),
                    iteration: number,
                    sequence: frame.sequence,
                    reason,
                };
                tell(scope, sink, event);
                Ok(None)
            }
        }
    }

    fn concludes(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        target: &Target,
        leg: Leg,
    ) -> Result<Option<Outcome>, ServoError> {
        let Some(visit) = self.visit.take() else {
            return Ok(None);
        };
        match visit.seen[..] {
            [seen] => {
                let present = scope.gate().position()?;
                scope.move_to(&seen.from.stage.request(&present))?;
                self.servo(scope, sink, leg);
                Ok(None)
            }
            [one, other, ..] => {
                let kinematics = scope.gate().info().kinematics;
                let ends = self.target_calibration(target);
                if let Some((calibration, at_target)) =
                    self.calibrations.get(leg.objective()).zip(ends)
                {
                    let um_per_px = at_target.um_per_px();
                    let off = one.beside(&other, kinematics, calibration);
                    self.done.push(MagnificationResult {
                        objective: leg.objective().clone(),
                        magnification: scope.objective(leg.objective())?.magnification,
                        end: ServoEnd::Ambiguous {
                            rival: rival(&off, um_per_px),
                            um_per_px,
                        },
                        calibration: calibration.clone(),
                    });
                }
                Ok(self.done.last().map(|d| self.end(&d.end, target)))
            }
            [] => {
                self.leaves_places(scope)?;
                Ok(self.done.last().map(|d| self.end(&d.end, target)))
            }
        }
    }

    /// Back to where the view does not tell, with the objective that saw it, after places were looked at in vain; whether there were any.
    pub(super) fn leaves_places(&mut self, scope: &Instrument) -> Result<bool, ServoError> {
        let Some((objective, stood)) = self.visited_from.take() else {
            return Ok(false);
        };
        let present = scope.gate().position()?;
        scope.move_to(&stood.request(&present))?;
        scope.select_objective(&objective)?;
        Ok(true)
    }
}

/// Where another place lies beside one, for the answer.
fn rival(off: &PoseError, um_per_px: f64) -> Rival {
    Rival {
        target_from_view: Affine2::IDENTITY,
        shift_px: off.t_um().map(|um| um / um_per_px),
        turn_rad: off.theta_rad,
        places: 1,
        asked: 1,
        significant: true,
    }
}
