//! Whether an image repeats itself: peaks of its autocorrelation, band-passed, windowed and normalised by the window's own
//! (Wiener-Khinchin).

use crate::likeness::Plane;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};
use scopeservo_features::GrayImage;
use scopeservo_geometry::Vec2;
use std::sync::Arc;

/// An image is like itself elsewhere when the autocorrelation there is at least this. Ordinary tissue reaches 0.44, lattices of 5 %
/// disorder 0.79.
const ALIKE: f64 = 0.5;
/// Peaks nearer than this are those of single things, pixels.
const SHORTEST_PX: f64 = 3.5;
/// Farther shifts leave so little of the window's overlap that noise makes peaks.
const LEAST_OVERLAP: f64 = 0.08;
/// A larger image is thinned out.
const MOST_PIXELS: usize = 1_500_000;
/// So many are told: the nearest.
const MOST: usize = 4;
/// A whole period makes the image as alike as any other does, to this share. Half of one does not, and neither does a way along the lines of
/// a grid of lines, where half of them stay.
const AS_ALIKE: f64 = 0.75;
/// On the way to a period the image is less alike, by this share of it. Along the lines of a grating it is not.
const DIP: f64 = 0.15;
/// Two directions are two when the sine between them is this.
const ACROSS: f64 = 0.35;

/// The shortest shifts, in pixels, under which the image looks like itself; of each and its opposite one is told. Empty for what does not
/// repeat.
pub fn periods(image: &GrayImage) -> Vec<Vec2> {
    let Some(likeness) = SelfLikeness::of(image) else {
        return Vec::new();
    };
    let every = likeness.every as f64;
    let nearest = likeness.peaks().into_iter().take(MOST);
    nearest.map(|p| p.shift.map(|v| v as f64 * every)).collect()
}

/// How alike an image is to itself, shifted by whole samples.
pub(crate) struct SelfLikeness {
    own: Vec<f64>,
    /// What the window has in common with itself, shifted along x and along y.
    overlap: [Vec<f64>; 2],
    /// Of what is padded.
    size: [usize; 2],
    /// Distance of two samples, pixels.
    pub(crate) every: usize,
}

/// A shift under which an image is more like itself than under those around.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Peak {
    /// x, y in samples.
    pub(crate) shift: [i64; 2],
    /// 1 for what is the same.
    pub(crate) height: f64,
}

impl SelfLikeness {
    /// `None` for an image too small to tell, or without anything in it.
    pub(crate) fn of(image: &GrayImage) -> Option<Self> {
        // Of a large image every second, third... pixel of the blurred one: memory grows with the square.
        let every = (1..)
            .find(|f| (image.width() / f) * (image.height() / f) <= MOST_PIXELS)
            .unwrap_or(1);
        let (width, height) = (image.width() / every, image.height() / every);
        if width < 16 || height < 16 {
            return None;
        }
        let values = Plane::thinned(image, every).into_values();
        let hann = |k: usize, n: usize| {
            0.5 - 0.5 * (std::f64::consts::TAU * (k as f64 + 0.5) / n as f64).cos()
        };
        let windows = [width, height].map(|n| (0..n).map(|k| hann(k, n)).collect::<Vec<f64>>());
        let window: Vec<f64> = (0..width * height)
            .map(|i| windows[0][i % width] * windows[1][i / width])
            .collect();
        let total: f64 = window.iter().sum();
        let mean = window
            .iter()
            .zip(&values)
            .map(|(w, &v)| w * f64::from(v))
            .sum::<f64>()
            / total;
        let weighted: Vec<f64> = window
            .iter()
            .zip(&values)
            .map(|(w, &v)| w * (f64::from(v) - mean))
            .collect();
        let own = autocorrelation(&weighted, [width, height]);
        (own[0] > 0.0).then_some(Self {
            own,
            overlap: windows.map(|w| overlap(&w)),
            size: [2 * width, 2 * height],
            every,
        })
    }

    /// Under a shift (x, y), x from -width to width, y from 0 on: the other half is its mirror image. Minus infinity where too little is left
    /// to compare.
    pub(crate) fn at(&self, x: i64, y: i64) -> f64 {
        let column = x.rem_euclid(self.size[0] as i64) as usize;
        let row = y.rem_euclid(self.size[1] as i64) as usize;
        let along = |k: usize, by: i64| self.overlap[k].get(by.unsigned_abs() as usize);
        let overlap = along(0, x).zip(along(1, y)).map_or(0.0, |(a, b)| a * b);
        match overlap >= LEAST_OVERLAP {
            true => self.own[row * self.size[0] + column] / self.own[0] / overlap,
            false => f64::NEG_INFINITY,
        }
    }

    /// The peaks up to half of the image's sides, the nearest first; of each and its opposite one.
    pub(crate) fn peaks(&self) -> Vec<Peak> {
        let [reach_x, reach_y] = self.size.map(|n| n as i64 / 4);
        let length = |[x, y]: [i64; 2]| f64::hypot(x as f64, y as f64);
        let mut peaks = Vec::new();
        for y in 0..reach_y {
            for x in -reach_x..reach_x {
                let height = self.at(x, y);
                if height < ALIKE || length([x, y]) < SHORTEST_PX || (y == 0 && x < 0) {
                    continue;
                }
                let around = (-1..=1).flat_map(|j| (-1..=1).map(move |i| (i, j)));
                let highest = around
                    .filter(|d| *d != (0, 0))
                    .all(|(i, j)| self.at(x + i, y + j) <= height);
                if highest {
                    peaks.push(Peak {
                        shift: [x, y],
                        height,
                    });
                }
            }
        }
        peaks.sort_by(|a, b| length(a.shift).total_cmp(&length(b.shift)));
        peaks
    }
}

impl SelfLikeness {
    /// The shortest whole periods that lie in different directions, px: two of a lattice, one of a grating, none of what does not repeat.
    pub(crate) fn shortest_periods(&self) -> Vec<Vec2> {
        let peaks = self.peaks();
        let highest = peaks.iter().map(|p| p.height).fold(0.0, f64::max);
        let whole = peaks.iter().filter(|p| p.height >= AS_ALIKE * highest);
        let mut periods = whole.filter(|p| self.dips(p));
        let Some(first) = periods.next() else {
            // Along the lines of a grating it is alike everywhere.
            return peaks
                .first()
                .map(|p| self.top(p.shift))
                .into_iter()
                .collect();
        };
        let across = |p: &&Peak| {
            let [[ax, ay], [bx, by]] = [first.shift, p.shift];
            let length = |x: i64, y: i64| f64::hypot(x as f64, y as f64);
            (ax * by - ay * bx).abs() as f64 > ACROSS * length(ax, ay) * length(bx, by)
        };
        // Beyond the next line of a grating the image is as alike as along this one.
        let second = periods.find(across).map(|p| self.without(p, first));
        let second = second.filter(|p| self.dips(p));
        let both = [Some(first.shift), second.map(|p| p.shift)];
        both.into_iter().flatten().map(|s| self.top(s)).collect()
    }

    /// A period without whole first ones.
    fn without(&self, period: &Peak, first: &Peak) -> Peak {
        let [a, b] = [first.shift, period.shift];
        let times = (a[0] * b[0] + a[1] * b[1]) as f64 / (a[0] * a[0] + a[1] * a[1]) as f64;
        let shift = [0, 1].map(|k| b[k] - times.round() as i64 * a[k]);
        let height = self.at(shift[0], shift[1]);
        Peak { shift, height }
    }

    /// Whether the image is less alike on the way to a peak.
    fn dips(&self, peak: &Peak) -> bool {
        let [x, y] = peak.shift.map(|v| v as f64);
        let on_the_way = (1..16).map(|k| {
            let share = f64::from(k) / 16.0;
            self.at((share * x).round() as i64, (share * y).round() as i64)
        });
        on_the_way.fold(f64::INFINITY, f64::min) < (1.0 - DIP) * peak.height
    }

    /// The top of a peak between samples, by a parabola along each axis; pixels.
    fn top(&self, [x, y]: [i64; 2]) -> Vec2 {
        let between = |before: f64, here: f64, after: f64| {
            let bend = before - 2.0 * here + after;
            match bend < 0.0 && bend.is_finite() {
                true => (0.5 * (before - after) / bend).clamp(-0.5, 0.5),
                false => 0.0,
            }
        };
        let here = self.at(x, y);
        let at = [
            x as f64 + between(self.at(x - 1, y), here, self.at(x + 1, y)),
            y as f64 + between(self.at(x, y - 1), here, self.at(x, y + 1)),
        ];
        at.map(|v| v * self.every as f64)
    }
}

/// The autocorrelation of a window, 1 for no shift.
fn overlap(window: &[f64]) -> Vec<f64> {
    let at = |shift: usize| -> f64 {
        let pairs = window.iter().zip(&window[shift..]);
        pairs.map(|(a, b)| a * b).sum()
    };
    (0..window.len()).map(|shift| at(shift) / at(0)).collect()
}

/// Of an image of `size`, padded by as much of nothing: no shift wraps around.
fn autocorrelation(values: &[f64], [width, height]: [usize; 2]) -> Vec<f64> {
    let (w, h) = (2 * width, 2 * height);
    let mut padded = vec![Complex::new(0.0, 0.0); w * h];
    for (row, line) in padded.chunks_exact_mut(w).zip(values.chunks_exact(width)) {
        for (out, v) in row.iter_mut().zip(line) {
            out.re = *v;
        }
    }
    let mut planner = FftPlanner::new();
    let along = [planner.plan_fft_forward(w), planner.plan_fft_forward(h)];
    transform(&mut padded, w, &along);
    for v in &mut padded {
        *v = Complex::new(v.norm_sqr(), 0.0);
    }
    // The spectrum is real and even: forward or backward is the same.
    transform(&mut padded, w, &along);
    let scale = 1.0 / (w * h) as f64;
    padded.into_iter().map(|v| v.re * scale).collect()
}

/// Along the rows, then down the columns.
fn transform(data: &mut [Complex<f64>], width: usize, [rows, columns]: &[Arc<dyn Fft<f64>>; 2]) {
    rows.process(data);
    let height = data.len() / width;
    let mut column = vec![Complex::new(0.0, 0.0); height];
    for x in 0..width {
        for (y, v) in column.iter_mut().enumerate() {
            *v = data[y * width + x];
        }
        columns.process(&mut column);
        for (y, v) in column.iter().enumerate() {
            data[y * width + x] = *v;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::SplitMix64;

    fn noisy(f: impl Fn(f64, f64) -> f64) -> GrayImage {
        let mut rng = SplitMix64::new(5);
        GrayImage::from_fn(320, 240, |x, y| {
            (f(x as f64, y as f64) + 0.02 * rng.normal()) as f32
        })
        .unwrap()
    }

    #[test]
    fn the_period_of_a_lattice_is_its_nearest_peak() {
        for pitch in [7.0, 31.0, 90.0] {
            let spot = |x: f64, y: f64| {
                let d = |v: f64| (v / pitch - (v / pitch).round()) * pitch;
                let r = f64::hypot(d(x), d(y)) / pitch;
                if r < 0.25 { 0.2 } else { 0.8 }
            };
            let found = periods(&noisy(spot));
            assert!(!found.is_empty(), "{pitch}");
            let length = f64::hypot(found[0][0], found[0][1]);
            assert!((length - pitch).abs() < 1.5, "{pitch}: {found:?}");
        }
    }

    #[test]
    fn what_does_not_repeat_has_no_period() {
        let mut rng = SplitMix64::new(3);
        let cells: Vec<[f64; 3]> = (0..120)
            .map(|_| {
                [
                    320.0 * rng.uniform(),
                    240.0 * rng.uniform(),
                    3.0 + 7.0 * rng.uniform(),
                ]
            })
            .collect();
        let tissue = |x: f64, y: f64| {
            let inside = |c: &&[f64; 3]| f64::hypot(x - c[0], y - c[1]) < c[2];
            0.8 - 0.1 * cells.iter().filter(inside).count() as f64
        };
        assert_eq!(periods(&noisy(tissue)), Vec::<Vec2>::new());
        assert_eq!(periods(&noisy(|_, _| 0.5)), Vec::<Vec2>::new());
        assert_eq!(
            periods(&GrayImage::from_fn(40, 30, |_, _| 0.5).unwrap()),
            Vec::<Vec2>::new()
        );
    }
}
