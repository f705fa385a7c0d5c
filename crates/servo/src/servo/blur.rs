//! How blurred a view is beside its target, as a height.

use crate::focus::depth_of_field_um;
use scopeservo_registration::pixels::Sharpness;
use scopeservo_scope::Objective;
use serde::{Deserialize, Serialize};

/// What is worse than this share of half a depth of field, for sure, is worth another height.
const WORTH: f64 = 0.75;
/// For sure: so many standard deviations, and what other light, stain or gamma make of a sharpness besides, squares of pixels.
const SURE_SIGMAS: f64 = 2.0;
const BESIDES_PX2: f64 = 0.02;

/// A view that is softer than its target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Blur {
    /// So far from focus a view is as soft as this one whose target was in focus, um; 0 where it is as sharp.
    pub(crate) defocus_um: f64,
    /// As far at least, for sure.
    pub(crate) surely_um: f64,
    /// Half of the depth of field, um.
    pub(crate) half_depth_um: f64,
    /// Power of fine detail in the view over that in the target.
    pub(crate) ratio: f64,
}

impl Blur {
    /// What a sharpness means with an objective, whose pixels are so large on the specimen.
    pub(crate) fn of(seen: &Sharpness, um_per_px: f64, objective: &Objective) -> Self {
        let half_depth_um = 0.5 * depth_of_field_um(objective);
        // The standard deviation of the light cone is half of its radius.
        let cone = 0.5 * objective.numerical_aperture.min(0.95).asin().tan();
        let defocus_um = |softer_px2: f64| {
            let variance = softer_px2.max(0.0) * um_per_px.powi(2) / cone.powi(2);
            defocus_um(variance, half_depth_um)
        };
        let margin_px2 = SURE_SIGMAS * seen.sigma_px2 + BESIDES_PX2;
        Self {
            defocus_um: defocus_um(seen.softer_px2),
            surely_um: defocus_um(seen.softer_px2 - margin_px2),
            half_depth_um,
            ratio: seen.ratio,
        }
    }

    /// Whether the view is less sharp for sure than half a depth of field explains.
    pub(crate) fn counts(&self) -> bool {
        self.surely_um > WORTH * self.half_depth_um
    }
}

/// Within the depth of field the cone of light sets in only gradually: `v = d^2 d^2 / (d^2 + h^2)`, solved for d.
fn defocus_um(variance: f64, half_depth_um: f64) -> f64 {
    let root = (variance * (variance + 4.0 * half_depth_um.powi(2))).sqrt();
    (0.5 * (variance + root)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::{Immersion, ObjectiveId};

    #[test]
    fn the_variance_of_a_defocus_gives_the_defocus_back() {
        let objective = Objective {
            id: ObjectiveId("40x".into()),
            magnification: 40.0,
            nominal_um_per_px: 0.5,
            numerical_aperture: 0.65,
            immersion: Immersion::Air,
        };
        let half_um = 0.5 * 0.55 / 0.65f64.powi(2);
        let cone = 0.5 * 0.65f64.asin().tan();
        for (d, counts) in [
            (0.2, false),
            (0.4, false),
            (0.7, true),
            (2.0, true),
            (6.0, true),
        ] {
            let d: f64 = d;
            let variance_um2 = (cone * d * d).powi(2) / (d * d + half_um * half_um);
            let seen = |softer_px2: f64| Sharpness {
                softer_px2,
                sigma_px2: 0.005,
                ratio: 1.0,
                blocks: 60,
            };
            let blur = Blur::of(&seen(variance_um2 / 0.25), 0.5, &objective);
            assert!((blur.defocus_um - d).abs() < 1e-9, "{d}: {blur:?}");
            assert!(
                blur.surely_um < d && blur.counts() == counts,
                "{d}: {blur:?}"
            );
            let sharper = Blur::of(&seen(-variance_um2), 0.5, &objective);
            assert_eq!((sharper.defocus_um, sharper.counts()), (0.0, false));
        }
    }
}
