//! Proof by motion: at the target's own magnification arrival is claimed only on places that were seen to move with the specimen, and
//! only when no other transform explains them as well.
//!
//! A run's own moves prove it in passing. Whoever begins at the goal has made none: then a step aside is owed.

mod aside;
mod drift;
mod fixed;
mod pattern;

use crate::Measurement;
use crate::hand_eye::{explained_px, predicted_b};
use crate::{Calibration, PlanarPose};
use scopeservo_geometry::{Affine2, Correspondence, Vec2};
use scopeservo_registration::{Estimate, Options, Prior, Registration, register_correspondences};
use scopeservo_scope::Kinematics;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeSet, HashMap};

pub(crate) use aside::{Aside, SEEN_PX, Seen, step_aside};
pub(crate) use drift::Drift;
pub use fixed::FixedPlaces;
pub(crate) use fixed::{LEAST_PX, Parallax, Place, stays};
pub(crate) use pattern::look_around;

/// So many frames from elsewhere are kept: the latest.
const WITNESSES: usize = 3;
/// A target that was saved without moving may be text, which shifts by a letter as digits come, and at times as the stage went: then the
/// view must be seen to follow from so many frames.
const FOLLOWED_FROM: usize = 2;
/// So many frames that are bent by what is fixed to the camera are looked at again.
const BENT: u8 = 3;
/// Steps aside in one leg, at most.
const ASIDES: u8 = 2;
/// The transform of the places that moved must agree with the one of all places within so many sigmas,
const AGREE_SIGMAS: f64 = 3.0;
/// or this, in pixels of the coarser image: the noise that both share.
const AGREE_PX: f64 = 0.05;
/// A view that follows a move by less than this share does not follow.
pub(crate) const FOLLOWS: f64 = 0.25;

/// A place that lies so far from where the places that moved put it does not belong to them, pixels of the coarser image.
const BENT_PX: f64 = 1.0;

/// The view goes at most this much farther than the stage says it went,
const FARTHER: f64 = 1.05;
/// and lies off its way by this share of it, for the calibration and the optics,
const OFF_WAY: f64 = 0.1;
/// and a pixel, and so many standard deviations of what the stage scatters and of the rotation centre.
const WAY_SIGMAS: f64 = 3.0;

/// What the places that moved with the specimen prove.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Proved {
    /// A transform, and that is the one to believe.
    Moved(Box<Estimate>),
    /// Another transform than all places: some are fixed to the camera, and are left out from now on.
    Bent,
    /// Nothing: too few moved.
    Nothing,
}

/// A frame of the target's own leg from elsewhere: where in the view each place of the target was.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Witness {
    /// Where the stage said it was.
    pose: PlanarPose,
    target_from_view: Affine2,
    /// x, y in the view, x, y in the target.
    #[serde(with = "crate::compact::numbers")]
    places: Vec<[f32; 4]>,
}

/// Where the stage says that a frame was taken, and what that means in pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Station<'a> {
    pub(crate) pose: PlanarPose,
    pub(crate) calibration: &'a Calibration,
    pub(crate) kinematics: Kinematics,
    /// What the stage scatters: m, m, rad.
    pub(crate) pose_sigma: [f64; 3],
    /// Whether the target was saved without moving.
    pub(crate) still: bool,
}

impl Station<'_> {
    /// Whether a view moved as the stage says that it went from `before`, as far as backlash, scatter and the calibration let it: `seen_px` is
    /// where this view's centre lay in the one from there, from its centre. Play may leave `least` of the way.
    pub(crate) fn follows(&self, before: &PlanarPose, seen_px: Vec2, least: f64) -> bool {
        let Some(pixel_from_stage) = self.calibration.pixel_from_stage() else {
            return false;
        };
        let eta = self.calibration.rotation_centre_m.unwrap_or([0.0; 2]);
        let told = predicted_b(self.kinematics, before, &self.pose, pixel_from_stage, eta);
        let told_px = f64::hypot(told[0], told[1]);
        let along = (seen_px[0] * told[0] + seen_px[1] * told[1]) / (told_px * told_px).max(1e-9);
        let share = along.clamp(least, FARTHER);
        let off = f64::hypot(seen_px[0] - share * told[0], seen_px[1] - share * told[1]);
        let scatter_px = explained_px(before, self.calibration, self.kinematics, self.pose_sigma);
        let turn = (self.pose.theta_rad - before.theta_rad).abs();
        let centre_m = self
            .calibration
            .covariance
            .map_or(0.0, |c| c[4][4].max(c[5][5]).sqrt());
        let centre_px = turn * centre_m * 1e6 / self.calibration.um_per_px();
        let sigma_px = f64::hypot(std::f64::consts::SQRT_2 * scatter_px, centre_px);
        off <= 1.0 + WAY_SIGMAS * sigma_px + OFF_WAY * told_px
    }
}

/// What the frames of a leg have shown so far.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Proof {
    witnesses: Vec<Witness>,
    /// What is known to be fixed to the camera.
    pub(crate) fixed: FixedPlaces,
    asides: u8,
    /// Frames whose transform was bent by what is fixed to the camera.
    #[serde(default)]
    bent: u8,
    /// Whether nothing else explains the view as well.
    pub(crate) unique: bool,
    /// Whether a step aside, and another one on, were seen to be followed.
    #[serde(default)]
    pub(crate) followed: bool,
    /// The error before the last move and the length of that move, um.
    asked: Option<(Vec2, f64)>,
}

impl Proof {
    /// Whether a step aside may still be made.
    pub(crate) fn may_step_aside(&self) -> bool {
        self.asides < ASIDES
    }

    /// Counts a frame that was bent; whether there were several.
    pub(crate) fn bends_too_often(&mut self) -> bool {
        self.bent = self.bent.saturating_add(1);
        self.bent > BENT
    }

    /// What was seen so far may have been seen of the dust.
    pub(crate) fn begin_anew(&mut self) {
        self.witnesses.clear();
        (self.unique, self.asked) = (false, None);
    }

    /// Counts one; `false` when none is left.
    pub(crate) fn spend_step_aside(&mut self) -> bool {
        let may = self.may_step_aside();
        self.asides += u8::from(may);
        // What led here has proved nothing.
        self.witnesses.clear();
        may
    }

    /// What was asked of the last step aside is asked of another one.
    pub(crate) fn asks_again(&mut self) {
        self.asides = self.asides.saturating_sub(1);
        self.witnesses.clear();
    }

    /// Keeps a frame that was taken far enough from the goal.
    pub(crate) fn witness(
        &mut self,
        target_from_view: &Affine2,
        registration: &Registration,
        (centre, target_centre): (Vec2, Vec2),
        pose: PlanarPose,
    ) {
        if far_from_goal(target_from_view, centre, target_centre) {
            self.witnesses.push(Witness {
                pose,
                target_from_view: *target_from_view,
                places: registration.pairs.clone(),
            });
            let extra = self.witnesses.len().saturating_sub(WITNESSES);
            self.witnesses.drain(..extra);
        }
    }

    /// From how many of the frames that are kept the view followed the stage; `None` when it did not from one of them.
    fn followed_from(
        &self,
        target_from_view: &Affine2,
        centre: Vec2,
        here: &Station<'_>,
    ) -> Option<usize> {
        let lay = target_from_view.apply(centre);
        let all = self.witnesses.iter().all(|w| {
            let there = w.target_from_view.inverse().map(|t| t.apply(lay));
            let way = there.map(|p| [p[0] - centre[0], p[1] - centre[1]]);
            way.is_some_and(|way| here.follows(&w.pose, way, FOLLOWS))
        });
        all.then_some(self.witnesses.len())
    }

    /// What the inliers that moved say, without the others.
    pub(crate) fn judge(
        &mut self,
        measured: &Measurement,
        prior: &Prior,
        options: &Options,
        here: &Station<'_>,
    ) -> Proved {
        let (estimate, all) = (&measured.estimate, &measured.correspondences);
        let [width, height] = all.view_size;
        let centre = crate::vision::centre_px(width, height);
        let needed = if here.still && !self.followed {
            FOLLOWED_FROM
        } else {
            1
        };
        let followed = self.followed_from(&estimate.target_from_view, centre, here);
        if followed.is_none_or(|n| n < needed) {
            return Proved::Nothing;
        }
        let seen_at = self.places_seen();
        let moved = |c: &Correspondence| {
            let ([vx, vy], [tx, ty]) = (c.p_in_a.map(|v| v as f32), c.p_in_b.map(|v| v as f32));
            let before = seen_at.get(&key(tx, ty));
            before.is_some_and(|all| {
                all.iter()
                    .any(|p| f64::from(f32::hypot(vx - p[0], vy - p[1])) > LEAST_PX)
            })
        };
        // What agrees with the transform, twins of a place included, must have been seen elsewhere; the rest may say what it likes.
        let coarse_px = estimate.target_from_view.linear.det().abs().sqrt().max(1.0);
        let agrees = |c: &Correspondence| {
            let q = estimate.target_from_view.apply(c.p_in_a);
            f64::hypot(q[0] - c.p_in_b[0], q[1] - c.p_in_b[1])
                <= 2.0 * options.threshold_px * coarse_px
        };
        let counting = all.those(|_, c| !agrees(c) || moved(c));
        let again = register_correspondences(&counting, prior, options);
        let Some(found) = again.found() else {
            return Proved::Nothing;
        };
        let off = |p: Vec2, q: Vec2| f64::hypot(p[0] - q[0], p[1] - q[1]);
        let apart = off(
            estimate.target_from_view.apply(centre),
            found.target_from_view.apply(centre),
        );
        let allowed =
            AGREE_SIGMAS * f64::hypot(found.sigma_px, estimate.sigma_px) + AGREE_PX * coarse_px;
        if apart <= allowed {
            return Proved::Moved(Box::new(found.clone()));
        }
        // What bent the transform lies elsewhere by the places that moved: it is fixed to the camera.
        let agreeing: BTreeSet<[usize; 2]> =
            measured.registration.agreeing.iter().copied().collect();
        let bends = |i: &usize| {
            let c = &all.pairs[*i];
            agreeing.contains(&all.indices[*i])
                && !moved(c)
                && off(found.target_from_view.apply(c.p_in_a), c.p_in_b) > BENT_PX * coarse_px
        };
        let bent: Vec<usize> = (0..all.len()).filter(bends).collect();
        if bent.is_empty() {
            return Proved::Moved(Box::new(found.clone()));
        }
        let keypoints = bent
            .iter()
            .map(|&i| (all.pairs[i].p_in_a, all.shapes[i][0]));
        self.fixed.add_keypoints(all.view_size, keypoints);
        Proved::Bent
    }

    /// Where in the views of the witnesses each place of the target was.
    fn places_seen(&self) -> HashMap<(u32, u32), Vec<[f32; 2]>> {
        let mut seen = HashMap::<_, Vec<[f32; 2]>>::new();
        for [vx, vy, tx, ty] in self.witnesses.iter().flat_map(|w| &w.places) {
            seen.entry(key(*tx, *ty)).or_default().push([*vx, *vy]);
        }
        seen
    }

    /// A move of `way_um` begins where the error is `error_um`.
    pub(crate) fn moving(&mut self, error_um: Vec2, way_um: f64) {
        self.asked = Some((error_um, way_um));
    }

    /// Whether the view did not follow the last move, though it was long enough to see.
    pub(crate) fn does_not_follow(&mut self, error_um: Vec2, um_per_px: f64) -> bool {
        let Some((before, way_um)) = self.asked.take() else {
            return false;
        };
        let went = f64::hypot(error_um[0] - before[0], error_um[1] - before[1]);
        way_um >= SEEN_PX * um_per_px && went < FOLLOWS * way_um
    }
}

/// Places are told apart by their coordinates, bit for bit: they come from one stored target.
fn key(x: f32, y: f32) -> (u32, u32) {
    (x.to_bits(), y.to_bits())
}

/// Whether what is fixed to the camera would be seen to disagree: the view's centre lies far from the target's.
pub(crate) fn far_from_goal(target_from_view: &Affine2, centre: Vec2, target_centre: Vec2) -> bool {
    let q = target_from_view.apply(centre);
    // In pixels of the finer image: a step aside is so long in those of the view.
    let seen_px = SEEN_PX * target_from_view.linear.det().abs().sqrt().min(1.0);
    f64::hypot(q[0] - target_centre[0], q[1] - target_centre[1]) >= seen_px
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A step aside is so many pixels of the view, which are fewer of a target of coarser ones.
    #[test]
    fn a_step_aside_is_far_from_the_goal_whichever_of_the_two_has_the_finer_pixels() {
        for scale in [0.3, 0.5, 1.0, 2.0, 4.0] {
            let aside = |view_px: f64| Affine2 {
                linear: scopeservo_geometry::Mat2::diagonal(scale, scale),
                offset: [scale * view_px, 0.0],
            };
            let far = |view_px| far_from_goal(&aside(view_px), [0.0; 2], [0.0; 2]);
            assert!(far(16.0), "{scale}");
            assert!(!far(2.0), "{scale}");
        }
    }

    #[test]
    fn a_view_that_stays_when_the_stage_moves_does_not_follow() {
        let mut proof = Proof::default();
        assert!(!proof.does_not_follow([0.0, 0.0], 0.5), "nothing was asked");
        proof.moving([30.0, 0.0], 8.0);
        assert!(proof.does_not_follow([29.5, 0.0], 0.5));
        proof.moving([30.0, 0.0], 8.0);
        assert!(!proof.does_not_follow([22.0, 0.0], 0.5));
        proof.moving([30.0, 0.0], 2.0);
        assert!(
            !proof.does_not_follow([30.0, 0.0], 0.5),
            "too short to be seen"
        );
    }
}
