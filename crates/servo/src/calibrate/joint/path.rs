//! Where a joint calibration looks next.
//!
//! - The reference, with all play taken up; two steps to a corner, which surely overlap; and back to the reference from the other side,
//!   which shows the backlash.
//! - A cross: four arms along the stage's axes, in steps as long as the map lets two views overlap, all reached from one side.
//! - Rotations about the view's centre. What the rotation centre is uncertain by moves the view, so the next one turns as much farther as
//!   that allows, until the widest.
//! - Rotations back and forth about the ends of the cross, each angle reached from both sides: a view there tells of the map and the
//!   rotation centre at once. They end when both are known well enough.
//! - The reference again: an axis that stopped on the way, lost steps or a slide that slipped may look like another rotation centre, but not
//!   here.

use super::fit::JointFit;
use super::plan::{Known, Next, PathOptions, Role, Taken};
use super::play::{Arrival, arrive, settled};
use super::prospect::Prospect;
use crate::kinematics::PlanarPose;
use scopeservo_geometry::Vec2;

/// The directions of the cross.
const ARMS: [Vec2; 4] = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
/// Rotations back and forth, as shares of the widest, each about the end of an arm.
const SWEEP: [(f64, usize); 8] = [
    (0.5, 0),
    (0.0, 1),
    (-0.5, 2),
    (-1.0, 1),
    (-0.5, 0),
    (0.0, 3),
    (0.5, 1),
    (1.0, 0),
];
/// Views for the reference, the corners and the return.
const FIRST_VIEWS: usize = 4;
/// Views for rotations and at the ends of the cross.
const TURNED_VIEWS: usize = 11;
/// The view that ends the path.
const LAST_VIEWS: usize = 1;
/// Rotations wider and wider, at most: five are usual, and a centre that does not become known is not there.
const MOST_WIDER: usize = 8;
/// Rotations become wider to the other side where this one has less than this share of its room.
const LITTLE_ROOM: f64 = 0.5;
/// So often a step is made shorter when its view is not found.
const RETRIES: u8 = 3;
/// A view is registered to so many others at most.
const PARTNERS: usize = 4;

/// The next view, or `None` when the path is at its end: complete, at the most views, or lost. `allowed` says where the stage may be.
pub fn next_view(
    options: &PathOptions,
    known: &Known,
    allowed: &dyn Fn(&PlanarPose) -> bool,
) -> Option<Next> {
    let path = Prospect {
        options,
        known,
        allowed,
    };
    let (role, pose) = path.after(known.taken.last())?;
    // Home is reached as the reference was.
    let last = known.taken.last().filter(|_| role != Role::Home);
    let from = last.map(|t| (&t.asked, t.view.approach));
    let pose = from.map_or(pose, |(from, _)| settled(from, &pose));
    let same_side = matches!(role, Role::Arm { .. });
    let Arrival {
        via,
        approach,
        moved,
    } = arrive(from, &pose, path.play(), same_side, allowed)?;
    Some(Next {
        role,
        via,
        pose,
        approach,
        arrived: moved,
    })
}

/// The views so far that one at `pose` is registered to: the nearest of those that overlap.
pub fn partners(options: &PathOptions, known: &Known, pose: &PlanarPose) -> Vec<usize> {
    let path = Prospect {
        options,
        known,
        allowed: &|_| true,
    };
    let found = known.taken.iter().enumerate().filter(|(_, t)| t.found);
    let mut overlaps: Vec<(f64, usize)> = found
        .map(|(k, t)| (path.overlap(&t.asked, pose), k))
        .filter(|(overlap, _)| *overlap >= 0.9 * options.least_overlap)
        .collect();
    // The earlier of two that overlap as much: it ties the path to its beginning.
    overlaps.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    overlaps.iter().take(PARTNERS).map(|(_, k)| *k).collect()
}

impl Prospect<'_> {
    fn after(&self, last: Option<&Taken>) -> Option<(Role, PlanarPose)> {
        let Some(last) = last else {
            return Some((Role::Reference, self.known.start));
        };
        let room = self.known.taken.len() + LAST_VIEWS < self.options.most_views;
        let onward = || self.onward(last);
        let home = Some((Role::Home, self.reference()));
        match last.role {
            Role::Home => None,
            // Lost at its beginning, it has nothing to end.
            Role::Reference | Role::Corner { .. } => onward(),
            _ => room.then(onward).flatten().or(home),
        }
    }

    fn onward(&self, last: &Taken) -> Option<(Role, PlanarPose)> {
        match last.role {
            Role::Reference => self.corner(0, 0),
            Role::Corner { halvings, .. } if !last.found => {
                (halvings < RETRIES).then(|| self.corner(0, halvings + 1))?
            }
            Role::Corner { index: 0, halvings } => self.corner(1, halvings),
            Role::Corner { .. } => Some((Role::Return, self.reference())),
            Role::Return => self.arm(0),
            Role::Arm { direction } => self.arm(usize::from(direction) + usize::from(!last.found)),
            Role::Widen { tries } => self.widen(if last.found { 0 } else { tries + 1 }),
            Role::Sweep { index } => self.sweep(usize::from(index) + 1),
            Role::Home => None,
        }
    }

    /// The corners (1, 0) and (1, 1) of a square that lies to the side where the stage may go.
    fn corner(&self, index: u8, halvings: u8) -> Option<(Role, PlanarPose)> {
        let side_m = self.options.first_share * self.field_m() / f64::from(1u32 << halvings);
        let at = |sign: Vec2, index: u8| {
            let mut pose = self.reference();
            pose.x_m[0] += sign[0] * side_m;
            pose.x_m[1] += sign[1] * side_m * f64::from(index);
            pose
        };
        let signs = [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]];
        let sign = signs
            .into_iter()
            .find(|sign| (self.allowed)(&at(*sign, 0)) && (self.allowed)(&at(*sign, 1)))?;
        Some((Role::Corner { index, halvings }, at(sign, index)))
    }

    /// One step on along this arm, or the first of the next.
    fn arm(&self, direction: usize) -> Option<(Role, PlanarPose)> {
        let Some(arm) = ARMS.get(direction) else {
            return if self.known.turns {
                self.widen(0)
            } else {
                self.sweep(0)
            };
        };
        let role = Role::Arm {
            direction: direction as u8,
        };
        let reference = self.reference();
        let taken = self.known.taken.iter();
        let made = taken.filter(|t| t.role == role && t.found);
        let gone_m = made.clone().next_back().map_or(0.0, |t| {
            (0..2)
                .map(|k| (t.asked.x_m[k] - reference.x_m[k]) * arm[k])
                .sum()
        });
        let others = FIRST_VIEWS + TURNED_VIEWS + LAST_VIEWS;
        let most = self.options.most_views.saturating_sub(others) / ARMS.len();
        let rest_m = self.options.reach_m - gone_m;
        if made.count() >= most || rest_m < 0.1 * self.options.reach_m {
            return self.arm(direction + 1);
        }
        let steps = (rest_m / self.longest_step_m(*arm)? - 1e-9).ceil().max(1.0);
        let at = |share: f64| PlanarPose {
            x_m: [0, 1].map(|k| reference.x_m[k] + arm[k] * (gone_m + share * rest_m / steps)),
            ..reference
        };
        match [1.0, 0.75, 0.5].map(at).into_iter().find(self.allowed) {
            Some(pose) => Some((role, pose)),
            None => self.arm(direction + 1),
        }
    }

    /// The widest rotation that was found, to either side, rad.
    fn reached_rad(&self) -> f64 {
        let found = self.known.taken.iter().filter(|t| t.found);
        found
            .map(|t| (t.asked.theta_rad - self.reference().theta_rad).abs())
            .fold(0.0, f64::max)
    }

    /// The side to which rotations become wider, 1 or -1, and how wide they may, rad: the other side where the limits leave little room on this one.
    fn wider_side(&self, fit: &JointFit) -> (f64, f64) {
        let [one, other] =
            [1.0, -1.0].map(|side| (side, self.widest_rad(fit, &self.reference(), side)));
        match one.1 < LITTLE_ROOM * other.1 {
            true => other,
            false => one,
        }
    }

    /// A rotation wider than those before by what the rotation centre allows.
    fn widen(&self, tries: u8) -> Option<(Role, PlanarPose)> {
        let fit = self.known.fit?;
        let reached_rad = self.reached_rad();
        let wider = |t: &&Taken| matches!(t.role, Role::Widen { .. });
        let made = self.known.taken.iter().filter(wider).count();
        let (side, widest_rad) = match made {
            // A centre that no view has shown yet says nothing of the room there is; the first one turns very little.
            0 => (1.0, self.options.widest_rad),
            _ => self.wider_side(fit),
        };
        if tries > RETRIES || made >= MOST_WIDER || reached_rad >= 0.999 * widest_rad {
            return self.sweep(0);
        }
        let miss_m = self.miss_m() / f64::from(1u32 << (2 * tries));
        let on_rad = miss_m / (3.0 * self.lever_sigma_m(fit));
        let turn_rad = side * (reached_rad + on_rad).min(widest_rad);
        let pose = self.turned(fit, &self.reference(), turn_rad)?;
        Some((Role::Widen { tries }, self.near(&pose)?))
    }

    /// Where the last view of an arm is, or the reference where it has none.
    fn end_of(&self, direction: usize) -> PlanarPose {
        let along = |t: &&Taken| {
            t.found && matches!(t.role, Role::Arm { direction: d } if usize::from(d) == direction)
        };
        let last = self.known.taken.iter().rev().find(along);
        last.map_or(self.reference(), |t| t.asked)
    }

    /// One of the rotations back and forth, which begin anew until all is known well enough.
    fn sweep(&self, index: usize) -> Option<(Role, PlanarPose)> {
        let fit = self.known.fit?;
        let centre_known =
            !self.known.turns || self.lever_sigma_m(fit) <= self.options.enough_centre_m;
        if index >= SWEEP.len() && centre_known && self.map_sigma(fit)? <= self.options.enough_map {
            return None;
        }
        let (share, direction) = SWEEP[index % SWEEP.len()];
        let about = self.end_of(direction);
        let turn_rad = match self.known.turns {
            true => {
                let widest_rad = self.widest_rad(fit, &about, share.signum());
                share * widest_rad.min(self.reached_rad())
            }
            false => 0.0,
        };
        let pose = self.turned(fit, &about, turn_rad)?;
        Some((Role::Sweep { index: index as u8 }, self.near(&pose)?))
    }
}
