//! Beer-Lambert: how stain densities become colour.
//!
//! Optical densities (natural logarithm) add up, transmission is `exp(-density)`. The vectors lie near those that
//! Macenko et al. (ISBI 2009) find in H&E sections.

use crate::specimen::GLASS;

/// Natural optical density of one unit of stain for red, green, blue.
const HEMATOXYLIN: [f32; 3] = [0.66, 0.80, 0.42];
const EOSIN: [f32; 3] = [0.085, 0.80, 0.40];
const BLOOD: [f32; 3] = [0.05, 0.95, 0.80];

/// Camera colour of a sample with these amounts of stain.
#[inline]
pub(super) fn colour(hematoxylin: f32, eosin: f32, blood: f32) -> [u8; 3] {
    let mut rgb = [0; 3];
    for c in 0..3 {
        let density = hematoxylin * HEMATOXYLIN[c] + eosin * EOSIN[c] + blood * BLOOD[c];
        rgb[c] = (f32::from(GLASS[c]) * exp_minus(density) + 0.5) as u8;
    }
    rgb
}

/// `exp(-x)` for x >= 0 to 1e-4, in arithmetic that is the same everywhere and runs several at once.
#[inline]
fn exp_minus(x: f32) -> f32 {
    let t = (x * std::f32::consts::LOG2_E).clamp(0.0, 60.0);
    let whole = t as i32;
    let f = whole as f32 - t;
    // 2^f on -1..0: its Taylor polynomial.
    let p = 1.0
        + f * (std::f32::consts::LN_2
            + f * (0.240_227
                + f * (0.055_504 + f * (0.009_618 + f * (0.001_333 + f * 0.000_154)))));
    p * f32::from_bits(((127 - whole) as u32) << 23)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_minus_is_the_exponential() {
        for k in 0..2000 {
            let x = k as f32 * 0.01;
            assert!((exp_minus(x) - (-x).exp()).abs() < 1e-4, "{x}");
        }
    }

    #[test]
    fn no_stain_is_glass_and_eosin_is_pink_and_hematoxylin_violet() {
        assert_eq!(colour(0.0, 0.0, 0.0), GLASS);
        let [r, g, b] = colour(0.0, 1.0, 0.0);
        assert!(r > b && b > g);
        let [r, g, b] = colour(1.2, 0.3, 0.0);
        assert!(b > r && r > g);
    }
}
