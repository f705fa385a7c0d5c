//! Magnitude and direction of gradients, eight at a time.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use fearless_simd::{Simd, f32x8, prelude::*};

/// Angles of (x, y) from +x towards +y in `0..=2 pi`, within 2e-5 rad; 0 for (0, 0).
///
/// The arctangent on 0..=1 is the polynomial of Abramowitz & Stegun 4.4.49 (error below 1e-5).
#[inline(always)]
pub(crate) fn angle<S: Simd>(s: S, x: f32x8<S>, y: f32x8<S>) -> f32x8<S> {
    const TERMS: [f32; 5] = [0.999_866, -0.330_299_5, 0.180_141, -0.085_133, 0.020_835_1];
    let (ax, ay) = (x.abs(), y.abs());
    let steep = ax.simd_lt(ay);
    let t = ax.min(ay) / (ax.max(ay) + f32::MIN_POSITIVE);
    let q = t * t;
    let mut sum = f32x8::splat(s, TERMS[4]);
    for k in [3, 2, 1, 0] {
        sum = sum.mul_add(q, f32x8::splat(s, TERMS[k]));
    }
    let a = t * sum;
    let a = steep.select(f32x8::splat(s, FRAC_PI_2) - a, a);
    let zero = f32x8::splat(s, 0.0);
    let a = x.simd_lt(zero).select(f32x8::splat(s, PI) - a, a);
    y.simd_lt(zero).select(f32x8::splat(s, TAU) - a, a)
}

/// `exp(x)` for x in -4.6..=0, within 1e-4 of itself: Taylor's series at x / 8, squared three times.
#[inline(always)]
pub(crate) fn exp<S: Simd>(s: S, x: f32x8<S>) -> f32x8<S> {
    let x = x * 0.125;
    let mut sum = f32x8::splat(s, 1.0 / 720.0);
    for term in [1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
        sum = sum.mul_add(x, f32x8::splat(s, term));
    }
    let square = sum * sum;
    let square = square * square;
    square * square
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Simd as Token;
    use crate::simd::at_level;

    #[test]
    fn angles_are_within_2e_5() {
        for token in Token::available() {
            for i in 0..10_000 {
                let a = (i as f32 + 0.5) / 10_000.0 * TAU;
                for r in [1e-6_f32, 0.3, 70.0] {
                    let found = at_level!(token, s => {
                        let (x, y) = (r * a.cos(), r * a.sin());
                        angle(s, f32x8::splat(s, x), f32x8::splat(s, y)).to_array()
                    });
                    assert!((found[3] - a).abs() < 2e-5, "{a} {found:?}");
                }
            }
            let zero = at_level!(token, s => {
                let zero = f32x8::splat(s, 0.0);
                angle(s, zero, zero).to_array()
            });
            assert_eq!(zero, [0.0; 8]);
        }
    }

    #[test]
    fn exponentials_are_within_1e_4() {
        for token in Token::available() {
            for i in 0..=460 {
                let x = -(i as f32) / 100.0;
                let found = at_level!(token, s => exp(s, f32x8::splat(s, x)).to_array());
                assert!((found[5] / x.exp() - 1.0).abs() < 1e-4, "{x}");
            }
        }
    }
}
