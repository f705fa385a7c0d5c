//! Beer-Lambert: how stain densities become colour.
//!
//! Optical densities (natural logarithm) add up, transmission is `exp(-density)`. The vectors lie near those that
//! Macenko et al. (ISBI 2009) find in H&E sections.

use super::noise::{ROUND, lesser};
use crate::specimen::GLASS;

/// Natural optical density of one unit of stain for red, green, blue.
const HEMATOXYLIN: [f32; 3] = [0.62, 0.84, 0.45];
const EOSIN: [f32; 3] = [0.085, 0.80, 0.40];
const BLOOD: [f32; 3] = [0.06, 1.10, 0.74];

/// Camera colours of a row of samples with these amounts of stain, none negative.
pub(super) fn colour_row(hematoxylin: &[f32], eosin: &[f32], blood: &[f32], rgb: &mut [u8]) {
    const PORTION: usize = 64;
    let portions = hematoxylin
        .chunks(PORTION)
        .zip(eosin.chunks(PORTION))
        .zip(blood.chunks(PORTION));
    for (((h, e), b), out) in portions.zip(rgb.chunks_mut(3 * PORTION)) {
        // Channel by channel and apart from the bytes, so that several samples are computed at once.
        let mut grey = [[0_u32; PORTION]; 3];
        for (c, grey) in grey.iter_mut().enumerate() {
            let (kh, ke, kb, glass) = (HEMATOXYLIN[c], EOSIN[c], BLOOD[c], f32::from(GLASS[c]));
            for (g, ((&h, &e), &b)) in grey.iter_mut().zip(h.iter().zip(e).zip(b)) {
                *g = (glass * exp_minus(h * kh + e * ke + b * kb) + ROUND).to_bits();
            }
        }
        let [red, green, blue] = grey;
        let channels = red.iter().zip(&green).zip(&blue);
        for (out, ((&r, &g), &b)) in out.as_chunks_mut::<3>().0.iter_mut().zip(channels) {
            // The low bytes: transmissions are 0..=255.
            *out = [r as u8, g as u8, b as u8];
        }
    }
}

/// `exp(-x)` for x >= 0 to 1e-5, in plain arithmetic.
#[inline(always)]
fn exp_minus(x: f32) -> f32 {
    let t = lesser(x * std::f32::consts::LOG2_E, 60.0);
    let rounded = t + ROUND;
    let f = (rounded - ROUND) - t;
    let whole = rounded.to_bits() - ROUND.to_bits();
    // 2^f on -1/2..1/2 by its Taylor polynomial.
    let p = 1.0
        + f * (std::f32::consts::LN_2
            + f * (0.240_226_5 + f * (0.055_504_1 + f * (0.009_618_1 + f * 0.001_333_4))));
    p * f32::from_bits((127 - whole) << 23)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_minus_is_the_exponential() {
        for k in 0..2000 {
            let x = k as f32 * 0.01;
            assert!((exp_minus(x) - (-x).exp()).abs() < 1e-5, "{x}");
        }
    }

    #[test]
    fn no_stain_is_glass_and_eosin_is_pink_and_hematoxylin_violet() {
        let mut rgb = [0; 9];
        colour_row(&[0.0, 0.0, 1.2], &[0.0, 1.0, 0.3], &[0.0; 3], &mut rgb);
        assert_eq!(rgb[..3], GLASS);
        let [r, g, b] = [rgb[3], rgb[4], rgb[5]];
        assert!(r > b && b > g);
        let [r, g, b] = [rgb[6], rgb[7], rgb[8]];
        assert!(b > r && r > g);
    }
}
