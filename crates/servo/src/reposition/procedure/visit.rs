//! The lowest objective does not tell where the target lies, but where it may: a higher one looks at these places, the most likely first.
//!
//! All that are as likely as the one where it is seen are looked at, too: seen twice it is ambiguous. Where it is seen once a leg begins there as
//! anywhere else, and claims nothing that it does not prove. Seen nowhere, all is left as it was.

use super::super::places::{Seen, Visit};
use super::super::{Leg, MagnificationResult, Outcome};
use super::{Reposition, State, Work};
use crate::event::tell;
use crate::one_side::move_from_one_side;
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
    /// Whether there are places to look at, and this was not tried before.
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
        // Nothing moves in the step that writes down where the stage stood.
        self.visited_from = Some((from.clone(), PlanarPose::from(&scope.gate().position()?)));
        self.state = State::Under {
            leg: Leg::Servo(at.to.clone()),
            work: Work::Visit,
        };
        self.visit = Some(Visit::of(at));
        Ok(true)
    }

    /// Whether the objective that is in focus is one that looks at places: then that goes on.
    pub(super) fn visits(&mut self, leg: &Leg) -> bool {
        let visit = self.visit.as_mut();
        let Some(visit) = visit.filter(|v| v.at.to == *leg.objective()) else {
            return false;
        };
        visit.in_focus = true;
        self.state = State::Under {
            leg: leg.clone(),
            work: Work::Visit,
        };
        true
    }

    /// Goes to the next place, with whatever objective is active.
    fn goes_to_next(&self, scope: &Instrument, leg: &Leg) -> Result<(), ServoError> {
        let next = self.visit.as_ref().and_then(Visit::next);
        if let Some((next, here)) = next.zip(self.calibrations.get(leg.objective())) {
            let present = scope.gate().position()?;
            move_from_one_side(scope, &present, &next.stage.request(&present), here)?;
        }
        Ok(())
    }

    /// A place where nothing is in focus is not where the target lies; one that cannot be looked at may be. Either way the next one follows.
    pub(super) fn passes_by(&mut self, error: &ServoError) -> bool {
        let State::Under {
            leg,
            work: Work::Bring(_) | Work::Visit,
        } = &self.state
        else {
            return false;
        };
        let leg = leg.clone();
        let Some(visit) = self.visit.as_mut().filter(|v| v.next().is_some()) else {
            return false;
        };
        match error.code() {
            ErrorCode::NoFocus | ErrorCode::AtLimit => visit.pass_by(),
            ErrorCode::OutsideLimits => visit.give_up(),
            _ if matches!(error, ServoError::ObjectiveUnclear { .. }) => visit.give_up(),
            _ => return false,
        }
        let work = Work::Visit;
        self.state = State::Under { leg, work };
        true
    }

    /// Looks at one place, or concludes.
    pub(super) fn visited(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        target: &Target,
        leg: Leg,
    ) -> Result<Option<Outcome>, ServoError> {
        let Some(visit) = &mut self.visit else {
            return Err(super::cannot_go_on(
                "a stored run lacks the places that it looks at",
            ));
        };
        let Some(next) = visit.next().copied() else {
            return self.concludes(scope, sink, target, leg);
        };
        // A run that goes on after a kill may find another objective than it left, or one that nobody has looked at.
        visit.in_focus &= scope.gate().current_objective()?.as_ref() == Some(leg.objective())
            && !scope.gate().objective_is_reported();
        let (in_focus, number) = (visit.in_focus, visit.looked);
        self.goes_to_next(scope, &leg)?;
        if !in_focus {
            self.bring(scope, leg);
            return Ok(None);
        }
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
                Ok(leads_to(&task, scope, seen, &stands))
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
        let (Some(visit), Some(here), Some(at_target)) = (
            self.visit.take(),
            self.calibrations.get(leg.objective()).cloned(),
            self.target_calibration(target),
        ) else {
            return Err(super::cannot_go_on(
                "a stored run lacks a calibration; start it anew",
            ));
        };
        let kinematics = scope.gate().info().kinematics;
        let another = match &visit.seen[..] {
            [] => None,
            [seen] => visit.unseen(seen, kinematics, &here),
            [one, other, ..] => Some(one.beside(&other.goal, kinematics, &here)),
        };
        match (another, visit.seen.first()) {
            (Some(off), _) => {
                let um_per_px = at_target.um_per_px();
                self.done.push(MagnificationResult {
                    objective: leg.objective().clone(),
                    magnification: scope.objective(leg.objective())?.magnification,
                    end: ServoEnd::Ambiguous {
                        rival: rival(&off, um_per_px),
                        um_per_px,
                    },
                    calibration: here,
                });
                Ok(self.done.last().map(|d| self.end(&d.end, target)))
            }
            (None, Some(seen)) => {
                let present = scope.gate().position()?;
                move_from_one_side(scope, &present, &seen.from.stage.request(&present), &here)?;
                self.servo(scope, sink, leg);
                Ok(None)
            }
            (None, None) => {
                self.leaves_places(scope)?;
                Ok(self.done.last().map(|d| self.end(&d.end, target)))
            }
        }
    }

    /// Back to where the view does not tell, after places were looked at in vain, and with the objective that saw it, unless somebody would have to turn
    /// the nosepiece for that; whether there were any.
    pub(super) fn leaves_places(&mut self, scope: &Instrument) -> Result<bool, ServoError> {
        let Some((objective, stood)) = self.visited_from.take() else {
            return Ok(false);
        };
        let present = scope.gate().position()?;
        scope.return_to(&stood.request(&present))?;
        if !scope.gate().objective_is_turned_by_hand() {
            scope.select_objective(&objective)?;
        }
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
