//! Whether the stage can go where the view would be back: asked of the first measurement that tells, before anything moves for it.

use super::criteria::Criteria;
use super::missing::{Beyond, Missing};
use super::sight::{Located, Sight};
use super::state::Servo;
use crate::{ServoEnd, ServoError, ServoTask, control_law};
use scopeservo_scope::{AxisRange, Instrument, Kinematics, StagePose};

/// What lies past an end by so many standard deviations does so surely...
const SIGMAS: f64 = 3.0;
/// ...where the calibration knows its own; else by this share of the way, and by what a rotation centre that is off by so much sweeps, m.
const UNKNOWN_SHARE: f64 = 0.1;
const UNKNOWN_CENTRE_M: f64 = 9.1e-3;
/// How far two objectives may look beside each other, m.
const PARCENTRIC_M: f64 = 20e-6;
/// Of an angle that is too far, so many parts of it are tried.
const PARTS: u32 = 400;

impl Servo {
    /// The end of a loop whose stage cannot bring a view back that does not pass. Where only its rotation is too short, and the angle may be left, the loop goes
    /// on without it.
    pub(crate) fn cannot_reach(
        &mut self,
        task: &ServoTask<'_>,
        scope: &Instrument,
        test: &mut Criteria<'_>,
        (sight, located, passes): (&Sight<'_>, &Located, bool),
    ) -> Result<Option<ServoEnd>, ServoError> {
        if passes {
            return Ok(None);
        }
        let goals = scope.gate().goals()?;
        let error = &located.pose.error;
        // Where the view is back, but for a share of the angle.
        let place = |share: f64| {
            let mut velocity = control_law(error, 1.0);
            velocity.theta_rad *= share;
            sight.goal(&velocity)
        };
        let turn = if test.turns { 1.0 } else { 0.0 };
        if goals.allow(&place(turn)) {
            return Ok(None);
        }
        let beyond = beyond(scope, &place(turn))?;
        let unsure_m = unsure_m(task, located);
        let surely = |b: &Beyond| {
            b.by.abs()
                > match b.axis.is_rotation() {
                    true => SIGMAS * located.pose.sigma()[2],
                    false => unsure_m,
                }
        };
        let (_, next) = self.next_step(task, (sight, located), test.turns, &goals);
        if !beyond.iter().any(surely) && goals.allow(&next) {
            return Ok(None);
        }
        let turned_deg = error.angle_deg();
        let may_be_left = task
            .options
            .within_deg
            .is_some_and(|deg| turned_deg.abs() <= deg);
        if test.turns && may_be_left && goals.allow(&place(0.0)) {
            (self.leaves_angle, test.turns) = (true, false);
            return Ok(None);
        }
        let rule = scope.gate().check(&place(turn)).err();
        let turn_back = (1..=PARTS).find(|part| {
            test.turns && goals.allow(&place(1.0 - f64::from(*part) / f64::from(PARTS)))
        });
        let missing = Missing {
            rule: rule.filter(|_| beyond.is_empty()).map(|e| e.to_string()),
            beyond,
            turned_deg,
            turn_back_deg: turn_back
                .map(|part| turned_deg.abs() * f64::from(part) / f64::from(PARTS)),
            carries_specimen: scope.gate().info().kinematics != Kinematics::MovesMicroscope,
        };
        let last = self.convergence.result(sight.measured(located, task));
        Ok(Some(ServoEnd::CannotReach { missing, last }))
    }
}

/// How far a place lies past the ends of axes, with the active objective.
fn beyond(scope: &Instrument, place: &StagePose) -> Result<Vec<Beyond>, ServoError> {
    let gate = scope.gate();
    let active = gate.current_objective()?;
    let own = active.and_then(|id| gate.rules().objective_limits.get(&id));
    let ranges = gate
        .ranges()
        .iter()
        .chain(own.iter().flat_map(|l| &l.ranges));
    let mut all: Vec<Beyond> = Vec::new();
    for &AxisRange { axis, min, max } in ranges {
        let Some(at) = place.si(axis) else { continue };
        let by = (at - max).max(0.0) + (at - min).min(0.0);
        // Of two ranges of an axis the narrower one counts.
        match all.iter_mut().find(|b| b.axis == axis) {
            Some(before) if before.by.abs() >= by.abs() => {}
            Some(before) => *before = Beyond { axis, by, min, max },
            None if by != 0.0 => all.push(Beyond { axis, by, min, max }),
            None => {}
        }
    }
    Ok(all)
}

/// How far off the place may be that a measurement says is the goal's, m.
fn unsure_m(task: &ServoTask<'_>, located: &Located) -> f64 {
    let error = &located.pose.error;
    let way_m = f64::hypot(error.t_m[0], error.t_m[1]);
    let known = task.view_calibration.move_sigma_m(way_m, error.theta_rad);
    let sweep_m = 2.0 * UNKNOWN_CENTRE_M * (0.5 * error.theta_rad).sin().abs();
    let [x, y, _] = located.pose.sigma();
    let move_m = known.map_or(UNKNOWN_SHARE * way_m + sweep_m, |sigma_m| SIGMAS * sigma_m);
    let change_m = if task.is_arrival() { 0.0 } else { PARCENTRIC_M };
    move_m + SIGMAS * f64::hypot(x, y) + change_m
}
