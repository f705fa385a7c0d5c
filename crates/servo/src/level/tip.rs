//! Turning an axis that tips, a little at a time, and never nearer to the specimen than before.
//!
//! Where the axis is and which way it turns nobody knows, so any point under the objective may come nearer by the longest lever that there can be.
//! So the stage retreats by that first, turns, and comes back to where the focus is expected, short of it by what is not known; the focus that is
//! found there tells the lever, and the next turn may be longer.

use super::error::LevelError;
use super::lever::{Bounds, Lever};
use crate::focus::{Focus, FocusOptions};
use crate::procedure::{Procedure as _, Progress};
use crate::{ServoError, Sink};
use scopeservo_scope::{Axis, AxisInfo, Instrument, Length, Objective, ScopeError, StagePose};
use serde::{Deserialize, Serialize};

/// A turn that no rule allows whole is halved so often.
const HALVED: u32 = 4;
/// The search for the focus goes farther than where it must be by so many widths of the finest level of detail: in all, and towards the specimen.
const BEYOND: [f64; 2] = [8.0, 3.0];
/// Turns shorter than this change nothing that anybody sees, rad.
pub(super) const LEAST_RAD: f64 = 5e-6;

/// A stage in focus that tips.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Tip {
    pub(super) axis: Axis,
    left_rad: f64,
    objective: Objective,
    focus: FocusOptions,
    pub(super) lever: Lever,
    bounds: Bounds,
    /// Where it was last in focus, um.
    pub(super) z_um: f64,
    doing: Doing,
}

/// What comes next. A turn is written down before it is made: who goes on after a kill makes it again to the same place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Doing {
    Plan,
    Turn(Way),
    Focus { by_rad: f64, focus: Box<Focus> },
}

/// Where a turn leads.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Way {
    by_rad: f64,
    far_um: f64,
    near_um: f64,
    /// How far the focus may be from where the search begins, um.
    reach_um: f64,
    to_rad: f64,
}

impl Tip {
    pub(super) fn new(
        (axis, by_rad): (Axis, f64),
        objective: &Objective,
        focus: &FocusOptions,
        (lever, bounds): (Lever, Bounds),
        z_um: f64,
    ) -> Self {
        Self {
            axis,
            left_rad: by_rad,
            objective: objective.clone(),
            focus: focus.clone(),
            lever,
            bounds,
            z_um,
            doing: Doing::Plan,
        }
    }

    /// Turns on, or looks for the focus. Done when it stands in focus after the last turn.
    pub(super) fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<()>, ServoError> {
        match &mut self.doing {
            Doing::Plan if self.left_rad.abs() < LEAST_RAD => return Ok(Progress::Done(())),
            Doing::Plan => self.doing = Doing::Turn(self.way(scope)?),
            Doing::Turn(way) => {
                let way = *way;
                self.turn(scope, &way)?;
                let width_um = Focus::finest_width_um(&self.objective);
                let options = FocusOptions {
                    half_range_um: way.reach_um + BEYOND[0] * width_um,
                    nearest_um: way.reach_um + BEYOND[1] * width_um,
                    ..self.focus.clone()
                };
                let focus = Box::new(Focus::new(self.objective.clone(), options));
                let by_rad = way.by_rad;
                self.doing = Doing::Focus { by_rad, focus };
            }
            Doing::Focus { by_rad, focus } => {
                if let Progress::Done(found) = focus.step(scope, sink)? {
                    let by_rad = *by_rad;
                    self.focused(by_rad, found.z_um)?;
                }
            }
        }
        Ok(Progress::Continue)
    }

    /// The focus after a turn tells the lever.
    fn focused(&mut self, by_rad: f64, z_um: Option<f64>) -> Result<(), ServoError> {
        let z_um = z_um.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?;
        let change_um = z_um - self.z_um;
        if !Lever::explains(&self.bounds, by_rad, change_um) {
            return Err(LevelError::TipsTooFar {
                axis: self.axis,
                asked: by_rad,
                shift_um: change_um.abs(),
                lever_mm: 1e3 * self.bounds.lever_m,
            }
            .into());
        }
        self.lever.learn(by_rad, 1e-6 * change_um);
        self.z_um = z_um;
        self.left_rad -= by_rad;
        self.doing = Doing::Plan;
        Ok(())
    }

    /// The longest turn that surprises nobody and that all rules allow, from the retreat to the focus after it.
    fn way(&self, scope: &Instrument) -> Result<Way, ServoError> {
        let goals = scope.gate().goals()?;
        let here = goals.here.si(self.axis).unwrap_or(f64::NAN);
        let most = self
            .lever
            .longest_rad(&self.bounds)
            .min(largest_step(scope, self.axis));
        let mut by_rad = self.left_rad.clamp(-most, most);
        for _ in 0..=HALVED {
            let way = self.way_of(scope, here, by_rad);
            let turned = StagePose::default().with_si(self.axis, way.to_rad);
            let at = |z_um: f64, of: StagePose| of.with_si(Axis::Z, 1e-6 * z_um);
            let expected_um = self.z_um + 1e6 * self.lever.m() * by_rad;
            let places = [
                at(way.far_um, StagePose::default()),
                at(way.far_um, turned),
                at(way.near_um, turned),
                at(expected_um, turned),
            ];
            if places.iter().all(|to| goals.allow(to)) {
                return Ok(way);
            }
            if by_rad.abs() < 2.0 * LEAST_RAD {
                break;
            }
            by_rad *= 0.5;
        }
        // Why not: the gate says it best.
        let way = self.way_of(scope, here, by_rad);
        let turned = StagePose::default().with_si(self.axis, way.to_rad);
        scope.gate().check(&turned)?;
        let retreat_um = (way.far_um - self.z_um).abs();
        let axis = self.axis;
        Err(LevelError::NoRoom { axis, retreat_um }.into())
    }

    fn way_of(&self, scope: &Instrument, here_rad: f64, by_rad: f64) -> Way {
        let side = scope.gate().info().positive_z;
        let far_um = side.away(
            self.z_um,
            self.lever.nearer_um(&self.bounds, by_rad) + clearance_um(scope),
        );
        let expected_um = self.z_um + 1e6 * self.lever.m() * by_rad;
        let unsure_um = self.lever.unsure_um(&self.bounds, by_rad) + clearance_um(scope);
        Way {
            by_rad,
            far_um,
            near_um: side.away(expected_um, unsure_um),
            reach_um: 2.0 * unsure_um,
            to_rad: here_rad + by_rad,
        }
    }

    fn turn(&self, scope: &Instrument, way: &Way) -> Result<(), ServoError> {
        retreat(scope, way.far_um)?;
        scope.move_to(&StagePose::default().with_si(self.axis, way.to_rad))?;
        approach(scope, way.near_um)
    }
}

fn clearance_um(scope: &Instrument) -> f64 {
    let z = scope.gate().info().axis(Axis::Z);
    1e6 * z.map_or(0.0, AxisInfo::clearance)
}

/// The longest single move of an axis that is allowed, a little less.
fn largest_step(scope: &Instrument, axis: Axis) -> f64 {
    let steps = scope.gate().rules().largest_steps.iter();
    let own = steps.filter(|l| l.axis == axis).map(|l| 0.999 * l.step);
    own.fold(f64::INFINITY, f64::min)
}

fn height(z_um: f64) -> StagePose {
    StagePose::default().with_si(Axis::Z, Length::from_um(z_um).m())
}

fn z_um(scope: &Instrument) -> Result<f64, ServoError> {
    let z = scope.gate().position()?.z;
    Ok(z.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?.um())
}

/// To a height, where the stage is not that far from the specimen yet.
fn retreat(scope: &Instrument, far_um: f64) -> Result<(), ServoError> {
    let side = scope.gate().info().positive_z;
    if side.nearer_by(z_um(scope)?, far_um) > 0.0 {
        scope.move_to(&height(far_um))?;
    }
    Ok(())
}

/// To a height nearer to the specimen, in steps that are allowed.
fn approach(scope: &Instrument, to_um: f64) -> Result<(), ServoError> {
    scope.move_in_steps(&height(to_um))?;
    Ok(())
}

/// Back to where the stage stood, the axes that tip one after the other, each behind a retreat by the longest that it may bring anything nearer.
/// `tipped`: what is known of each. `z_um`: where it was last in focus.
pub(super) fn tip_back(
    scope: &Instrument,
    tipped: &[(Axis, Lever, Bounds)],
    start: &StagePose,
    focus_um: f64,
) -> Result<(), ServoError> {
    let side = scope.gate().info().positive_z;
    let mut focus_um = focus_um;
    for &(axis, lever, bounds) in tipped {
        let goal = start.si(axis).unwrap_or(f64::NAN);
        let most = largest_step(scope, axis);
        loop {
            let here = scope.gate().position()?;
            let left = goal - here.si(axis).unwrap_or(f64::NAN);
            // What is no number is never far.
            if left.is_nan() || left.abs() < 1e-9 {
                break;
            }
            let mut by = left.clamp(-most, most);
            let goals = scope.gate().goals()?;
            let mut far_um;
            let mut halvings = 0;
            loop {
                // The focus may lie where the last turn was not followed by a look.
                let surprise_um = lever.unsure_um(&bounds, lever.longest_rad(&bounds));
                let by_um = lever.nearer_um(&bounds, by) + surprise_um + clearance_um(scope);
                far_um = side.away(focus_um, by_um);
                if goals.allow(&height(far_um)) || halvings == HALVED {
                    break;
                }
                by *= 0.5;
                halvings += 1;
            }
            retreat(scope, far_um)?;
            let to = here.si(axis).unwrap_or(f64::NAN) + by;
            let to = if by == left { goal } else { to };
            scope.move_to(&StagePose::default().with_si(axis, to))?;
            focus_um += 1e6 * lever.m() * by;
            if by == left {
                break;
            }
        }
    }
    let Some(z) = start.z else { return Ok(()) };
    if side.nearer_by(z.um(), z_um(scope)?) > 0.0 {
        let near_um = side.away(z.um(), clearance_um(scope));
        approach(scope, near_um)?;
    }
    Ok(scope.return_to_height(z)?)
}
