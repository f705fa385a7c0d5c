//! A grey image as a smooth surface: its pixels are the coefficients of a cubic B-spline.
//!
//! That is the image under a blur of variance 1/3 px^2 along each axis, twice continuously differentiable, and the same blur whether it is
//! asked on a pixel or between. Two images that are compared this way need no blur before, and sampling one of them between its pixels
//! favours no shift.

use crate::likeness::Plane;
use scopeservo_features::GrayImage;
use scopeservo_geometry::Vec2;
use std::borrow::Cow;

/// A place reaches so far along each axis, pixels.
pub(super) const REACH_PX: f64 = 2.0;

/// Least share of the pixels at one end of the range that a clipped image has there.
const CLIPPED_SHARE: f64 = 0.002;

/// Steps of an image of 8 bits, and how near to them its values are.
const LEVELS: f32 = 255.0;
const LEVEL_SLACK: f32 = 1e-3;

/// An image between its pixels. Integer coordinates are pixel centres.
pub(super) struct Surface<'a> {
    width: usize,
    height: usize,
    data: Cow<'a, [f32]>,
    /// The image as it is, and how much it was blurred besides.
    raw: &'a [f32],
    blur_px: f64,
    /// What is not between these is clipped.
    range: [f32; 2],
}

impl<'a> Surface<'a> {
    pub(super) fn of(image: &'a GrayImage) -> Self {
        Self {
            width: image.width(),
            height: image.height(),
            data: Cow::Borrowed(image.data()),
            raw: image.data(),
            blur_px: 0.0,
            range: range(image.data()),
        }
    }

    /// Under a Gaussian blur besides, of this standard deviation in pixels.
    pub(super) fn blurred(image: &'a GrayImage, sigma_px: f64) -> Self {
        let sharp = Self::of(image);
        if sigma_px < 0.1 {
            return sharp;
        }
        Self {
            data: Cow::Owned(Plane::new(image, sigma_px).into_values()),
            blur_px: sigma_px,
            ..sharp
        }
    }

    pub(super) fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Whether the surface is known at a place.
    pub(super) fn holds(&self, p: Vec2) -> bool {
        let within = |v: f64, side: usize| v >= REACH_PX && v + REACH_PX < side as f64 - 1.0;
        within(p[0], self.width) && within(p[1], self.height)
    }

    /// The values along a straight way, all of whose places it [`holds`](Self::holds).
    pub(super) fn along(&self, from: Vec2, step: Vec2, values: &mut [f32]) {
        // In 2^-32 pixels: whole pixels and what is left come apart without rounding.
        const ONE: f64 = 4_294_967_296.0;
        let [mut x, mut y] = from.map(|v| (v * ONE) as i64);
        let [dx, dy] = step.map(|v| (v * ONE) as i64);
        for value in values {
            let first = ((y >> 32) - 1) as usize * self.width + ((x >> 32) - 1) as usize;
            let across = weights(fraction(x));
            let down = weights(fraction(y));
            let mut sum = 0.0;
            for (j, w) in down.iter().enumerate() {
                if let Some(row) = self.data[first + j * self.width..].first_chunk::<4>() {
                    let [a, b, c, d] = *row;
                    sum += w * ((across[0] * a + across[1] * b) + (across[2] * c + across[3] * d));
                }
            }
            *value = sum;
            (x, y) = (x + dx, y + dy);
        }
    }

    /// Whether a value is at an end of the range of an image that is clipped there.
    pub(super) fn is_clipped(&self, value: f32) -> bool {
        value <= self.range[0] || value >= self.range[1]
    }

    /// Value and gradient on a pixel that is not at the edge.
    pub(super) fn on_pixel(&self, x: usize, y: usize) -> [f32; 3] {
        let first = (y - 1) * self.width + x - 1;
        let row = |j: usize| &self.data[first + j * self.width..][..3];
        let (a, b, c) = (row(0), row(1), row(2));
        let smooth = |r: &[f32]| (r[0] + 4.0 * r[1] + r[2]) / 6.0;
        let slope = |r: &[f32]| (r[2] - r[0]) / 2.0;
        [
            (smooth(a) + 4.0 * smooth(b) + smooth(c)) / 6.0,
            (slope(a) + 4.0 * slope(b) + slope(c)) / 6.0,
            (smooth(c) - smooth(a)) / 2.0,
        ]
    }

    /// What noise alone does to the sum of the squared gradient's components, by the median of second differences of the image as it is:
    /// structure is rarely everywhere. What is clipped all round shows none. It is no less than what the steps of an image of 8 bits make.
    pub(super) fn noise_of_gradient(&self) -> f64 {
        // Every seventh pixel is enough, at most so many.
        const MOST: usize = 20_000;
        let w = self.width;
        if w < 4 || self.height < 4 {
            return 0.0;
        }
        let inner = (w - 2) * (self.height - 2);
        let step = (inner / MOST).max(1) | 1;
        let mut in_steps = true;
        let mut all: Vec<f32> = (0..inner)
            .step_by(step)
            .filter_map(|i| {
                let k = (1 + i / (w - 2)) * w + 1 + i % (w - 2);
                let v = |k: usize| self.raw[k];
                let level = v(k) * LEVELS;
                in_steps &= (level - level.round()).abs() < LEVEL_SLACK;
                let mut around = [
                    k - w - 1,
                    k - w,
                    k - w + 1,
                    k - 1,
                    k,
                    k + 1,
                    k + w - 1,
                    k + w,
                    k + w + 1,
                ]
                .into_iter();
                if around.all(|k| self.is_clipped(v(k))) {
                    return None;
                }
                // Blind to slopes and to curvature along an axis: (Immerkaer, 1996).
                let corners = v(k - w - 1) + v(k - w + 1) + v(k + w - 1) + v(k + w + 1);
                let sides = v(k - 1) + v(k + 1) + v(k - w) + v(k + w);
                Some((corners - 2.0 * sides + 4.0 * v(k)).abs())
            })
            .collect();
        let middle = all.len() / 2;
        let median = match all.is_empty() {
            true => 0.0,
            false => *all.select_nth_unstable_by(middle, f32::total_cmp).1,
        };
        let steps = if in_steps {
            f64::from(LEVELS).recip() / 12f64.sqrt()
        } else {
            0.0
        };
        let sigma = (f64::from(median) * 1.4826 / 6.0).max(steps);
        // White noise under a Gaussian of variance s^2: each component has 1/(8 pi s^4) of its variance. A quarter under the spline alone,
        // which is as much as under s^2 = 0.4.
        let s_sq = self.blur_px * self.blur_px + 0.4;
        2.0 * sigma * sigma / (8.0 * std::f64::consts::PI * s_sq * s_sq)
    }
}

/// What lies after the whole pixels, from 2^-32 pixels.
fn fraction(v: i64) -> f32 {
    ((v as u32) >> 8) as i32 as f32 * (1.0 / 16_777_216.0)
}

/// The four weights of a cubic B-spline, for a place this far after a pixel.
fn weights(f: f32) -> [f32; 4] {
    let g = 1.0 - f;
    let (f2, g2) = (f * f, g * g);
    [
        g2 * g / 6.0,
        (4.0 - 6.0 * f2 + 3.0 * f2 * f) / 6.0,
        (4.0 - 6.0 * g2 + 3.0 * g2 * g) / 6.0,
        f2 * f / 6.0,
    ]
}

/// The range of an image, open where nothing shows that it is clipped: of so many pixels at most.
fn range(data: &[f32]) -> [f32; 2] {
    const MOST: usize = 40_000;
    let some = || data.iter().step_by((data.len() / MOST).max(1) | 1);
    let (mut low, mut high, mut count) = (f32::INFINITY, f32::NEG_INFINITY, 0usize);
    for &v in some() {
        low = if v < low { v } else { low };
        high = if v > high { v } else { high };
        count += 1;
    }
    let least = CLIPPED_SHARE * count as f64;
    let clipped = |end: f32| some().filter(|&&v| v == end).count() as f64 > least;
    [
        if clipped(low) { low } else { f32::NEG_INFINITY },
        if clipped(high) { high } else { f32::INFINITY },
    ]
}
