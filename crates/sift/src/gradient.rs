//! Gradients of a run of pixels in one row, in a form that compilers turn into vector instructions.

use std::f32::consts::{FRAC_PI_2, PI};

use crate::scale_space::Plane;

/// Pixels per run.
pub(crate) const RUN: usize = 16;

/// Values of one run.
pub(crate) type Run = [f32; RUN];

/// Angle of (x, y) from +x towards +y in `-pi..=pi`, within 2e-5 rad; 0 for (0, 0).
///
/// The arctangent on 0..=1 is the polynomial of Abramowitz & Stegun 4.4.49 (error below 1e-5).
#[inline(always)]
pub(crate) fn atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let t = low / (high + f32::MIN_POSITIVE);
    let q = t * t;
    let a =
        t * (0.999_866 + q * (-0.330_299_5 + q * (0.180_141 + q * (-0.085_133 + q * 0.020_835_1))));
    let a = if ax < ay { FRAC_PI_2 - a } else { a };
    let a = if x < 0.0 { PI - a } else { a };
    if y < 0.0 { -a } else { a }
}

/// Magnitude and angle of the central differences at the pixels `x..x + n` of row `y`, `n <= RUN`; what lies beyond `n` is 0.
///
/// All pixels must have four neighbours in `plane`.
#[inline(always)]
pub(crate) fn gradients(
    plane: &Plane,
    x: usize,
    y: usize,
    n: usize,
    magnitude: &mut Run,
    angle: &mut Run,
) {
    let (mut gx, mut gy) = ([0.0; RUN], [0.0; RUN]);
    let (above, here, below) = (
        &plane.row(y - 1)[x..x + n],
        &plane.row(y)[x - 1..x + n + 1],
        &plane.row(y + 1)[x..x + n],
    );
    for (i, g) in gx[..n].iter_mut().enumerate() {
        *g = here[i + 2] - here[i];
    }
    for ((g, b), a) in gy[..n].iter_mut().zip(below).zip(above) {
        *g = b - a;
    }
    for i in 0..RUN {
        magnitude[i] = (gx[i] * gx[i] + gy[i] * gy[i]).sqrt();
        angle[i] = atan2(gy[i], gx[i]);
    }
}

/// `x` as whole number i and rest `x - i` in 0..=1, for |x| below 2^21: a floor in two additions, except that a whole number
/// may come out as (x - 1, 1). Interpolation weights do not see the difference.
#[inline(always)]
pub(crate) fn split(x: f32) -> (i32, f32) {
    // Adding 1.5 * 2^23 rounds to whole numbers, which then stand in the low bits.
    const MAGIC: f32 = 12_582_912.0;
    let t = (x - 0.5) + MAGIC;
    (
        t.to_bits().wrapping_sub(MAGIC.to_bits()) as i32,
        x - (t - MAGIC),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn atan2_is_within_2e_5() {
        for i in 0..10_000 {
            let a = (i as f32 - 5000.0) / 5000.0 * PI;
            for r in [1e-6_f32, 0.3, 70.0] {
                let (y, x) = (r * a.sin(), r * a.cos());
                assert!((atan2(y, x) - y.atan2(x)).abs() < 2e-5, "{a}");
            }
        }
        assert_eq!(atan2(0.0, 0.0), 0.0);
    }

    #[test]
    fn split_adds_up() {
        for i in -4000..4000 {
            let x = i as f32 / 97.0;
            let (whole, rest) = split(x);
            assert!(
                (0.0..=1.0).contains(&rest) && whole as f32 + rest == x
                    || (whole as f32 + rest - x).abs() < 1e-6,
                "{x}"
            );
        }
    }

    #[test]
    fn gradient_of_a_ramp_points_uphill() {
        let plane = Plane {
            width: 9,
            height: 3,
            data: (0..27)
                .map(|i| 2.0 * (i % 9) as f32 + 2.0 * (i / 9) as f32)
                .collect(),
        };
        let (mut magnitude, mut angle) = ([0.0; RUN], [0.0; RUN]);
        gradients(&plane, 1, 1, 7, &mut magnitude, &mut angle);
        for i in 0..7 {
            assert!((magnitude[i] - 32.0_f32.sqrt()).abs() < 1e-5);
            assert!((angle[i] - PI / 4.0).abs() < 2e-5);
        }
        assert_eq!(magnitude[7], 0.0);
    }
}
