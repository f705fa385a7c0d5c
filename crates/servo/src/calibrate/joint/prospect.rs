//! What a view at a pose would see, by what is known so far.

use super::fit::JointFit;
use super::plan::{Known, PathOptions};
use super::sight::{shown, sight};
use crate::kinematics::{Motion2, PlanarPose, pose_after};
use scopeservo_geometry::{Mat2, Vec2};
use scopeservo_scope::Kinematics;

/// At a limit a view lies beside where it should by this share of what a rotation may miss.
const BESIDE: f64 = 0.7;
/// To these sides, the least first.
const ASIDE: [Vec2; 9] = [
    [0.0, 0.0],
    [1.0, 0.0],
    [-1.0, 0.0],
    [0.0, 1.0],
    [0.0, -1.0],
    [1.0, 1.0],
    [1.0, -1.0],
    [-1.0, 1.0],
    [-1.0, -1.0],
];

/// What is known, with what is wanted and allowed.
pub(super) struct Prospect<'a> {
    pub(super) options: &'a PathOptions,
    pub(super) known: &'a Known<'a>,
    pub(super) allowed: &'a dyn Fn(&PlanarPose) -> bool,
}

impl Known<'_> {
    /// Where the centre of a view at b lies in one at a, px from its centre. Before the map is known it is as far to either side.
    fn shift_px(&self, a: &PlanarPose, b: &PlanarPose) -> Option<Vec2> {
        let Some(fit) = self.fit else {
            let way_m = f64::hypot(a.x_m[0] - b.x_m[0], a.x_m[1] - b.x_m[1]);
            return Some([way_m / self.nominal_m_per_px * std::f64::consts::FRAC_1_SQRT_2; 2]);
        };
        self.shows(a, b, fit).map(|[x, y, _]| [x, y])
    }

    /// Where the centre of a view at b lies in one at a, px from its centre, and its angle there, rad.
    pub(crate) fn shows(&self, a: &PlanarPose, b: &PlanarPose, fit: &JointFit) -> Option<[f64; 3]> {
        let optics = fit.instrument.optics.get(self.optics)?;
        let sights = [a, b].map(|p| sight(self.kinematics, p, optics.centre_m));
        shown(&sights, &[optics, optics])
    }

    /// How far an image's centre moves on the sensor between two poses, px; 0 where that is not known.
    pub fn moves_px(&self, a: &PlanarPose, b: &PlanarPose) -> f64 {
        self.shift_px(a, b).map_or(0.0, |[x, y]| f64::hypot(x, y))
    }
}

impl Prospect<'_> {
    pub(super) fn reference(&self) -> PlanarPose {
        let first = self.known.taken.first();
        first.map_or(self.known.start, |t| t.asked)
    }

    pub(super) fn play(&self) -> [f64; 3] {
        let [x, y, turn] = self.options.most_play;
        [x, y, if self.known.turns { turn } else { 0.0 }]
    }

    /// The shorter side of the field, m.
    pub(super) fn field_m(&self) -> f64 {
        let [columns, rows] = self.known.image_size_px;
        columns.min(rows) as f64 * self.known.nominal_m_per_px
    }

    /// The longest step in a direction that leaves enough overlap for sure, m. `None` before the map is known.
    pub(super) fn longest_step_m(&self, direction: Vec2) -> Option<f64> {
        let fit = self.known.fit?;
        let optics = fit.instrument.optics.get(self.known.optics)?;
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
    pub(super) fn overlap(&self, a: &PlanarPose, b: &PlanarPose) -> f64 {
        let size_px = self.known.image_size_px.map(|n| n as f64);
        self.known.shift_px(a, b).map_or(0.0, |shift_px| {
            let left = [0, 1].map(|k| (1.0 - shift_px[k].abs() / size_px[k]).max(0.0));
            left[0] * left[1]
        })
    }

    /// The pose that turns by `turn_rad` about the view's centre at a pose.
    pub(super) fn turned(
        &self,
        fit: &JointFit,
        about: &PlanarPose,
        turn_rad: f64,
    ) -> Option<PlanarPose> {
        let eta = fit.instrument.optics.get(self.known.optics)?.centre_m;
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

    /// How far a rotation may miss the view's centre, m.
    pub(super) fn miss_m(&self) -> f64 {
        self.options.miss_share * self.field_m()
    }

    /// A pose, or one so little beside it that the view misses nothing, where the stage may go: at a limit.
    pub(super) fn near(&self, pose: &PlanarPose) -> Option<PlanarPose> {
        let beside = |by: Vec2| PlanarPose {
            x_m: [0, 1].map(|k| pose.x_m[k] + by[k] * BESIDE * self.miss_m()),
            ..*pose
        };
        ASIDE.into_iter().map(beside).find(self.allowed)
    }

    /// The widest rotation about a view to one side (1 or -1) that is allowed, rad.
    pub(super) fn widest_rad(&self, fit: &JointFit, about: &PlanarPose, side: f64) -> f64 {
        let shares = (0..20).map(|k| 1.0 - 0.05 * f64::from(k));
        shares
            .map(|share| share * self.options.widest_rad)
            .find(|angle| {
                let turned = self.turned(fit, about, side * angle);
                turned.and_then(|p| self.near(&p)).is_some()
            })
            .unwrap_or(0.0)
    }

    /// The standard deviation of the map, relative.
    pub(super) fn map_sigma(&self, fit: &JointFit) -> Option<f64> {
        let optics = fit.instrument.optics.get(self.known.optics)?;
        let variance: f64 = (0..4)
            .map(|k| fit.optics_covariance(self.known.optics)[k][k])
            .sum();
        Some(variance.sqrt() / optics.stage_from_pixel.frobenius())
    }

    /// The standard deviation of the rotation centre where it is greatest, m.
    pub(super) fn lever_sigma_m(&self, fit: &JointFit) -> f64 {
        let c = fit.optics_covariance(self.known.optics);
        let covariance = Mat2([[c[4][4], c[4][5]], [c[5][4], c[5][5]]]);
        covariance.svd().s[0].sqrt()
    }
}
