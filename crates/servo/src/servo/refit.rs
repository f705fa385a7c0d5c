//! What moves say of a calibration that does not quite hold: how far scale, camera angle and rotation centre are off.

use crate::{Attempt, Calibration, Known};
use scopeservo_geometry::{Mat2, Vec2, cholesky_inverse};
use scopeservo_scope::ObjectiveId;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// What is to be expected of a calibration that has drifted, standard deviations: half of the paper's convergence range (Table II, at 100x).
const SCALE: f64 = 0.03;
const ANGLE_RAD: f64 = 0.078;
const CENTRE_M: f64 = 4.6e-3;

/// What is off by so many standard deviations is told.
const SURE: f64 = 4.0;

/// What a run learnt of its instrument and went on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "remark", rename_all = "snake_case")]
pub enum Remark {
    /// The calibration has drifted, within what a servo survives.
    Drifted {
        /// The objective that was in.
        objective: ObjectiveId,
        /// A pixel has so many times the size that the calibration says, less one.
        scale: Known,
        /// The view goes in a direction turned by so much, deg.
        turned_deg: Known,
        /// The rotation centre lies so far from where the calibration says, mm in stage axes.
        centre_mm: [Known; 2],
    },
    /// The view lay beside where a move and a change of objective were to bring it, by no more than a calibration that has drifted does.
    Beside {
        /// The objective that came in.
        objective: ObjectiveId,
        /// How far, um.
        um: f64,
        /// Where it lay on the line that the view went, by so large a share of its way too far; negative: short of it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        share_of_way: Option<f64>,
    },
    /// Beside the target's, this objective's scale is so many times what the calibrations say.
    ScalesDisagree {
        /// The objective that was in.
        objective: ObjectiveId,
        /// The scale that was seen over the one that was expected.
        factor: f64,
    },
    /// The view is less sharp than the saved one, by more than half a depth of field explains, and no other height was sharper.
    Blurred {
        /// The objective that was in.
        objective: ObjectiveId,
        /// So far from focus a view is as blurred, um.
        defocus_um: f64,
        /// Power of fine detail in the view over that in the saved one, beside what both have of coarser detail.
        sharpness: f64,
    },
    /// Something was tried where the run could not go on as it was.
    Tried {
        /// The objective that was in.
        objective: ObjectiveId,
        /// What.
        #[serde(flatten)]
        attempt: Attempt,
    },
    /// A move did not do what it was to do, and the next one did.
    Contradicted {
        /// The objective that was in.
        objective: ObjectiveId,
        /// What it was.
        why: crate::Contradiction,
    },
}

/// The normal equations of scale, angle and centre, in units of what is to be expected.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Refit {
    information: [[f64; 4]; 4],
    vector: [f64; 4],
    /// Whether a move has shown that the calibration drifted.
    pub(crate) drifted: bool,
    /// Whether a move has lost the target: then it may have.
    #[serde(default)]
    pub(crate) doubted: bool,
}

impl Refit {
    /// Nothing is known yet; `doubted`: nor is the calibration trusted.
    pub(crate) fn doubting(doubted: bool) -> Self {
        Self {
            doubted,
            ..Self::default()
        }
    }

    /// Whether what is off is more than what is not known of it, by the moves and by the calibration that made them. One that is doubted, or
    /// does not know how good it is, says nothing.
    pub(crate) fn shows(&self, view: &Calibration) -> bool {
        let known = match (self.doubted, &view.covariance) {
            (true, _) => [0.0; 4],
            (false, None) => return false,
            (false, Some(c)) => {
                let map: f64 = (0..4).map(|k| c[k][k]).sum::<f64>() / 4.0;
                let share = map.sqrt() / (1e-6 * view.um_per_px());
                [share, share, c[4][4].sqrt(), c[5][5].sqrt()]
            }
        };
        let surely = |(k, known): (&Known, f64)| k.value.abs() > SURE * f64::hypot(k.sigma, known);
        self.estimate().iter().zip(known).any(surely)
    }

    /// Takes a move that was to change the error by `way_m` and ended `off_m` beside that, standard deviation `sigma_m`. By `lever` the view
    /// goes where the rotation centre lies elsewhere.
    pub(crate) fn take(&mut self, way_m: Vec2, off_m: Vec2, lever: Mat2, sigma_m: f64) {
        let [x, y] = way_m;
        let by = [
            [
                SCALE * x,
                -ANGLE_RAD * y,
                CENTRE_M * lever.0[0][0],
                CENTRE_M * lever.0[0][1],
            ],
            [
                SCALE * y,
                ANGLE_RAD * x,
                CENTRE_M * lever.0[1][0],
                CENTRE_M * lever.0[1][1],
            ],
        ];
        // What is off the calibration as it is believed, and how far that is off the one that is kept.
        let known = self.applied();
        let off_m = [0, 1].map(|k| {
            let applied: f64 = (0..4).map(|i| by[k][i] * known[i]).sum();
            off_m[k] + applied
        });
        let weight = sigma_m.max(1e-9).powi(-2);
        for (row, off) in by.iter().zip(off_m) {
            for i in 0..4 {
                self.vector[i] += weight * row[i] * off;
                for j in 0..4 {
                    self.information[i][j] += weight * row[i] * row[j];
                }
            }
        }
    }

    /// Scale, angle and both coordinates of the centre in their own units, with standard deviations.
    fn estimate(&self) -> [Known; 4] {
        let mut information = self.information;
        for (i, row) in information.iter_mut().enumerate() {
            row[i] += 1.0;
        }
        let covariance = cholesky_inverse(&information).unwrap_or([[0.0; 4]; 4]);
        let units = [SCALE, ANGLE_RAD, CENTRE_M, CENTRE_M];
        std::array::from_fn(|i| Known {
            value: units[i]
                * (0..4)
                    .map(|j| covariance[i][j] * self.vector[j])
                    .sum::<f64>(),
            sigma: units[i] * covariance[i][i].sqrt(),
        })
    }

    /// As much of it as a calibration is believed to be off, in units of what is to be expected. A scale is that of the target.
    fn applied(&self) -> [f64; 4] {
        if !self.drifted && !self.doubted {
            return [0.0; 4];
        }
        let [_, angle, x, y] = self.estimate().map(|k| k.value);
        [0.0, angle / ANGLE_RAD, x / CENTRE_M, y / CENTRE_M]
    }

    /// What there is to tell.
    pub(crate) fn remark(&self, objective: &ObjectiveId) -> Option<Remark> {
        let [scale, angle, x, y] = self.estimate();
        let times = |known: Known, unit: f64| Known {
            value: unit * known.value,
            sigma: unit * known.sigma,
        };
        self.drifted.then(|| Remark::Drifted {
            objective: objective.clone(),
            // The view went farther by the pixels of the calibration: they are smaller than it says.
            scale: Known {
                value: 1.0 / (1.0 + scale.value) - 1.0,
                ..scale
            },
            turned_deg: times(angle, 1f64.to_degrees()),
            centre_mm: [times(x, 1e3), times(y, 1e3)],
        })
    }

    /// A calibration as it is known now: turned and with the centre that the moves have shown, and no better known than by them.
    pub(crate) fn believed<'a>(&self, view: &'a Calibration) -> Cow<'a, Calibration> {
        if !self.drifted && !self.doubted {
            return Cow::Borrowed(view);
        }
        let [scale, angle, x, y] = self.estimate();
        let map = scale.value.powi(2) + scale.sigma.powi(2) + angle.sigma.powi(2);
        let map = map * (1e-6 * view.um_per_px()).powi(2);
        let mut covariance = view.covariance.unwrap_or_default();
        let more = [map, map, map, map, x.sigma.powi(2), y.sigma.powi(2)];
        for (k, more) in more.into_iter().enumerate() {
            covariance[k][k] += more;
        }
        // The view goes in a direction turned by the angle: the camera's axes lie that much the other way.
        let camera = view.stage_from_camera();
        let turned = camera * Mat2::rotation(-angle.value) * camera.transpose();
        let centre = view.rotation_centre_m;
        Cow::Owned(Calibration {
            stage_from_pixel: turned * view.stage_from_pixel,
            rotation_centre_m: centre.map(|[a, b]| [a + x.value, b + y.value]),
            covariance: Some(covariance),
            scatter: Some(view.scatter.unwrap_or_default()),
            ..view.clone()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(refit: &mut Refit) -> ([f64; 2], [f64; 2]) {
        refit.drifted = true;
        match refit.remark(&ObjectiveId("40x".into())) {
            Some(Remark::Drifted {
                scale,
                turned_deg,
                centre_mm,
                ..
            }) => ([scale.value, turned_deg.value], centre_mm.map(|k| k.value)),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn one_way_tells_scale_and_angle_and_two_turns_the_centre() {
        let way = [3e-4, -1e-4];
        let turned = |k: f64, phi: f64| [way[0] * k - way[1] * phi, way[1] * k + way[0] * phi];
        let mut refit = Refit::default();
        refit.take(way, turned(-0.05, 0.03), Mat2([[0.0; 2]; 2]), 2e-7);
        let ([scale, deg], centre) = told(&mut refit);
        // A twentieth less by its pixels: they are larger.
        assert!((scale - 0.0526).abs() < 1e-3, "{scale}");
        assert!((deg - 0.03f64.to_degrees()).abs() < 0.03, "{deg}");
        assert_eq!(centre, [0.0; 2]);
        let mut refit = Refit::default();
        for turn in [0.1, -0.2] {
            let lever = Mat2::rotation(turn) - Mat2::IDENTITY;
            let off = lever * [2e-3, -1e-3];
            refit.take([1e-5, 0.0], off, lever, 2e-7);
        }
        let ([scale, _], [x, y]) = told(&mut refit);
        assert!((x - 2.0).abs() < 0.05 && (y + 1.0).abs() < 0.05, "{x} {y}");
        assert!(scale.abs() < 0.03, "{scale}");
    }

    /// A calibration that is off is believed to be the true one, and what it then promises is kept.
    #[test]
    fn what_is_believed_is_what_the_moves_have_shown() {
        let truth = Calibration {
            schema: crate::CALIBRATION_SCHEMA,
            objective: ObjectiveId("10x".into()),
            image_size_px: [640, 480],
            stage_from_pixel: Mat2([[0.0, 2e-6], [2e-6, 0.0]]),
            rotation_centre_m: Some([3e-3, -1e-3]),
            covariance: Some([[0.0; 6]; 6]),
            backlash: None,
            scatter: Some([0.0; 3]),
        };
        let kept = Calibration {
            stage_from_pixel: Mat2::rotation(0.1) * truth.stage_from_pixel,
            rotation_centre_m: Some([6e-3, -4e-3]),
            ..truth.clone()
        };
        let motion = |way: Vec2, turn: f64| crate::Motion2 {
            alpha_rad: turn,
            d_m: way,
        };
        let from = crate::PoseError {
            t_m: [2e-4, 1e-4],
            theta_rad: 0.3,
        };
        let goes = |view: &Calibration, by: &crate::Motion2| {
            let after = crate::law::error_after(&from, by, view);
            [0, 1].map(|k| after.t_m[k] - from.t_m[k])
        };
        let less = |a: Vec2, b: Vec2| [a[0] - b[0], a[1] - b[1]];
        let mut refit = Refit::default();
        for by in [
            motion([7e-5, 4e-5], 0.0),
            motion([2e-5, 1e-5], 0.01),
            motion([-1e-4, 3e-5], -0.2),
        ] {
            let view = refit.believed(&kept).into_owned();
            let way = goes(&view, &by);
            let lever = [0, 1].map(|k| {
                let mut there = view.clone();
                let mut centre = there.rotation_centre_m.unwrap();
                centre[k] += 1.0;
                there.rotation_centre_m = Some(centre);
                less(goes(&there, &by), way)
            });
            let lever = Mat2([[lever[0][0], lever[1][0]], [lever[0][1], lever[1][1]]]);
            refit.take(way, less(goes(&truth, &by), way), lever, 2e-7);
            refit.drifted = true;
        }
        let believed = refit.believed(&kept);
        let by = motion([-2e-4, 1e-4], 0.8);
        let off = less(goes(&truth, &by), goes(&believed, &by));
        let before = less(goes(&truth, &by), goes(&kept, &by));
        let size = |[x, y]: Vec2| x.hypot(y);
        assert!(size(before) > 2e-3, "{before:?}");
        assert!(size(off) < 0.02 * size(before), "{off:?} of {before:?}");
    }
}
