//! Gaussian blur of rows: one pass down the columns, one along the row.
//!
//! Both passes work on [`BLOCK`] columns at a time with their sums in registers. Cost for a radius r, per pixel: `2 r + 1`
//! multiply-adds down and `r + 1` multiply-adds and r additions along.

use fearless_simd::{Simd, f32x16, prelude::*};

/// Columns per step of a pass: rows are computed in whole blocks, so buffers have this much room at their end.
pub(crate) const BLOCK: usize = 32;

/// A Gaussian of integer pixels, cut at 4 sigma (what is cut away is 6e-5 of the whole), with sum 1: the weight at distance i.
fn gaussian(sigma: f64) -> impl Fn(isize) -> f64 {
    let radius = radius(sigma) as isize;
    let weight = move |i: isize| (-0.5 * (i as f64 / sigma).powi(2)).exp();
    let sum: f64 = (-radius..=radius).map(weight).sum();
    move |i| {
        if i.abs() <= radius {
            weight(i) / sum
        } else {
            0.0
        }
    }
}

fn radius(sigma: f64) -> usize {
    (3.5 * sigma).ceil().max(1.0) as usize
}

/// A Gaussian blur.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Kernel {
    /// Weights of the rows `-radius..=radius + 1` for the row itself and for the one after it.
    pub(crate) rows: Vec<[f32; 2]>,
    /// Weights at the distances `0..=radius`.
    half: Vec<f32>,
}

impl Kernel {
    pub(crate) fn gaussian(sigma: f64) -> Self {
        let (weight, r) = (gaussian(sigma), radius(sigma) as isize);
        Self {
            rows: (-r..=r + 1)
                .map(|i| [weight(i) as f32, weight(i - 1) as f32])
                .collect(),
            half: (0..=r).map(|i| weight(i) as f32).collect(),
        }
    }

    pub(crate) fn radius(&self) -> usize {
        self.half.len() - 1
    }
}

/// A Gaussian blur of the doubled image, taken from the image itself.
///
/// Doubling interpolates linearly, so pixel i of the image reaches the doubled pixels `2 i - 1` to `2 i + 1` with weights 1/2, 1,
/// 1/2. What a doubled pixel receives from pixel i through interpolation and blur together is one number that depends on their
/// distance, and on whether the doubled pixel is even or odd: half as many columns and rows to add up, and no doubled image.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Doubling {
    /// Weights of the image rows `-radius..=radius` around j for the doubled rows 2 j and 2 j + 1.
    pub(crate) rows: Vec<[f32; 2]>,
    /// Weights of the image columns j + i, i in `0..=radius`: for column 2 j (the same at j - i), and for column 2 j + 1 (the same
    /// at j + 1 - i; nothing for i = 0).
    half: Vec<[f32; 2]>,
}

impl Doubling {
    /// `sigma` in pixels of the doubled image.
    pub(crate) fn gaussian(sigma: f64) -> Self {
        let weight = gaussian(sigma);
        let reach = move |i: isize, phase: isize| {
            let d = 2 * i - phase;
            weight(d) + 0.5 * (weight(d - 1) + weight(d + 1))
        };
        let r = (radius(sigma) as isize + 2) / 2;
        let both = |i: isize| [reach(i, 0) as f32, reach(i, 1) as f32];
        Self {
            rows: (-r..=r).map(both).collect(),
            half: (0..=r).map(both).collect(),
        }
    }

    pub(crate) fn radius(&self) -> usize {
        self.half.len() - 1
    }
}

/// Index in `0..n` of position `i` in a line of n pixels mirrored about its end pixels (`d c b | a b c d | c b a`).
#[inline]
pub(crate) fn mirrored(i: isize, n: usize) -> usize {
    let near = if i < 0 { -i } else { i } as usize;
    if near < n {
        return near;
    }
    if n == 1 {
        return 0;
    }
    let period = 2 * (n as isize - 1);
    let i = i.rem_euclid(period);
    i.min(period - i) as usize
}

/// 16 values from `at` on.
///
/// # Safety
/// `at + 16 <= data.len()`.
#[inline(always)]
#[expect(
    unsafe_code,
    reason = "a bounds check for each of few multiply-adds costs a fifth of a blur"
)]
unsafe fn load<S: Simd>(s: S, data: &[f32], at: usize) -> f32x16<S> {
    if cfg!(debug_assertions) {
        return f32x16::from_slice(s, &data[at..at + 16]);
    }
    // SAFETY: the caller's promise; an array of f32 is aligned as its elements are.
    let values = unsafe { &*data.as_ptr().add(at).cast::<[f32; 16]>() };
    f32x16::load_array_ref(s, values)
}

/// Two rows of sums down the columns, `width` columns rounded up to whole blocks: `first` with the first weight of each row,
/// `second` with the second.
///
/// `starts[i]` is where in `data` the row for `weights[i]` begins. Each row that is loaded serves both sums.
#[inline(always)]
#[expect(unsafe_code, reason = "see `load`")]
pub(crate) fn down<S: Simd>(
    s: S,
    weights: &[[f32; 2]],
    data: &[f32],
    starts: &[usize],
    width: usize,
    first: &mut [f32],
    second: &mut [f32],
) {
    let width = width.next_multiple_of(BLOCK);
    assert!(starts.iter().all(|start| start + width <= data.len()));
    let (first, second) = (&mut first[..width], &mut second[..width]);
    for (block, (first, second)) in first
        .chunks_exact_mut(BLOCK)
        .zip(second.chunks_exact_mut(BLOCK))
        .enumerate()
    {
        let x = block * BLOCK;
        let mut a = [f32x16::splat(s, 0.0); 2];
        let mut b = a;
        for (&[wa, wb], start) in weights.iter().zip(starts) {
            let (wa, wb) = (f32x16::splat(s, wa), f32x16::splat(s, wb));
            for k in 0..2 {
                // SAFETY: each start is at least `width` before the end, and `x + BLOCK` at most `width`.
                let v = unsafe { load(s, data, start + x + 16 * k) };
                a[k] = v.mul_add(wa, a[k]);
                b[k] = v.mul_add(wb, b[k]);
            }
        }
        for k in 0..2 {
            a[k].store_slice(&mut first[16 * k..16 * k + 16]);
            b[k].store_slice(&mut second[16 * k..16 * k + 16]);
        }
    }
}

/// A row blurred along itself: `out[x]` from `padded[x..=x + 2 radius]`, `width` columns rounded up to whole blocks.
#[inline(always)]
pub(crate) fn along<S: Simd>(s: S, kernel: &Kernel, padded: &[f32], width: usize, out: &mut [f32]) {
    // The radii of the default options are known to the compiler.
    match kernel.radius() {
        5 => along_by::<S, 5>(s, kernel, padded, width, out),
        6 => along_by::<S, 6>(s, kernel, padded, width, out),
        7 => along_by::<S, 7>(s, kernel, padded, width, out),
        9 => along_by::<S, 9>(s, kernel, padded, width, out),
        _ => along_by::<S, 0>(s, kernel, padded, width, out),
    }
}

/// With the radius `R`, or with any radius when that is 0.
#[inline(always)]
#[expect(unsafe_code, reason = "see `load`")]
fn along_by<S: Simd, const R: usize>(
    s: S,
    kernel: &Kernel,
    padded: &[f32],
    width: usize,
    out: &mut [f32],
) {
    let r = if R > 0 { R } else { kernel.radius() };
    let (half, width) = (&kernel.half[..=r], width.next_multiple_of(BLOCK));
    assert!(padded.len() >= width + 2 * r);
    for (block, out) in out[..width].chunks_exact_mut(BLOCK).enumerate() {
        let centre = block * BLOCK + r;
        let mut sum = [f32x16::splat(s, 0.0); 2];
        let weight = f32x16::splat(s, half[0]);
        for k in 0..2 {
            // SAFETY: `centre + BLOCK` is at most `width + r`.
            let v = unsafe { load(s, padded, centre + 16 * k) };
            sum[k] = v * weight;
        }
        for i in 1..=r {
            let weight = f32x16::splat(s, half[i]);
            for k in 0..2 {
                // SAFETY: i is at most r, so this lies within `width + 2 r` values.
                let (left, right) = unsafe {
                    (
                        load(s, padded, centre - i + 16 * k),
                        load(s, padded, centre + i + 16 * k),
                    )
                };
                sum[k] = (left + right).mul_add(weight, sum[k]);
            }
        }
        for k in 0..2 {
            sum[k].store_slice(&mut out[16 * k..16 * k + 16]);
        }
    }
}

/// A row doubled and blurred along itself: `out[2 x]` and `out[2 x + 1]` from `padded[x..=x + 2 radius]`, `width` columns of
/// `out` rounded up to whole blocks.
#[inline(always)]
pub(crate) fn along_doubled<S: Simd>(
    s: S,
    kernel: &Doubling,
    padded: &[f32],
    width: usize,
    out: &mut [f32],
) {
    // The radii of the default options are known to the compiler.
    match kernel.radius() {
        3 => along_doubled_by::<S, 3>(s, kernel, padded, width, out),
        4 => along_doubled_by::<S, 4>(s, kernel, padded, width, out),
        5 => along_doubled_by::<S, 5>(s, kernel, padded, width, out),
        6 => along_doubled_by::<S, 6>(s, kernel, padded, width, out),
        8 => along_doubled_by::<S, 8>(s, kernel, padded, width, out),
        _ => along_doubled_by::<S, 0>(s, kernel, padded, width, out),
    }
}

/// With the radius `R`, or with any radius when that is 0.
#[inline(always)]
#[expect(unsafe_code, reason = "see `load`")]
fn along_doubled_by<S: Simd, const R: usize>(
    s: S,
    kernel: &Doubling,
    padded: &[f32],
    width: usize,
    out: &mut [f32],
) {
    let r = if R > 0 { R } else { kernel.radius() };
    let (half, width) = (&kernel.half[..=r], width.next_multiple_of(BLOCK));
    assert!(padded.len() >= width / 2 + 2 * r);
    for (block, out) in out[..width].chunks_exact_mut(BLOCK).enumerate() {
        let centre = block * (BLOCK / 2) + r;
        // SAFETY: `centre + 16` is at most `width / 2 + r`.
        let mut right = unsafe { load(s, padded, centre) };
        let mut even = right * half[0][0];
        let mut odd = f32x16::splat(s, 0.0);
        let mut left = right;
        for i in 1..=r {
            let [weight_even, weight_odd] = half[i];
            // SAFETY: i is at most r, so these lie within `width / 2 + 2 r` values.
            right = unsafe { load(s, padded, centre + i) };
            odd = (left + right).mul_add(f32x16::splat(s, weight_odd), odd);
            left = unsafe { load(s, padded, centre - i) };
            even = (left + right).mul_add(f32x16::splat(s, weight_even), even);
        }
        let (low, high) = even.interleave(odd);
        low.store_slice(&mut out[..16]);
        high.store_slice(&mut out[16..]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirror_repeats_no_border_pixel() {
        let line: Vec<usize> = (-4..8).map(|i| mirrored(i, 4)).collect();
        assert_eq!(line, [2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1]);
        assert_eq!(mirrored(-3, 1), 0);
    }

    #[test]
    fn kernels_have_sum_1_in_every_phase() {
        for sigma in [0.2, 1.2, 3.1, 20.0] {
            let kernel = Kernel::gaussian(sigma);
            let doubling = Doubling::gaussian(sigma);
            for rows in [&kernel.rows, &doubling.rows] {
                for phase in 0..2 {
                    let sum: f32 = rows.iter().map(|w| w[phase]).sum();
                    assert!((sum - 1.0).abs() < 1e-6, "{sigma} {phase} {sum}");
                }
            }
            assert_eq!(kernel.rows.len(), 2 * kernel.radius() + 2);
            assert_eq!(doubling.rows.len(), 2 * doubling.radius() + 1);
        }
    }
}
