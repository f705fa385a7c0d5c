//! Gaussian scale space and its differences, one octave at a time (Lowe, IJCV 2004, section 3).
//!
//! Pixel grid: sample i of octave o lies at input coordinate `i * 2^o`, exactly. Doubling keeps every input pixel as an even
//! sample and puts averages between them, so `w` columns become `2 w - 1`; halving keeps the even samples. Nothing is shifted
//! by fractions of a pixel anywhere, and no correction is needed later.
//!
//! Borders are mirrored about the border pixel (`d c b | a b c d | c b a`). Cost of a blur with radius r: `2 (r + 1)`
//! multiplications and `4 r` additions per pixel, without an intermediate image: each output row is one vertical pass into a
//! row buffer that stays in the first cache, and one horizontal pass out of it.

use rayon::prelude::*;

use crate::{GrayImage, Options};

/// Octaves smaller than this on either side are not searched: nothing would be left inside the detector's border.
pub(crate) const MIN_OCTAVE_SIZE: usize = 12;

/// Rows per parallel task.
const TASK_ROWS: usize = 16;

/// Columns whose sums are kept in registers together.
const LANES: usize = 16;

/// A row-major plane of f32.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Plane {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) data: Vec<f32>,
}

impl Plane {
    fn zeros(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            data: vec![0.0; width * height],
        }
    }

    pub(crate) fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.width..][..self.width]
    }

    /// Every second pixel of every second row, starting with the first.
    fn decimated(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            data.extend(self.row(2 * y).iter().step_by(2));
        }
        Self {
            width,
            height,
            data,
        }
    }
}

/// The image at twice its sampling: output pixel (i, j) is the input at (i / 2, j / 2), linearly interpolated;
/// `w` x `h` gives `2 w - 1` x `2 h - 1`.
fn doubled(image: &GrayImage) -> Plane {
    let (w, h) = (image.width(), image.height());
    let mut out = Plane::zeros(2 * w - 1, 2 * h - 1);
    let row = |y: usize| &image.data()[y * w..][..w];
    out.data
        .par_chunks_mut(2 * w - 1)
        .enumerate()
        .with_min_len(TASK_ROWS)
        .for_each(|(j, out)| {
            let (a, b) = (row(j / 2), row(j.div_ceil(2)));
            let mut last = 0.5 * (a[0] + b[0]);
            out[0] = last;
            for ((pair, a), b) in out[1..].chunks_exact_mut(2).zip(&a[1..]).zip(&b[1..]) {
                let next = 0.5 * (a + b);
                pair[0] = 0.5 * (last + next);
                pair[1] = next;
                last = next;
            }
        });
    out
}

/// Half of a symmetric kernel with sum 1: `half[i]` is the weight at distance i.
#[derive(Debug, Clone)]
struct Kernel {
    half: Vec<f32>,
}

impl Kernel {
    /// Gaussian, cut at 4 sigma (what is cut away is 6e-5 of the whole).
    fn gaussian(sigma: f64) -> Self {
        let radius = (4.0 * sigma).ceil().max(1.0) as usize;
        let half: Vec<f64> = (0..=radius)
            .map(|i| (-0.5 * (i as f64 / sigma).powi(2)).exp())
            .collect();
        let sum = half[0] + 2.0 * half[1..].iter().sum::<f64>();
        Self {
            half: half.into_iter().map(|v| (v / sum) as f32).collect(),
        }
    }

    fn radius(&self) -> usize {
        self.half.len() - 1
    }
}

/// Index in `0..n` of position `i` in a line of n pixels mirrored about its end pixels.
fn mirrored(i: isize, n: usize) -> usize {
    if n == 1 {
        return 0;
    }
    let period = 2 * (n as isize - 1);
    let i = i.rem_euclid(period);
    i.min(period - i) as usize
}

/// `out[j] = half[0] * centre[x + j] + sum_i half[i] * (a_i[x + j] + b_i[x + j])` for j in `0..N`.
#[inline(always)]
fn weighted<'a, const N: usize>(
    half: &[f32],
    centre: &[f32],
    pairs: impl Iterator<Item = (&'a [f32], &'a [f32])>,
    out: &mut [f32],
) {
    let mut sum = [0.0_f32; N];
    for (s, c) in sum.iter_mut().zip(&centre[..N]) {
        *s = half[0] * c;
    }
    for (k, (a, b)) in half[1..].iter().zip(pairs) {
        let (a, b) = (&a[..N], &b[..N]);
        for j in 0..N {
            sum[j] += k * (a[j] + b[j]);
        }
    }
    out[..N].copy_from_slice(&sum);
}

/// Calls `block(x, true)` for blocks of [`LANES`] columns that cover `0..width` (the last one may overlap the one before), or
/// `block(x, false)` for single columns of a narrow plane. Every column is a sum of its own, so overlaps repeat it bit by bit.
#[inline(always)]
fn for_blocks(width: usize, mut block: impl FnMut(usize, bool)) {
    if width < LANES {
        (0..width).for_each(|x| block(x, false));
        return;
    }
    (0..width - LANES)
        .step_by(LANES)
        .for_each(|x| block(x, true));
    block(width - LANES, true);
}

/// Row `y` of `src` blurred along y, into `out`.
fn blur_row_vertically<'a>(
    src: &'a Plane,
    y: usize,
    kernel: &Kernel,
    pairs: &mut Vec<(&'a [f32], &'a [f32])>,
    out: &mut [f32],
) {
    let row = |i: isize| src.row(mirrored(i, src.height));
    pairs.clear();
    pairs
        .extend((1..=kernel.radius() as isize).map(|i| (row(y as isize - i), row(y as isize + i))));
    let centre = src.row(y);
    for_blocks(src.width, |x, wide| {
        let at = pairs.iter().map(|(a, b)| (&a[x..], &b[x..]));
        if wide {
            weighted::<LANES>(&kernel.half, &centre[x..], at, &mut out[x..]);
        } else {
            weighted::<1>(&kernel.half, &centre[x..], at, &mut out[x..]);
        }
    });
}

/// `padded` holds a row with `radius` free places on each side: fills them by mirroring and blurs along x, into `out`.
fn blur_row_horizontally(padded: &mut [f32], kernel: &Kernel, out: &mut [f32]) {
    let (w, r) = (out.len(), kernel.radius());
    for i in 1..=r {
        padded[r - i] = padded[r + mirrored(-(i as isize), w)];
        padded[r + w - 1 + i] = padded[r + mirrored((w - 1 + i) as isize, w)];
    }
    let padded = &padded[..w + 2 * r];
    for_blocks(w, |x, wide| {
        let at = (1..=r).map(|i| (&padded[x + r - i..], &padded[x + r + i..]));
        if wide {
            weighted::<LANES>(&kernel.half, &padded[x + r..], at, &mut out[x..]);
        } else {
            weighted::<1>(&kernel.half, &padded[x + r..], at, &mut out[x..]);
        }
    });
}

/// `src` blurred, and the blurred plane minus `src`.
fn blurred_with_difference(src: &Plane, kernel: &Kernel) -> (Plane, Plane) {
    let (w, r) = (src.width, kernel.radius());
    let mut out = Plane::zeros(w, src.height);
    let mut difference = Plane::zeros(w, src.height);
    let tasks = out
        .data
        .par_chunks_mut(w * TASK_ROWS)
        .zip(difference.data.par_chunks_mut(w * TASK_ROWS));
    tasks.enumerate().for_each(|(task, (out, difference))| {
        let mut padded = vec![0.0; w + 2 * r];
        let mut pairs = Vec::with_capacity(r);
        for (i, (out, difference)) in out
            .chunks_exact_mut(w)
            .zip(difference.chunks_exact_mut(w))
            .enumerate()
        {
            let y = task * TASK_ROWS + i;
            blur_row_vertically(src, y, kernel, &mut pairs, &mut padded[r..r + w]);
            blur_row_horizontally(&mut padded, kernel, out);
            for ((d, o), s) in difference.iter_mut().zip(&*out).zip(src.row(y)) {
                *d = o - s;
            }
        }
    });
    (out, difference)
}

/// One octave: `intervals + 3` Gaussian planes and the `intervals + 2` differences between neighbours.
#[derive(Debug)]
pub(crate) struct Octave {
    /// Octave index o: a pixel here is 2^o input pixels.
    pub(crate) index: i32,
    /// Plane s has sigma `options.sigma_at(s)` in pixels of this octave.
    pub(crate) gaussians: Vec<Plane>,
    /// Plane s is `gaussians[s + 1] - gaussians[s]`.
    pub(crate) differences: Vec<Plane>,
}

/// The octaves, finest first, each built when asked for.
pub(crate) struct Octaves {
    base: Plane,
    index: i32,
    steps: Vec<Kernel>,
}

impl Octaves {
    /// Blurs the (doubled) image to `options.sigma`. `options` are checked.
    pub(crate) fn new(image: &GrayImage, options: &Options) -> Self {
        let index = options.first_octave;
        let (raw, blur) = if options.first_octave < 0 {
            (doubled(image), 2.0 * f64::from(options.assumed_blur))
        } else {
            let plane = Plane {
                width: image.width(),
                height: image.height(),
                data: image.data().to_vec(),
            };
            (plane, f64::from(options.assumed_blur))
        };
        let sigma = f64::from(options.sigma);
        let sigma_at = |s: usize| sigma * (s as f64 / options.intervals as f64).exp2();
        let step = |from: f64, to: f64| Kernel::gaussian((to * to - from * from).sqrt());
        let steps = (1..options.intervals + 3)
            .map(|s| step(sigma_at(s - 1), sigma_at(s)))
            .collect();
        let mut base = if raw.width.min(raw.height) < MIN_OCTAVE_SIZE {
            raw
        } else {
            blurred_with_difference(&raw, &step(blur, sigma)).0
        };
        let octave = step(sigma, 2.0 * sigma);
        for _ in 0..index {
            if base.width.min(base.height) >= MIN_OCTAVE_SIZE {
                base = blurred_with_difference(&base, &octave).0.decimated();
            }
        }
        Self { base, index, steps }
    }
}

impl Iterator for Octaves {
    type Item = Octave;

    fn next(&mut self) -> Option<Octave> {
        if self.base.width.min(self.base.height) < MIN_OCTAVE_SIZE {
            return None;
        }
        let index = self.index;
        let mut gaussians = vec![std::mem::replace(&mut self.base, Plane::zeros(0, 0))];
        let mut differences = Vec::with_capacity(self.steps.len());
        for kernel in &self.steps {
            let (plane, difference) =
                blurred_with_difference(&gaussians[gaussians.len() - 1], kernel);
            gaussians.push(plane);
            differences.push(difference);
        }
        // Two planes before the last: twice the sigma of the first.
        self.base = gaussians[gaussians.len() - 3].decimated();
        self.index += 1;
        Some(Octave {
            index,
            gaussians,
            differences,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(w: usize, h: usize) -> GrayImage {
        GrayImage::from_fn(w, h, |x, y| 0.25 * x as f32 + 0.5 * y as f32).unwrap()
    }

    #[test]
    fn doubling_puts_sample_i_at_i_over_2() {
        for (w, h) in [(7, 5), (1, 4), (4, 1), (1, 1)] {
            let out = doubled(&ramp(w, h));
            assert_eq!((out.width, out.height), (2 * w - 1, 2 * h - 1));
            for j in 0..out.height {
                for i in 0..out.width {
                    assert_eq!(
                        out.row(j)[i],
                        0.25 * (i as f32 / 2.0) + 0.5 * (j as f32 / 2.0)
                    );
                }
            }
        }
    }

    #[test]
    fn decimation_undoes_doubling_exactly() {
        let image =
            GrayImage::from_fn(9, 6, |x, y| ((x * 31 + y * 17) % 23) as f32 / 23.0).unwrap();
        let back = doubled(&image).decimated();
        assert_eq!(
            (back.width, back.height, &back.data[..]),
            (9, 6, image.data())
        );
    }

    #[test]
    fn mirror_repeats_no_border_pixel() {
        let line: Vec<usize> = (-4..8).map(|i| mirrored(i, 4)).collect();
        assert_eq!(line, [2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1]);
        assert_eq!(mirrored(-3, 1), 0);
    }

    #[test]
    fn blur_equals_its_definition_at_every_width() {
        for (w, h) in [(1, 1), (3, 20), (15, 4), (16, 9), (17, 16), (41, 33)] {
            let src = Plane {
                width: w,
                height: h,
                data: (0..w * h)
                    .map(|i| ((i * 7919) % 101) as f32 / 101.0)
                    .collect(),
            };
            let kernel = Kernel::gaussian(1.3);
            let (out, difference) = blurred_with_difference(&src, &kernel);
            let k = |i: isize| f64::from(kernel.half[i.unsigned_abs()]);
            let r = kernel.radius() as isize;
            for y in 0..h {
                for x in 0..w {
                    let mut sum = 0.0;
                    for j in -r..=r {
                        for i in -r..=r {
                            let v =
                                src.row(mirrored(y as isize + j, h))[mirrored(x as isize + i, w)];
                            sum += k(i) * k(j) * f64::from(v);
                        }
                    }
                    assert!(
                        (f64::from(out.row(y)[x]) - sum).abs() < 1e-6,
                        "({x}, {y}) of {w} x {h}"
                    );
                    assert_eq!(difference.row(y)[x], out.row(y)[x] - src.row(y)[x]);
                }
            }
        }
    }

    #[test]
    fn octaves_halve_until_nothing_is_left_to_search() {
        let sizes: Vec<_> = Octaves::new(&ramp(50, 40), &Options::default())
            .map(|o| {
                (
                    o.index,
                    o.gaussians[0].width,
                    o.gaussians[0].height,
                    o.gaussians.len(),
                    o.differences.len(),
                )
            })
            .collect();
        assert_eq!(
            sizes,
            [(-1, 99, 79, 6, 5), (0, 50, 40, 6, 5), (1, 25, 20, 6, 5)]
        );
        assert_eq!(Octaves::new(&ramp(5, 900), &Options::default()).count(), 0);
    }
}
