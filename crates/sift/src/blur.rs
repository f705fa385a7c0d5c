//! Gaussian blur of rows: one pass down the columns, one along the row.
//!
//! Both passes keep their sums in registers and add the two pixels of each distance before they multiply. Cost for a radius r, per
//! pixel and pass: `r + 1` multiply-adds and r additions.

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
    /// Weights at the distances `0..=radius`.
    half: Vec<f32>,
}

impl Kernel {
    pub(crate) fn gaussian(sigma: f64) -> Self {
        let (weight, r) = (gaussian(sigma), radius(sigma) as isize);
        Self {
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
    /// Weights of the image pixels j + i, i in `0..=radius`: for the doubled pixel 2 j (the same at j - i), and for the doubled pixel
    /// 2 j + 1 (the same at j + 1 - i; nothing for i = 0).
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
        Self {
            half: (0..=r)
                .map(|i| [reach(i, 0) as f32, reach(i, 1) as f32])
                .collect(),
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

/// A kernel as a function of its own: inlined into the sweep, with all the others, it runs out of registers.
#[inline(never)]
fn apart<S: Simd>(s: S, kernel: impl FnOnce()) {
    s.vectorize(kernel);
}

/// Calls `$by::<S, R>` with the kernel's radius R when that is one of the given, which are those of the default options and so known to
/// the compiler; `$any` with any other.
macro_rules! by_radius {
    ($s:ident, $kernel:ident, [$($r:literal)*], $by:ident, $any:path, $arguments:tt) => {
        match $kernel.radius() {
            $($r => apart($s, #[inline(always)] || $by::<S, $r> $arguments),)*
            _ => apart($s, #[inline(always)] || $any $arguments),
        }
    };
}

/// Two rows blurred down the columns, `width` columns rounded up to whole blocks.
///
/// `starts` says where in `data` the rows `-radius..=radius + 1` around the first begin. Each row that is loaded serves both.
#[inline(always)]
pub(crate) fn down<S: Simd>(
    s: S,
    kernel: &Kernel,
    data: &[f32],
    starts: &[usize],
    width: usize,
    out: [&mut [f32]; 2],
) {
    by_radius!(s, kernel, [5 6 7 9], down_by, down_by::<S, 0>, (s, kernel, data, starts, width, out));
}

/// With the radius `R`, or with any radius when that is 0.
#[inline(always)]
#[expect(unsafe_code, reason = "see `load`")]
fn down_by<S: Simd, const R: usize>(
    s: S,
    kernel: &Kernel,
    data: &[f32],
    starts: &[usize],
    width: usize,
    [first, second]: [&mut [f32]; 2],
) {
    let r = if R > 0 { R } else { kernel.radius() };
    let (half, starts) = (&kernel.half[..=r], &starts[..2 * r + 2]);
    let width = width.next_multiple_of(BLOCK);
    assert!(starts.iter().all(|start| start + width <= data.len()));
    for (block, (first, second)) in (first[..width].chunks_exact_mut(16))
        .zip(second[..width].chunks_exact_mut(16))
        .enumerate()
    {
        let x = 16 * block;
        // SAFETY: each start is at least `width` before the end, and `x + 16` at most `width`.
        let (mut above, mut below) = unsafe {
            (
                load(s, data, starts[r] + x),
                load(s, data, starts[r + 1] + x),
            )
        };
        let weight = f32x16::splat(s, half[0]);
        let (mut a, mut b) = (above * weight, below * weight);
        for i in 1..=r {
            let weight = f32x16::splat(s, half[i]);
            // SAFETY: as above.
            let (higher, lower) = unsafe {
                (
                    load(s, data, starts[r - i] + x),
                    load(s, data, starts[r + 1 + i] + x),
                )
            };
            a = (higher + below).mul_add(weight, a);
            b = (above + lower).mul_add(weight, b);
            (above, below) = (higher, lower);
        }
        a.store_slice(first);
        b.store_slice(second);
    }
}

/// Two rows doubled and blurred down the columns, `width` columns rounded up to whole blocks.
///
/// `starts` says where in `data` the rows `-radius..=radius` around the one begin that becomes two.
#[inline(always)]
pub(crate) fn down_doubled<S: Simd>(
    s: S,
    kernel: &Doubling,
    data: &[f32],
    starts: &[usize],
    width: usize,
    out: [&mut [f32]; 2],
) {
    by_radius!(s, kernel, [3 4 5 6 8], down_doubled_by, down_doubled_by::<S, 0>, (s, kernel, data, starts, width, out));
}

/// With the radius `R`, or with any radius when that is 0.
#[inline(always)]
#[expect(unsafe_code, reason = "see `load`")]
fn down_doubled_by<S: Simd, const R: usize>(
    s: S,
    kernel: &Doubling,
    data: &[f32],
    starts: &[usize],
    width: usize,
    [even, odd]: [&mut [f32]; 2],
) {
    let r = if R > 0 { R } else { kernel.radius() };
    let (half, starts) = (&kernel.half[..=r], &starts[..=2 * r]);
    let width = width.next_multiple_of(BLOCK);
    assert!(starts.iter().all(|start| start + width <= data.len()));
    for (block, (even, odd)) in (even[..width].chunks_exact_mut(BLOCK))
        .zip(odd[..width].chunks_exact_mut(BLOCK))
        .enumerate()
    {
        let x = block * BLOCK;
        let mut a = [f32x16::splat(s, 0.0); 2];
        let mut b = a;
        let mut above = a;
        for k in 0..2 {
            // SAFETY: each start is at least `width` before the end, and `x + BLOCK` at most `width`.
            above[k] = unsafe { load(s, data, starts[r] + x + 16 * k) };
            a[k] = above[k] * half[0][0];
        }
        for i in 1..=r {
            let [weight_even, weight_odd] = half[i];
            for k in 0..2 {
                // SAFETY: as above.
                let below = unsafe { load(s, data, starts[r + i] + x + 16 * k) };
                b[k] = (above[k] + below).mul_add(f32x16::splat(s, weight_odd), b[k]);
                above[k] = unsafe { load(s, data, starts[r - i] + x + 16 * k) };
                a[k] = (above[k] + below).mul_add(f32x16::splat(s, weight_even), a[k]);
            }
        }
        for k in 0..2 {
            a[k].store_slice(&mut even[16 * k..16 * k + 16]);
            b[k].store_slice(&mut odd[16 * k..16 * k + 16]);
        }
    }
}

/// Columns of a row, blurred down, that stand before the first that is blurred along: those of the widest kernel or more, in whole
/// lines of the cache.
pub(crate) fn lead(radius: usize) -> usize {
    radius.next_multiple_of(16)
}

/// Calls `$tap!(i)` for the distances 1 to `$r`, which is known to the compiler and at most 9.
macro_rules! taps {
    ($r:ident, $tap:ident) => { taps!($r, $tap, 1 2 3 4 5 6 7 8 9) };
    ($r:ident, $tap:ident, $($i:literal)*) => { $(if $r >= $i { $tap!($i); })* };
}

/// The values `$i` after those in `$here`, of which `$next` are the following ones.
///
/// A load that lies on two cache lines takes as long as three. Where a vector is as long as a line, that is every one, and the
/// values are put together from two that are here; shorter vectors are loaded, which leaves more registers.
macro_rules! after {
    ($s:ident, $row:ident, $at:expr, $i:literal, $here:ident, $next:ident) => {
        if <S::f32s as SimdBase<S>>::LEN >= 16 {
            $here.slide::<$i>($next)
        } else {
            // SAFETY: that of the caller.
            unsafe { load($s, $row, $at + $i) }
        }
    };
}

/// A row blurred along itself: `out[x]` from the columns `x - radius..=x + radius`, `width` columns rounded up to whole blocks.
///
/// Column x stands at `padded[lead(radius) + x]`.
#[inline(always)]
pub(crate) fn along<S: Simd>(s: S, kernel: &Kernel, padded: &[f32], width: usize, out: &mut [f32]) {
    by_radius!(s, kernel, [5 6 7 9], along_by, along_any, (s, kernel, padded, width, out));
}

/// With the radius `R`.
#[inline(always)]
#[expect(unsafe_code, reason = "see `load`")]
fn along_by<S: Simd, const R: usize>(
    s: S,
    kernel: &Kernel,
    padded: &[f32],
    width: usize,
    out: &mut [f32],
) {
    let (half, width) = (&kernel.half[..=R], width.next_multiple_of(BLOCK));
    assert!(padded.len() >= lead(R) + width + 16);
    // SAFETY: the row has more than two lines.
    let mut here = unsafe { load(s, padded, lead(R)) };
    for (block, out) in out[..width].chunks_exact_mut(16).enumerate() {
        let at = lead(R) + 16 * block;
        // SAFETY: `at + 32` is at most `lead + width + 16`, and R at most 16 and the lead.
        let next = unsafe { load(s, padded, at + 16) };
        let mut sum = here * half[0];
        macro_rules! tap {
            ($i:literal) => {
                // SAFETY: as above.
                let before = unsafe { load(s, padded, at - $i) };
                let after = here.slide::<$i>(next);
                sum = (before + after).mul_add(f32x16::splat(s, half[$i]), sum);
            };
        }
        taps!(R, tap);
        sum.store_slice(out);
        here = next;
    }
}

/// With any radius.
#[inline(always)]
#[expect(unsafe_code, reason = "see `load`")]
fn along_any<S: Simd>(s: S, kernel: &Kernel, padded: &[f32], width: usize, out: &mut [f32]) {
    let (r, width) = (kernel.radius(), width.next_multiple_of(BLOCK));
    assert!(padded.len() >= lead(r) + width + r);
    for (block, out) in out[..width].chunks_exact_mut(16).enumerate() {
        let at = lead(r) + 16 * block;
        // SAFETY: `at + 16` is at most `lead + width`, and what is taken from it or added at most r.
        let mut sum = unsafe { load(s, padded, at) } * kernel.half[0];
        for i in 1..=r {
            // SAFETY: as above.
            let (before, after) = unsafe { (load(s, padded, at - i), load(s, padded, at + i)) };
            sum = (before + after).mul_add(f32x16::splat(s, kernel.half[i]), sum);
        }
        sum.store_slice(out);
    }
}

/// A row doubled and blurred along itself: `out[2 x]` and `out[2 x + 1]` from the columns `x - radius..=x + radius`, `width` columns
/// of `out` rounded up to whole blocks.
///
/// Column x stands at `padded[lead(radius) + x]`.
#[inline(always)]
pub(crate) fn along_doubled<S: Simd>(
    s: S,
    kernel: &Doubling,
    padded: &[f32],
    width: usize,
    out: &mut [f32],
) {
    by_radius!(s, kernel, [3 4 5 6 8], along_doubled_by, along_doubled_any, (s, kernel, padded, width, out));
}

/// With the radius `R`.
#[inline(always)]
#[expect(unsafe_code, reason = "see `load`")]
fn along_doubled_by<S: Simd, const R: usize>(
    s: S,
    kernel: &Doubling,
    padded: &[f32],
    width: usize,
    out: &mut [f32],
) {
    let (half, width) = (&kernel.half[..=R], width.next_multiple_of(BLOCK));
    assert!(padded.len() >= lead(R) + width / 2 + 16);
    // SAFETY: the row has more than two lines.
    let mut here = unsafe { load(s, padded, lead(R)) };
    for (block, out) in out[..width].chunks_exact_mut(BLOCK).enumerate() {
        let at = lead(R) + 16 * block;
        // SAFETY: `at + 32` is at most `lead + width / 2 + 16`, and R at most 16 and the lead.
        let next = unsafe { load(s, padded, at + 16) };
        let mut even = here * half[0][0];
        let mut odd = f32x16::splat(s, 0.0);
        let mut before = here;
        macro_rules! tap {
            ($i:literal) => {
                let [weight_even, weight_odd] = half[$i];
                let after = after!(s, padded, at, $i, here, next);
                odd = (before + after).mul_add(f32x16::splat(s, weight_odd), odd);
                // SAFETY: as above.
                before = unsafe { load(s, padded, at - $i) };
                even = (before + after).mul_add(f32x16::splat(s, weight_even), even);
            };
        }
        taps!(R, tap);
        let (low, high) = even.interleave(odd);
        low.store_slice(&mut out[..16]);
        high.store_slice(&mut out[16..]);
        here = next;
    }
}

/// With any radius.
#[inline(always)]
#[expect(unsafe_code, reason = "see `load`")]
fn along_doubled_any<S: Simd>(
    s: S,
    kernel: &Doubling,
    padded: &[f32],
    width: usize,
    out: &mut [f32],
) {
    let (r, width) = (kernel.radius(), width.next_multiple_of(BLOCK));
    assert!(padded.len() >= lead(r) + width / 2 + r);
    for (block, out) in out[..width].chunks_exact_mut(BLOCK).enumerate() {
        let at = lead(r) + 16 * block;
        // SAFETY: `at + 16` is at most `lead + width / 2`, and what is taken from it or added at most r.
        let mut before = unsafe { load(s, padded, at) };
        let mut even = before * kernel.half[0][0];
        let mut odd = f32x16::splat(s, 0.0);
        for i in 1..=r {
            let [weight_even, weight_odd] = kernel.half[i];
            // SAFETY: as above.
            let after = unsafe { load(s, padded, at + i) };
            odd = (before + after).mul_add(f32x16::splat(s, weight_odd), odd);
            before = unsafe { load(s, padded, at - i) };
            even = (before + after).mul_add(f32x16::splat(s, weight_even), even);
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
            let sums = [
                2.0 * kernel.half.iter().sum::<f32>() - kernel.half[0],
                2.0 * doubling.half.iter().map(|w| w[0]).sum::<f32>() - doubling.half[0][0],
                2.0 * doubling.half[1..].iter().map(|w| w[1]).sum::<f32>(),
            ];
            for sum in sums {
                assert!((sum - 1.0).abs() < 1e-6, "{sigma} {sum}");
            }
        }
    }
}
