//! What a move was to do, against what the next frame shows of it.

use crate::law::error_after;
use crate::{Calibration, Contradiction, PlanarPose, PoseError, PoseEstimate, motion_between};
use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_scope::{Axis, Kinematics};
use serde::{Deserialize, Serialize};

/// What lies within so many standard deviations and a pixel of the view is what was promised; angles within so much, rad.
const SIGMAS: f64 = 4.0;
const SLACK_RAD: f64 = 3e-3;
/// A stage whose play the calibration does not know may have as much, standard deviation, m.
const UNKNOWN_PLAY_M: f64 = 8e-6;
/// The errors of a calibration that a servo survives (the paper, Table II, at 100x): a share of each move for scale and camera angle, and the
/// rotation centre, m.
const DRIFTED_SHARE: f64 = 0.17;
pub(super) const DRIFTED_CENTRE_M: f64 = 9.1e-3;
/// A cause explains what was seen when it leaves this share of the move, besides what is uncertain.
const LEAVES: f64 = 0.08;

/// What is known of an instrument's moves.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Mover<'a> {
    pub(crate) kinematics: Kinematics,
    pub(crate) view: &'a Calibration,
    /// How arrivals scatter: m, m, rad.
    pub(crate) scatter: [f64; 3],
}

/// What a move was to do.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Promise {
    /// Where the stage stood, and where it was sent.
    pub(super) before: PlanarPose,
    goal: PlanarPose,
    /// The error before.
    pub(super) from: PoseError,
    /// Standard deviations of the error after it, m for each coordinate, and rad.
    pub(super) sigma_m: f64,
    sigma_rad: f64,
}

/// What the next frame is expected to show after a move.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Promised {
    /// The error after it.
    pub error: PoseError,
    /// Its standard deviation, m for each coordinate.
    pub sigma_m: f64,
    /// And that of its angle, rad.
    pub sigma_rad: f64,
}

/// How a promise was kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Kept {
    /// As well as it was known.
    Yes,
    /// As a calibration would that has drifted, and which a servo survives.
    Drifted,
    /// Not at all.
    No(Contradiction),
    /// Nothing has moved so far: images may come late.
    NotYet,
}

impl Promise {
    /// Of a move from a frame that was understood.
    pub(crate) fn of(
        seen: &PoseEstimate,
        (before, goal): (PlanarPose, PlanarPose),
        mover: &Mover<'_>,
        change_m: f64,
    ) -> Self {
        let turned_rad = goal.theta_rad - before.theta_rad;
        let [x, y, turn] = mover.scatter;
        let eta = mover.view.rotation_centre_m.unwrap_or_default();
        let lever_m = f64::hypot(eta[0], eta[1]);
        let play_m = mover.view.backlash.map_or(UNKNOWN_PLAY_M, |_| 0.0);
        let arrival_sq = x * x + y * y + (lever_m * turn).powi(2) + play_m * play_m;
        let sure = Self {
            before,
            goal,
            from: seen.error,
            sigma_m: 0.0,
            sigma_rad: 0.0,
        };
        // As far as this move goes, which may be a small part of what is off.
        let way_m = apart(&seen.error, &sure.error_at(&goal, mover)).0;
        // What a doubted calibration leaves open is no more than one that has drifted may be off.
        let drifted_m = (DRIFTED_SHARE * way_m + sweep_m(turned_rad)) / SIGMAS;
        let known_m = mover.view.move_sigma_m(way_m, turned_rad);
        let known_m = known_m.unwrap_or(0.0).min(drifted_m);
        let [a, b, angle] = seen.sigma();
        Self {
            sigma_m: (arrival_sq + known_m * known_m + a * a + b * b + change_m * change_m).sqrt(),
            sigma_rad: f64::hypot(std::f64::consts::SQRT_2 * turn, angle),
            ..sure
        }
    }

    /// Whether the move leads where the stage stands, to within `most` of each axis, m and rad.
    pub(super) fn leads_to(&self, stands: &PlanarPose, most: [f64; 3]) -> bool {
        let coordinates = |pose: &PlanarPose| [pose.x_m[0], pose.x_m[1], pose.theta_rad];
        let (goal, stands) = (coordinates(&self.goal), coordinates(stands));
        (0..3).all(|k| (stands[k] - goal[k]).abs() <= most[k])
    }

    /// What it is, for those who look on.
    pub(crate) fn told(&self, mover: &Mover<'_>) -> Promised {
        Promised {
            error: self.error_at(&self.goal, mover),
            sigma_m: self.sigma_m,
            sigma_rad: self.sigma_rad,
        }
    }

    /// The error if the stage had come to stand somewhere.
    fn error_at(&self, pose: &PlanarPose, mover: &Mover<'_>) -> PoseError {
        let motion = motion_between(mover.kinematics, &self.before, pose);
        error_after(&self.from, &motion, mover.view)
    }

    /// What the next frame says of it. `view_m`: size of its pixels.
    pub(crate) fn kept(&self, seen: &PoseEstimate, mover: &Mover<'_>, view_m: f64) -> Kept {
        // With this view's own centre: what another objective handed over lies beside that.
        let promised = self.error_at(&self.goal, mover);
        let [_, _, angle] = seen.sigma();
        let unsure_m = self.unsure_m(seen, view_m);
        let unsure_rad = SIGMAS * f64::hypot(self.sigma_rad, angle) + SLACK_RAD;
        let (off_m, off_rad) = apart(&promised, &seen.error);
        if off_m <= unsure_m && off_rad <= unsure_rad {
            return Kept::Yes;
        }
        let way_m = apart(&self.from, &promised).0;
        let turned_rad = (self.goal.theta_rad - self.before.theta_rad).abs();
        let sweep_m = sweep_m(turned_rad);
        // What stands or goes the other way explains all of it; a share of the way is what a drifted calibration makes of it, too.
        let cause = self.fits(seen, mover, view_m).simplest();
        let sure = cause.is_some_and(|cause| !cause.is_read_off());
        let cause = cause.unwrap_or(Contradiction::Elsewhere);
        if sure && DRIFTED_SHARE * self.gone_m(mover) > unsure_m {
            return Kept::No(cause);
        }
        if off_m <= unsure_m + DRIFTED_SHARE * way_m + sweep_m
            && off_rad <= unsure_rad + DRIFTED_SHARE * turned_rad
        {
            return Kept::Drifted;
        }
        Kept::No(cause)
    }

    /// What the move was to change, how far beside that it ended, and by how much the view goes with a rotation centre that lies elsewhere.
    pub(super) fn tells(&self, seen: &PoseError, mover: &Mover<'_>) -> (Vec2, Vec2, Mat2) {
        let promised = self.error_at(&self.goal, mover);
        let less = |a: Vec2, b: Vec2| [a[0] - b[0], a[1] - b[1]];
        let centre = mover.view.rotation_centre_m.unwrap_or_default();
        // The view's place is a linear function of it.
        let lever = [0, 1].map(|k| {
            let mut centre = centre;
            centre[k] += 1.0;
            let view = Calibration {
                rotation_centre_m: Some(centre),
                ..mover.view.clone()
            };
            let elsewhere = self.error_at(
                &self.goal,
                &Mover {
                    view: &view,
                    ..*mover
                },
            );
            less(elsewhere.t_m, promised.t_m)
        });
        (
            less(promised.t_m, self.from.t_m),
            less(seen.t_m, promised.t_m),
            Mat2([[lever[0][0], lever[1][0]], [lever[0][1], lever[1][1]]]),
        )
    }

    /// What may explain an error, the simplest first, and how far from what is seen the view would then be, m.
    fn causes(&self, seen: &PoseError, mover: &Mover<'_>) -> Vec<(Contradiction, f64)> {
        let (before, goal) = (&self.before, &self.goal);
        let by = [0, 1].map(|k| goal.x_m[k] - before.x_m[k]);
        let turn = goal.theta_rad - before.theta_rad;
        let size_m = size_m(mover);
        // How far from what is seen the view would be, had the stage gone by so much.
        let left = |x: Vec2, theta: f64| {
            let pose = PlanarPose {
                x_m: [0, 1].map(|k| before.x_m[k] + x[k]),
                theta_rad: before.theta_rad + theta,
            };
            let (off_m, off_rad) = apart(&self.error_at(&pose, mover), seen);
            off_m.max(size_m * off_rad)
        };
        let goal = self.error_at(goal, mover);
        // From the target's camera axes to those of the stage, as the optics stood before.
        let camera = mover.view.stage_from_camera() * Mat2::rotation(-self.from.theta_rad);
        let way_m = [0, 1].map(|k| goal.t_m[k] - self.from.t_m[k]);
        // The same, had it gone as it was told, and the calibration were of another map: the view goes another way.
        let mapped = |map: Mat2| {
            let way_m = camera.transpose() * (map * (camera * way_m));
            let error = PoseError {
                t_m: [0, 1].map(|k| self.from.t_m[k] + way_m[k]),
                theta_rad: self.from.theta_rad
                    + map.det().signum() * (goal.theta_rad - self.from.theta_rad),
            };
            let (off_m, off_rad) = apart(&error, seen);
            off_m.max(size_m * off_rad)
        };
        let swapped = Mat2([[0.0, 1.0], [1.0, 0.0]]);
        let [x, y] = by;
        let mut causes = vec![
            (Contradiction::NothingMoved, left([0.0; 2], 0.0)),
            (Contradiction::Reversed, mapped(Mat2::diagonal(-1.0, -1.0))),
            (
                Contradiction::AxisReversed(Axis::X),
                mapped(Mat2::diagonal(-1.0, 1.0)),
            ),
            (
                Contradiction::AxisReversed(Axis::Y),
                mapped(Mat2::diagonal(1.0, -1.0)),
            ),
            (Contradiction::Swapped, mapped(swapped)),
            (Contradiction::AxisStands(Axis::X), left([0.0, y], turn)),
            (Contradiction::AxisStands(Axis::Y), left([x, 0.0], turn)),
            (Contradiction::AxisStands(Axis::Rz), left(by, 0.0)),
            (Contradiction::Reversed, left([-x, -y], turn)),
            (Contradiction::AxisReversed(Axis::X), left([-x, y], turn)),
            (Contradiction::AxisReversed(Axis::Y), left([x, -y], turn)),
            (Contradiction::AxisReversed(Axis::Rz), left(by, -turn)),
            (Contradiction::Swapped, left([y, x], turn)),
        ];
        causes.extend(self.turned(&goal, seen, size_m));
        let shares = (1..=60).map(|k| 0.05 * f64::from(k));
        causes.extend(shares.map(|s| (Contradiction::Share(s), left([s * x, s * y], s * turn))));
        causes
    }

    /// What explains no more than that all went as it was told is no cause: a rotation that stands where none was asked for.
    fn half_of_what_is_off(&self, seen: &PoseError, mover: &Mover<'_>) -> f64 {
        let (off_m, off_rad) = apart(&self.error_at(&self.goal, mover), seen);
        0.5 * off_m.max(size_m(mover) * off_rad)
    }

    /// How well each cause explains what was seen.
    pub(super) fn fits(&self, seen: &PoseEstimate, mover: &Mover<'_>, view_m: f64) -> Fits {
        let most_m = self.half_of_what_is_off(&seen.error, mover);
        let unsure_m = self.unsure_m(seen, view_m);
        let leaves_m = [unsure_m, unsure_m + LEAVES * self.gone_m(mover)];
        let of = |left_m: f64| leaves_m.map(|leaves_m| left_m / leaves_m.min(most_m).max(1e-9));
        let causes = self.causes(&seen.error, mover).into_iter();
        Fits(causes.map(|(cause, left_m)| (cause, of(left_m))).collect())
    }

    /// How far beside its promise a view may lie for all that is uncertain, m. `view_m`: size of its pixels.
    fn unsure_m(&self, seen: &PoseEstimate, view_m: f64) -> f64 {
        let [a, b, _] = seen.sigma();
        SIGMAS * (self.sigma_m.powi(2) + a * a + b * b).sqrt() + view_m
    }

    /// How far the move takes the view, or the stage: with its rotation far away it goes farther than the view does.
    fn gone_m(&self, mover: &Mover<'_>) -> f64 {
        let way_m = apart(&self.from, &self.error_at(&self.goal, mover)).0;
        let by_m = [0, 1].map(|k| self.goal.x_m[k] - self.before.x_m[k]);
        way_m.max(f64::hypot(by_m[0], by_m[1]))
    }
}

/// How well each cause explains a move, the simplest first: it does up to 1, as all is known, and with a calibration that has drifted.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Fits(Vec<(Contradiction, [f64; 2])>);

impl Fits {
    /// The simplest that explains this move.
    fn simplest(&self) -> Option<Contradiction> {
        // What is read off the move has something to spare, and fits it better than it should.
        let named = self.0.iter().filter(|(cause, _)| !cause.is_read_off());
        let named = named.map(|(cause, [sure, _])| (*cause, *sure));
        let drifted = self
            .0
            .iter()
            .map(|(cause, [_, drifted])| (*cause, *drifted));
        // Few causes explain it as well as all is known, and none does so by chance: it goes before what is simpler and needs a drift besides.
        simplest(named).or_else(|| simplest(drifted))
    }

    /// The simplest that explains this move and another one.
    pub(super) fn both(&self, other: &Self) -> Option<Contradiction> {
        // A turn is read off a move, and fits it.
        let of = |fits: &Self| {
            let each = fits.0.iter().copied();
            let each = each.filter(|(cause, _)| !matches!(cause, Contradiction::Turned(_)));
            each.collect::<Vec<_>>()
        };
        let all = std::iter::zip(of(self), of(other));
        let worse = all.map(|((cause, a), (_, b))| (cause, [0, 1].map(|k| a[k].max(b[k]))));
        Self(worse.collect()).simplest()
    }
}

/// The first of those that fit, and not much worse than the best.
fn simplest(causes: impl Iterator<Item = (Contradiction, f64)> + Clone) -> Option<Contradiction> {
    let best = causes.clone().map(|c| c.1).fold(f64::INFINITY, f64::min);
    let most = 1f64.min(best + 0.5);
    let mut fit = causes.filter(|(_, fit)| *fit <= most);
    fit.next().map(|(cause, _)| cause)
}

/// Half of a view's width, m.
fn size_m(mover: &Mover<'_>) -> f64 {
    0.5e-6 * mover.view.um_per_px() * mover.view.image_size_px[0] as f64
}

impl Promise {
    /// What is left where the view went as far as it was told, in a direction that is turned by more than a drifted calibration turns it.
    fn turned(
        &self,
        goal: &PoseError,
        seen: &PoseError,
        size_m: f64,
    ) -> Option<(Contradiction, f64)> {
        let way = |to: &PoseError| [0, 1].map(|k| to.t_m[k] - self.from.t_m[k]);
        let (told_m, gone_m) = (way(goal), way(seen));
        let turned = direction(gone_m) - direction(told_m);
        let turned = turned.sin().atan2(turned.cos());
        let went_m = Mat2::rotation(turned) * told_m;
        let beside = PoseError {
            t_m: [0, 1].map(|k| self.from.t_m[k] + went_m[k]),
            ..*goal
        };
        let (off_m, off_rad) = apart(&beside, seen);
        let left_m = off_m.max(size_m * off_rad);
        (turned.abs() > DRIFTED_SHARE).then_some((Contradiction::Turned(turned), left_m))
    }
}

/// How far two errors are apart, m and rad.
fn apart(a: &PoseError, b: &PoseError) -> (f64, f64) {
    let turn = a.theta_rad - b.theta_rad;
    let distance = f64::hypot(a.t_m[0] - b.t_m[0], a.t_m[1] - b.t_m[1]);
    (distance, turn.sin().atan2(turn.cos()).abs())
}

/// How far a rotation centre that has drifted takes the view beside, m.
fn sweep_m(turned_rad: f64) -> f64 {
    2.0 * DRIFTED_CENTRE_M * (0.5 * turned_rad).sin().abs()
}

fn direction([x, y]: Vec2) -> f64 {
    y.atan2(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::servo::refit::Refit;
    use scopeservo_scope::ObjectiveId;

    fn known() -> Calibration {
        Calibration {
            schema: crate::CALIBRATION_SCHEMA,
            objective: ObjectiveId("10x".into()),
            image_size_px: [640, 480],
            stage_from_pixel: Mat2([[0.0, 2.2e-6], [2.2e-6, 0.0]]),
            rotation_centre_m: Some([0.125, 0.0]),
            covariance: Some([[0.0; 6]; 6]),
            backlash: Some(crate::Backlash {
                x_m: 0.0,
                y_m: 0.0,
                rz_rad: 0.0,
                sigma: [0.0; 3],
            }),
            scatter: Some([2e-7, 2e-7, 3e-6]),
        }
    }

    fn mover(view: &Calibration) -> Mover<'_> {
        Mover {
            kinematics: Kinematics::MovesMicroscope,
            view,
            scatter: [2e-7, 2e-7, 3e-6],
        }
    }

    fn estimate(error: PoseError) -> PoseEstimate {
        PoseEstimate {
            error,
            covariance: [[1e-14, 0.0, 0.0], [0.0, 1e-14, 0.0], [0.0, 0.0, 1e-8]],
        }
    }

    fn begins() -> PoseEstimate {
        estimate(PoseError {
            t_m: [-1.7e-4, -5.0e-4],
            theta_rad: 0.035,
        })
    }

    fn at(x_m: Vec2) -> PlanarPose {
        PlanarPose {
            x_m,
            theta_rad: 0.0,
        }
    }

    /// What one move leaves open a second one tells: the cause must explain both.
    #[test]
    fn two_moves_are_named_by_what_explains_both() {
        let known = known();
        let mover = mover(&known);
        let from = begins();
        let went = |told: Vec2, went: Vec2| {
            let promise = Promise::of(&from, (at([0.0; 2]), at(told)), &mover, 0.0);
            let seen = estimate(promise.error_at(&at(went), &mover));
            let Kept::No(alone) = promise.kept(&seen, &mover, 2.2e-6) else {
                panic!("{told:?} {went:?}");
            };
            (alone, promise.fits(&seen, &mover, 2.2e-6))
        };
        let d = 2e-4;
        use Contradiction as C;
        type Goes = fn(Vec2) -> Vec2;
        let cases: [(Vec2, Goes, C, Option<C>); 5] = [
            (
                [d, 0.0],
                |[x, y]| [-x, y],
                C::Reversed,
                Some(C::AxisReversed(Axis::X)),
            ),
            (
                [0.0, -d],
                |[x, y]| [x, -y],
                C::Reversed,
                Some(C::AxisReversed(Axis::Y)),
            ),
            (
                [d, 0.0],
                |[_, y]| [0.0, y],
                C::NothingMoved,
                Some(C::AxisStands(Axis::X)),
            ),
            ([d, -d], |[x, y]| [y, x], C::Reversed, Some(C::Swapped)),
            (
                [d, d],
                |[x, y]| [0.4 * x, 0.4 * y],
                C::Share(0.4),
                Some(C::Share(0.4)),
            ),
        ];
        for (first, goes, alone, both) in cases {
            let (named, one) = went(first, goes(first));
            assert_eq!(named, alone, "{first:?}");
            let second = [0.5 * d, 0.8 * d];
            let (_, two) = went(second, goes(second));
            let joint = two.both(&one);
            let is = match (joint, both) {
                (Some(C::Share(a)), Some(C::Share(b))) => (a - b).abs() < 0.06,
                (a, b) => a == b,
            };
            assert!(is, "{first:?}: {joint:?}, not {both:?}");
        }
        // Pushed twice, by chance the first time as if x were reversed.
        let (_, one) = went([d, d], [-d, d]);
        let (_, two) = went([d, d], [1.3 * d, -0.4 * d]);
        assert_eq!(two.both(&one), None);
    }

    /// A turn about a centre far away takes the stage far, and a share of that leaves much open: what explains all of it is the cause all the same.
    #[test]
    fn what_explains_all_of_a_long_way_goes_before_what_needs_a_drift_besides() {
        let known = known();
        let mover = mover(&known);
        let from = begins();
        let turn = |x_m| PlanarPose {
            x_m,
            theta_rad: 0.035,
        };
        let [x, y] = [2.5e-4, -4.7e-3];
        let promise = Promise::of(&from, (at([0.0; 2]), turn([x, y])), &mover, 0.0);
        let after = |pose| {
            let error = promise.error_at(&pose, &mover);
            promise.kept(&estimate(error), &mover, 2.2e-6)
        };
        let [x_stands, x_reversed] =
            [Contradiction::AxisStands, Contradiction::AxisReversed].map(|of| of(Axis::X));
        assert_eq!(after(turn([-x, y])), Kept::No(x_reversed));
        assert_eq!(after(turn([0.0, y])), Kept::No(x_stands));
        // So it is with a calibration that has drifted a little.
        assert_eq!(after(turn([-x, 0.99 * y])), Kept::No(x_reversed));
    }

    /// After a loss a small step of both axes tells what is wrong, however far the target is still off.
    #[test]
    fn a_small_step_with_a_calibration_in_doubt_tells_signs_exchanged_and_standing_axes() {
        let known = known();
        let mover = Mover {
            view: &Refit::doubting(true).believed(&known),
            ..mover(&known)
        };
        let from = begins();
        let [x, y] = [9.1e-5, 5.4e-5];
        let moved = (at([0.0; 2]), at([x, y]));
        let promise = Promise::of(&from, moved, &mover, 0.0);
        let after = |x_m| {
            let error = promise.error_at(&at(x_m), &mover);
            promise.kept(&estimate(error), &mover, 2.2e-6)
        };
        assert_eq!(after([x, y]), Kept::Yes);
        for (went, why) in [
            ([-x, y], Contradiction::AxisReversed(Axis::X)),
            ([x, -y], Contradiction::AxisReversed(Axis::Y)),
            ([-x, -y], Contradiction::Reversed),
            ([y, x], Contradiction::Swapped),
            ([0.0, y], Contradiction::AxisStands(Axis::X)),
            ([x, 0.0], Contradiction::AxisStands(Axis::Y)),
            ([0.0, 0.0], Contradiction::NothingMoved),
        ] {
            assert_eq!(after(went), Kept::No(why), "{went:?}");
        }
    }
}
