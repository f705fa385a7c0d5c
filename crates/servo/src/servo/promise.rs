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
        let [a, b, angle] = seen.sigma();
        let unsure_m = SIGMAS * (self.sigma_m.powi(2) + a * a + b * b).sqrt() + view_m;
        let unsure_rad = SIGMAS * f64::hypot(self.sigma_rad, angle) + SLACK_RAD;
        let (off_m, off_rad) = apart(&promised, &seen.error);
        if off_m <= unsure_m && off_rad <= unsure_rad {
            return Kept::Yes;
        }
        let way_m = apart(&self.from, &promised).0;
        let turned_rad = (self.goal.theta_rad - self.before.theta_rad).abs();
        let sweep_m = sweep_m(turned_rad);
        // A stage with its rotation far away goes farther than the view does.
        let by_m = [0, 1].map(|k| self.goal.x_m[k] - self.before.x_m[k]);
        let gone_m = way_m.max(f64::hypot(by_m[0], by_m[1]));
        // What stands or goes the other way explains all of it; a share of the way is what a drifted calibration makes of it, too.
        let cause = self.cause(&seen.error, mover, unsure_m + LEAVES * gone_m);
        let sure = !matches!(
            cause,
            Contradiction::Share(_) | Contradiction::Turned(_) | Contradiction::Elsewhere
        );
        if sure && DRIFTED_SHARE * gone_m > unsure_m {
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

    /// The simplest of what explains an error to within `leaves_m` of the view.
    fn cause(&self, seen: &PoseError, mover: &Mover<'_>, leaves_m: f64) -> Contradiction {
        let (before, goal) = (&self.before, &self.goal);
        let by = [0, 1].map(|k| goal.x_m[k] - before.x_m[k]);
        let turn = goal.theta_rad - before.theta_rad;
        let size_m = 0.5 * mover.view.um_per_px() * 1e-6 * mover.view.image_size_px[0] as f64;
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
        let best = causes.iter().map(|c| c.1).fold(f64::INFINITY, f64::min);
        // What explains no more than that all went as it was told is no cause: a rotation that stands where none was asked for.
        let (off_m, off_rad) = apart(&goal, seen);
        let most_m = (best + 0.5 * leaves_m).min(0.5 * off_m.max(size_m * off_rad));
        let simplest = causes
            .into_iter()
            .find(|(_, left_m)| *left_m <= leaves_m && *left_m <= most_m);
        simplest.map_or(Contradiction::Elsewhere, |(cause, _)| cause)
    }
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

    /// After a loss a small step of both axes tells what is wrong, however far the target is still off.
    #[test]
    fn a_small_step_with_a_calibration_in_doubt_tells_signs_exchanged_and_standing_axes() {
        let known = Calibration {
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
        };
        let mover = Mover {
            kinematics: Kinematics::MovesMicroscope,
            view: &Refit::doubting(true).believed(&known),
            scatter: [2e-7, 2e-7, 3e-6],
        };
        let estimate = |error| PoseEstimate {
            error,
            covariance: [[1e-14, 0.0, 0.0], [0.0, 1e-14, 0.0], [0.0, 0.0, 1e-8]],
        };
        let from = estimate(PoseError {
            t_m: [-1.7e-4, -5.0e-4],
            theta_rad: 0.035,
        });
        let [x, y] = [9.1e-5, 5.4e-5];
        let at = |x_m| PlanarPose {
            x_m,
            theta_rad: 0.0,
        };
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
