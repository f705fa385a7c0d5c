//! What is known of the transform before looking.

use scopeservo_features::{Gate, Keypoint};
use scopeservo_geometry::Affine2;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// How far the scale of two matched keypoints may be from the scale of the whole image: factor. SIFT's scales
/// scatter by one step of its scale space (1.26) at most in nearly all true matches.
const KEYPOINT_SCALE_SLACK: f64 = 1.6;
/// How far the angle of two matched keypoints may be from the rotation of the whole image.
const KEYPOINT_ANGLE_SLACK_RAD: f64 = 0.4;

/// How two keypoints lie: sigma in the view and in the target, pixels; angle in the view and in the target, radians.
pub type Shapes = [f64; 4];

/// Lengths in the target over lengths in the view.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScalePrior {
    /// Target pixels per view pixel.
    pub ratio: f64,
    /// Relative tolerance, also for the difference between the two axes.
    pub tolerance: f64,
}

/// Rotation from view to target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RotationPrior {
    /// Expected angle, radians, +x towards +y.
    pub angle_rad: f64,
    /// Half-width of the interval.
    pub tolerance_rad: f64,
}

/// What a calibration tells of the transform before the images are looked at.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Prior {
    /// The scale, if known.
    pub scale: Option<ScalePrior>,
    /// The rotation, if known.
    pub rotation: Option<RotationPrior>,
    /// The image moved on the sensor by more than this: what lies nearer to where it was, pixels, is fixed to the camera.
    pub moved_px: Option<f64>,
}

impl Prior {
    /// Which keypoints of view and target may show the same thing.
    pub(crate) fn gate(&self) -> Gate {
        Gate {
            sigma_ratio: self.scale.map(|s| {
                let slack = KEYPOINT_SCALE_SLACK * (1.0 + s.tolerance);
                ((s.ratio / slack) as f32, (s.ratio * slack) as f32)
            }),
            turn_rad: self.rotation.map(|r| {
                let off = r.tolerance_rad + KEYPOINT_ANGLE_SLACK_RAD;
                (wrap(r.angle_rad) as f32, off as f32)
            }),
            same_polarity: true,
        }
    }

    /// Whether a pair may show the specimen, and not what is fixed to the camera.
    pub(crate) fn has_moved(&self, view: &Keypoint, target: &Keypoint) -> bool {
        self.moved_px
            .is_none_or(|least| f64::from(f32::hypot(view.x - target.x, view.y - target.y)) > least)
    }

    /// Whether a transform is one that a microscope at this prior can produce: no mirror (SIFT cannot match one), no
    /// collapse, both axes within the tolerance of the scale.
    pub(crate) fn allows(&self, target_from_view: &Affine2) -> bool {
        let linear = target_from_view.linear;
        let Some(angle) = linear.rotation_angle() else {
            return false;
        };
        let s = linear.svd().s;
        let scale_fits = match self.scale {
            Some(p) => s.iter().all(|s| (s / p.ratio - 1.0).abs() <= p.tolerance),
            None => s[1] > 0.05 && s[0] < 20.0 && s[0] / s[1] < 1.15,
        };
        scale_fits
            && self
                .rotation
                .is_none_or(|r| wrap(angle - r.angle_rad).abs() <= r.tolerance_rad)
    }

    /// The share of random keypoint pairs, among those this prior admits, that still agree in angle and scale with
    /// one transform: the part of the chance that does not come from position.
    pub(crate) fn chance_of_coherence(&self) -> f64 {
        let free_half_width = self
            .rotation
            .map_or(PI, |r| (r.tolerance_rad + KEYPOINT_ANGLE_SLACK_RAD).min(PI));
        (KEYPOINT_ANGLE_SLACK_RAD / free_half_width).min(1.0)
    }
}

/// The test whether two keypoints turn as `transform` does, and scale as it does. Angles lie in (-pi, pi].
pub(crate) fn coherence(transform: &Affine2) -> impl Fn(&Shapes) -> bool + use<> {
    // Nothing turns as a mirror does: nothing compares with NaN.
    let angle = transform.linear.rotation_angle().unwrap_or(f64::NAN);
    let scale = transform.linear.det().sqrt();
    move |&[view_sigma, target_sigma, view_angle, target_angle]| {
        let turn = (target_angle - view_angle - angle).abs();
        let turn = (turn - TAU).abs().min(turn).min((turn - 2.0 * TAU).abs());
        let ratio = target_sigma / (view_sigma * scale);
        turn < KEYPOINT_ANGLE_SLACK_RAD
            && ratio < KEYPOINT_SCALE_SLACK
            && ratio > 1.0 / KEYPOINT_SCALE_SLACK
    }
}

/// An angle in (-pi, pi].
pub(crate) fn wrap(angle: f64) -> f64 {
    let a = angle.rem_euclid(TAU);
    if a > PI { a - TAU } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::{Mat2, Similarity};

    fn keypoint(sigma: f32, angle: f32) -> Keypoint {
        Keypoint {
            x: 0.0,
            y: 0.0,
            sigma,
            angle,
            response: 1.0,
            bright: true,
            octave: 0,
            layer: 1,
        }
    }

    #[test]
    fn the_prior_admits_what_the_scale_and_angle_allow() {
        let prior = Prior {
            scale: Some(ScalePrior {
                ratio: 4.0,
                tolerance: 0.05,
            }),
            rotation: Some(RotationPrior {
                angle_rad: 3.1,
                tolerance_rad: 0.1,
            }),
            ..Prior::default()
        };
        let gate = prior.gate();
        // 3.1 rad and -3.1 rad are neighbours across the wrap.
        assert!(gate.admits(&keypoint(2.0, 0.0), &keypoint(8.5, -3.1)));
        assert!(gate.admits(&keypoint(2.0, 3.1), &keypoint(8.5, 0.0)));
        assert!(gate.admits(&keypoint(2.0, -3.1), &keypoint(8.5, 0.0)));
        assert!(!gate.admits(&keypoint(2.0, 0.0), &keypoint(8.5, 1.0)));
        assert!(!gate.admits(&keypoint(2.0, 0.0), &keypoint(2.0, 3.1)));
        let open = Prior::default().gate();
        assert!(open.admits(&keypoint(1.0, 0.0), &keypoint(50.0, 2.0)));
    }

    #[test]
    fn mirrors_and_collapses_are_not_allowed() {
        let prior = Prior::default();
        let ok = Affine2::from(Similarity {
            scale: 2.0,
            angle_rad: 2.0,
            offset: [0.0; 2],
        });
        assert!(prior.allows(&ok));
        for linear in [
            Mat2::diagonal(1.0, -1.0),
            Mat2::diagonal(1.0, 0.0),
            Mat2::diagonal(1e-3, 1e-3),
            Mat2::diagonal(1.0, 0.5),
        ] {
            assert!(!prior.allows(&Affine2 {
                linear,
                offset: [0.0; 2]
            }));
        }
    }

    #[test]
    fn keypoints_that_turn_and_scale_as_the_transform_are_coherent() {
        let turned = |angle_rad: f64| {
            coherence(&Affine2::from(Similarity {
                scale: 2.0,
                angle_rad,
                offset: [0.0; 2],
            }))
        };
        for angle in [-3.1f64, -0.5, 0.0, 2.9] {
            for view in [-3.1f64, 0.3, 3.1] {
                let target = wrap(view + angle);
                assert!(turned(angle)(&[2.0, 4.5, view, target]));
                let off = wrap(view + angle + 0.5);
                assert!(!turned(angle)(&[2.0, 4.5, view, off]));
                assert!(!turned(angle)(&[2.0, 2.0, view, target]));
            }
        }
        let mirror = Affine2 {
            linear: Mat2::diagonal(1.0, -1.0),
            offset: [0.0; 2],
        };
        assert!(!coherence(&mirror)(&[2.0, 2.0, 0.0, 0.0]));
    }

    #[test]
    fn a_known_rotation_leaves_less_to_chance() {
        let free = Prior::default().chance_of_coherence();
        assert!((free - KEYPOINT_ANGLE_SLACK_RAD / PI).abs() < 1e-12);
        let known = Prior {
            scale: None,
            rotation: Some(RotationPrior {
                angle_rad: 0.0,
                tolerance_rad: 0.0,
            }),
            ..Prior::default()
        };
        assert_eq!(known.chance_of_coherence(), 1.0);
    }
}
