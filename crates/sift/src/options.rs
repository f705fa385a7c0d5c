//! The settings of the detector.

use serde::{Deserialize, Serialize};

use crate::SiftError;

/// Settings of [`detect_and_describe`](crate::detect_and_describe). Unknown keys are errors, missing keys take the default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// The N strongest features by response are kept, at least 1. Extrema are ranked before they are oriented; one with several
    /// dominant orientations gives several features.
    pub max_features: usize,
    /// Least |DoG| of an extremum times `intervals`, on an image with range 0..=1 (Lowe, IJCV 2004, section 4, has 0.03 times 3
    /// intervals, most later code 0.04). With `adapt_contrast` it is relative to the spread of the image.
    pub contrast_threshold: f32,
    /// Greatest ratio of the two principal curvatures (section 4.1); above 1.
    pub edge_ratio: f32,
    /// Scales per octave (section 3.1), 2 to 16.
    pub intervals: usize,
    /// Gaussian sigma of the first scale of each octave, in pixels of that octave (section 3.2); at most 16.
    pub sigma: f32,
    /// Gaussian sigma of the blur which the image already has, in its pixels (section 3.3).
    pub assumed_blur: f32,
    /// Where the search begins, -1 to 8: pixels of octave o are `2^o` image pixels. -1 starts from the image at twice its size
    /// (section 3.3): about four times the keypoints and the time of 0. A positive number leaves out the finest octaves, for a
    /// known ratio of scales that has no use for them.
    pub first_octave: i32,
    /// Scale the contrast threshold with the 1-99 % range of the image and raise it above the noise, so that a dim image gives
    /// the keypoints of the bright one.
    pub adapt_contrast: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_features: 2000,
            contrast_threshold: 0.04,
            edge_ratio: 10.0,
            intervals: 3,
            sigma: 1.6,
            assumed_blur: 0.5,
            first_octave: -1,
            adapt_contrast: true,
        }
    }
}

impl Options {
    /// Checks every field against its range.
    ///
    /// # Errors
    /// [`SiftError::Option`] names the first field that is outside.
    pub fn check(&self) -> Result<(), SiftError> {
        // The blur that the image already has, in pixels of the first octave that is built from it.
        let least_sigma =
            f64::from(self.assumed_blur) * if self.first_octave < 0 { 2.0 } else { 1.0 };
        let sigma = f64::from(self.sigma);
        let checks: [(bool, &'static str, f64, &'static str); 7] = [
            (
                self.max_features >= 1,
                "max_features",
                self.max_features as f64,
                "at least 1",
            ),
            (
                self.contrast_threshold.is_finite() && self.contrast_threshold >= 0.0,
                "contrast_threshold",
                f64::from(self.contrast_threshold),
                "finite and not negative",
            ),
            (
                self.edge_ratio.is_finite() && self.edge_ratio > 1.0,
                "edge_ratio",
                f64::from(self.edge_ratio),
                "finite and above 1",
            ),
            (
                (2..=16).contains(&self.intervals),
                "intervals",
                self.intervals as f64,
                "2 to 16",
            ),
            (
                self.assumed_blur.is_finite() && self.assumed_blur >= 0.0,
                "assumed_blur",
                f64::from(self.assumed_blur),
                "finite and not negative",
            ),
            (
                sigma > least_sigma && (0.5..=16.0).contains(&sigma),
                "sigma",
                sigma,
                "0.5 to 16 and above the assumed blur (above twice that when upsampling)",
            ),
            (
                (-1..=8).contains(&self.first_octave),
                "first_octave",
                f64::from(self.first_octave),
                "-1 (doubled image) to 8",
            ),
        ];
        match checks.into_iter().find(|(ok, ..)| !ok) {
            Some((_, name, value, need)) => Err(SiftError::Option { name, value, need }),
            None => Ok(()),
        }
    }

    /// Gaussian sigma at (fractional) layer `s` of an octave, in pixels of that octave.
    pub(crate) fn sigma_at(&self, s: f32) -> f32 {
        self.sigma * (s / self.intervals as f32).exp2()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_within_their_ranges() {
        Options::default().check().unwrap();
        assert_eq!(
            serde_json::from_str::<Options>("{}").unwrap(),
            Options::default()
        );
    }

    #[test]
    fn a_misspelt_key_is_an_error() {
        assert!(serde_json::from_str::<Options>(r#"{"max_feature": 10}"#).is_err());
    }

    #[test]
    fn each_bad_value_is_named() {
        let d = Options::default;
        for (bad, name) in [
            (
                Options {
                    max_features: 0,
                    ..d()
                },
                "max_features",
            ),
            (
                Options {
                    contrast_threshold: f32::NAN,
                    ..d()
                },
                "contrast_threshold",
            ),
            (
                Options {
                    edge_ratio: 1.0,
                    ..d()
                },
                "edge_ratio",
            ),
            (
                Options {
                    intervals: 1,
                    ..d()
                },
                "intervals",
            ),
            (
                Options {
                    intervals: 17,
                    ..d()
                },
                "intervals",
            ),
            (Options { sigma: 0.9, ..d() }, "sigma"),
            (
                Options {
                    sigma: f32::NAN,
                    ..d()
                },
                "sigma",
            ),
            (
                Options {
                    assumed_blur: -1.0,
                    ..d()
                },
                "assumed_blur",
            ),
        ] {
            assert!(
                matches!(bad.check(), Err(SiftError::Option { name: n, .. }) if n == name),
                "{name}"
            );
        }
    }
}
