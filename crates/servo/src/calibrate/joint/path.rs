//! Where a joint calibration looks next.
//!
//! - The reference, with all play taken up; two steps to a corner, which surely overlap; and back to the reference from the other side,
//!   which shows the backlash.
//! - A cross: four arms along the stage's axes, in steps as long as the map lets two views overlap, all reached from one side.
//! - Rotations about the view's centre. What the rotation centre is uncertain by moves the view, so the next one turns as much farther as
//!   that allows, until the widest.
//! - Rotations back and forth about the ends of the cross, each angle reached from both sides: a view there tells of the map and the
//!   rotation centre at once. They end when both are known well enough.

use super::fit::JointFit;
use super::model::View;
use super::play::{Arrival, arrive};
use super::sight::{shown, sight};
use crate::kinematics::{Motion2, PlanarPose, pose_after};
use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_scope::Kinematics;
use serde::{Deserialize, Serialize};

/// Settings of a path.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PathOptions {
    /// Views at most.
    pub most_views: usize,
    /// Length of an arm of the cross, m.
    pub reach_m: f64,
    /// Widest rotation to either side, rad.
    pub widest_rad: f64,
    /// Length of the first steps, as a share of the shorter side of the field.
    pub first_share: f64,
    /// Two views on an arm have so much of the field in common, at least.
    pub least_overlap: f64,
    /// A rotation may miss the view's centre by so much of the shorter side of the field, by three standard deviations.
    pub miss_share: f64,
    /// Standard deviation of the map, relative, that is enough.
    pub enough_map: f64,
    /// Standard deviation of the rotation centre that is enough, m.
    pub enough_centre_m: f64,
    /// Play of x, y (m) and rotation (rad) at most: an axis that turns back by less makes a run-up.
    pub most_play: [f64; 3],
}

impl Default for PathOptions {
    fn default() -> Self {
        Self {
            most_views: 40,
            reach_m: 0.8e-3,
            widest_rad: 6f64.to_radians(),
            first_share: 0.35,
            least_overlap: 0.4,
            miss_share: 0.25,
            enough_map: 1.5e-4,
            enough_centre_m: 3e-6,
            most_play: [30e-6, 30e-6, 1e-4],
        }
    }
}

/// What a view is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Where the calibration began.
    Reference,
    /// One of two corners of a square, its side halved a few times.
    Corner {
        /// 0 or 1.
        index: u8,
        /// How often the side was halved.
        halvings: u8,
    },
    /// The reference from the other side.
    Return,
    /// Along an axis: +x, -x, +y, -y.
    Arm {
        /// Index of the direction.
        direction: u8,
    },
    /// A rotation to one side, wider than all before.
    Widen {
        /// Tries since the last view that was found.
        tries: u8,
    },
    /// A rotation back and forth about an end of the cross.
    Sweep {
        /// How many were made before.
        index: u8,
    },
}

/// A view that was taken.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Taken {
    /// What it was for.
    pub role: Role,
    /// Where it was.
    pub view: View,
    /// Whether it was registered to another view.
    pub found: bool,
}

/// What is known when the next view is chosen.
#[derive(Clone, Copy)]
pub struct Known<'a> {
    /// How the axes are stacked.
    pub kinematics: Kinematics,
    /// Whether there is an axis of rotation.
    pub turns: bool,
    /// Columns and rows of an image.
    pub image_size_px: [usize; 2],
    /// What is engraved says so many m for a pixel.
    pub nominal_m_per_px: f64,
    /// Where the stage stands, before the first view.
    pub start: PlanarPose,
    /// All views so far, with one optics.
    pub taken: &'a [Taken],
    /// What they say, as soon as they say something.
    pub fit: Option<&'a JointFit>,
}

/// The next view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Next {
    /// What it is for.
    pub role: Role,
    /// The pose to go through first, where play must be taken up.
    pub via: Option<PlanarPose>,
    /// Where to look.
    pub pose: PlanarPose,
    /// From which side each axis arrives.
    pub approach: [i8; 3],
}

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
const TURNED_VIEWS: usize = 12;
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
    let path = Path {
        options,
        known,
        allowed,
    };
    if known.taken.len() >= options.most_views {
        return None;
    }
    let (role, pose) = path.after(known.taken.last())?;
    let from = known
        .taken
        .last()
        .map(|t| (&t.view.reported, t.view.approach));
    let same_side = matches!(role, Role::Arm { .. });
    let Arrival { via, approach } = arrive(from, &pose, path.play(), same_side, allowed)?;
    Some(Next {
        role,
        via,
        pose,
        approach,
    })
}

/// The views so far that one at `pose` is registered to: the nearest of those that overlap.
pub fn partners(options: &PathOptions, known: &Known, pose: &PlanarPose) -> Vec<usize> {
    let path = Path {
        options,
        known,
        allowed: &|_| true,
    };
    let found = known.taken.iter().enumerate().filter(|(_, t)| t.found);
    let mut overlaps: Vec<(f64, usize)> = found
        .map(|(k, t)| (path.overlap(&t.view.reported, pose), k))
        .filter(|(overlap, _)| *overlap >= 0.9 * options.least_overlap)
        .collect();
    // The earlier of two that overlap as much: it ties the path to its beginning.
    overlaps.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    overlaps.iter().take(PARTNERS).map(|(_, k)| *k).collect()
}

struct Path<'a> {
    options: &'a PathOptions,
    known: &'a Known<'a>,
    allowed: &'a dyn Fn(&PlanarPose) -> bool,
}

impl Path<'_> {
    fn reference(&self) -> PlanarPose {
        let first = self.known.taken.first();
        first.map_or(self.known.start, |t| t.view.reported)
    }

    fn play(&self) -> [f64; 3] {
        let [x, y, turn] = self.options.most_play;
        [x, y, if self.known.turns { turn } else { 0.0 }]
    }

    /// The shorter side of the field, m.
    fn field_m(&self) -> f64 {
        let [columns, rows] = self.known.image_size_px;
        columns.min(rows) as f64 * self.known.nominal_m_per_px
    }

    fn after(&self, last: Option<&Taken>) -> Option<(Role, PlanarPose)> {
        let Some(last) = last else {
            return Some((Role::Reference, self.known.start));
        };
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
                None
            };
        };
        let role = Role::Arm {
            direction: direction as u8,
        };
        let reference = self.reference();
        let made = self
            .known
            .taken
            .iter()
            .filter(|t| t.role == role && t.found);
        let gone_m = made.clone().last().map_or(0.0, |t| {
            (0..2)
                .map(|k| (t.view.reported.x_m[k] - reference.x_m[k]) * arm[k])
                .sum()
        });
        let most = self
            .options
            .most_views
            .saturating_sub(FIRST_VIEWS + TURNED_VIEWS)
            / ARMS.len();
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

    /// The longest step in a direction that leaves enough overlap for sure, m. `None` before the map is known.
    fn longest_step_m(&self, direction: Vec2) -> Option<f64> {
        let fit = self.known.fit?;
        let optics = fit.instrument.optics.first()?;
        let doubt = 1.0 + 3.0 * self.map_sigma(fit)?;
        let turn = match self.known.kinematics {
            Kinematics::MovesMicroscope | Kinematics::SpecimenXyOnTop => {
                Mat2::rotation(-self.reference().theta_rad)
            }
            Kinematics::SpecimenRotationOnTop => Mat2::IDENTITY,
        };
        let px = optics.stage_from_pixel.inverse()? * turn * direction;
        let [a, b] = [0, 1].map(|k| doubt * px[k].abs() / self.known.image_size_px[k] as f64);
        // (1 - a L) (1 - b L) = least overlap, solved for L.
        let (sum, lost) = (a + b, 1.0 - self.options.least_overlap);
        Some(2.0 * lost / (sum + (sum * sum - 4.0 * a * b * lost).sqrt()))
    }

    /// The share of the field that views at two poses have in common.
    fn overlap(&self, a: &PlanarPose, b: &PlanarPose) -> f64 {
        let size_px = self.known.image_size_px.map(|n| n as f64);
        let optics = self.known.fit.and_then(|fit| fit.instrument.optics.first());
        let shift_px = match optics {
            Some(optics) => {
                let sights = [a, b].map(|p| sight(self.known.kinematics, p, optics.centre_m));
                shown(&sights, &[optics, optics]).map(|[x, y, _]| [x, y])
            }
            None => {
                let way_px = f64::hypot(a.x_m[0] - b.x_m[0], a.x_m[1] - b.x_m[1])
                    / self.known.nominal_m_per_px;
                Some([way_px * std::f64::consts::FRAC_1_SQRT_2; 2])
            }
        };
        shift_px.map_or(0.0, |shift_px| {
            let left = [0, 1].map(|k| (1.0 - shift_px[k].abs() / size_px[k]).max(0.0));
            left[0] * left[1]
        })
    }

    /// The pose that turns by `turn_rad` about the view's centre at a pose.
    fn turned(&self, fit: &JointFit, about: &PlanarPose, turn_rad: f64) -> Option<PlanarPose> {
        let eta = fit.instrument.optics.first()?.centre_m;
        let alpha_rad = match self.known.kinematics {
            Kinematics::MovesMicroscope => turn_rad,
            Kinematics::SpecimenRotationOnTop | Kinematics::SpecimenXyOnTop => -turn_rad,
        };
        let turned = Mat2::rotation(alpha_rad) * eta;
        let motion = Motion2 {
            alpha_rad,
            d_m: [eta[0] - turned[0], eta[1] - turned[1]],
        };
        Some(pose_after(self.known.kinematics, about, &motion))
    }

    /// The widest rotation about a view to one side (1 or -1) that is allowed, rad.
    fn widest_rad(&self, fit: &JointFit, about: &PlanarPose, side: f64) -> f64 {
        let shares = (0..20).map(|k| 1.0 - 0.05 * f64::from(k));
        shares
            .map(|share| share * self.options.widest_rad)
            .find(|angle| {
                self.turned(fit, about, side * angle)
                    .is_some_and(|p| (self.allowed)(&p))
            })
            .unwrap_or(0.0)
    }

    /// The standard deviation of the map, relative.
    fn map_sigma(&self, fit: &JointFit) -> Option<f64> {
        let optics = fit.instrument.optics.first()?;
        let variance: f64 = (0..4).map(|k| fit.optics_covariance(0)[k][k]).sum();
        Some(variance.sqrt() / optics.stage_from_pixel.frobenius())
    }

    /// The standard deviation of the rotation centre where it is greatest, m.
    fn lever_sigma_m(&self, fit: &JointFit) -> f64 {
        let c = fit.optics_covariance(0);
        let covariance = Mat2([[c[4][4], c[4][5]], [c[5][4], c[5][5]]]);
        covariance.svd().s[0].sqrt()
    }

    /// A rotation wider than those before by what the rotation centre allows.
    fn widen(&self, tries: u8) -> Option<(Role, PlanarPose)> {
        let fit = self.known.fit?;
        let turns = self.known.taken.iter().filter(|t| t.found);
        let reached_rad = turns
            .map(|t| t.view.reported.theta_rad - self.reference().theta_rad)
            .fold(0.0, f64::max);
        let widest_rad = self.widest_rad(fit, &self.reference(), 1.0);
        if tries > RETRIES || reached_rad >= 0.999 * widest_rad {
            return self.sweep(0);
        }
        let miss_m = self.options.miss_share * self.field_m() / f64::from(1u32 << (2 * tries));
        let on_rad = miss_m / (3.0 * self.lever_sigma_m(fit));
        let turn_rad = (reached_rad + on_rad).min(widest_rad);
        let pose = self
            .turned(fit, &self.reference(), turn_rad)
            .filter(|p| (self.allowed)(p))?;
        Some((Role::Widen { tries }, pose))
    }

    /// Where the last view of an arm is, or the reference where it has none.
    fn end_of(&self, direction: usize) -> PlanarPose {
        let along = |t: &&Taken| {
            t.found && matches!(t.role, Role::Arm { direction: d } if usize::from(d) == direction)
        };
        let last = self.known.taken.iter().rev().find(along);
        last.map_or(self.reference(), |t| t.view.reported)
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
            true => share * self.widest_rad(fit, &about, share.signum()),
            false => 0.0,
        };
        let pose = self
            .turned(fit, &about, turn_rad)
            .filter(|p| (self.allowed)(p))?;
        Some((Role::Sweep { index: index as u8 }, pose))
    }
}
