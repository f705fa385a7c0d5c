//! Where one cell lies: by the phases of its two fundamental waves, taken over exactly one period of each.
//!
//! Over a whole period all other waves of what repeats itself vanish, whatever its shape. The middle of a cell is where it is darkest; of a
//! bright pattern that lies between two of its cells, which is as good.

use super::light::Light;
use super::model::Model;
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Mat2, Vec2};
use std::f64::consts::TAU;

/// What one cell shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cell {
    pub(super) mean: f64,
    /// Real and imaginary part of the wave along the first and the second period, negative: 1 is as bright as the cell is on average.
    pub(super) waves: [Vec2; 2],
}

impl Cell {
    /// How far the cell is from where it was looked for, in periods, each from -1/2 to 1/2.
    pub(super) fn off(&self) -> Vec2 {
        self.waves.map(|[re, im]| -im.atan2(re) / TAU)
    }

    pub(super) fn amplitudes(&self) -> Vec2 {
        self.waves.map(|[re, im]| re.hypot(im))
    }
}

/// An image in which cells are looked for.
pub(super) struct Flat {
    width: usize,
    height: usize,
    values: Vec<f64>,
}

impl Flat {
    /// An image divided by its light.
    pub(super) fn new(image: &GrayImage, light: &Light) -> Self {
        let (width, height) = (image.width(), image.height());
        let [cx, cy] = centre(width, height);
        let rows = image.data().chunks_exact(width).enumerate();
        let values = rows.flat_map(|(y, row)| {
            let light = light.along(y as f64 - cy);
            let lit = row.iter().enumerate();
            lit.map(move |(x, v)| f64::from(*v) / light(x as f64 - cx))
        });
        Self {
            width,
            height,
            values: values.collect(),
        }
    }

    /// Half the width and height of what lies around a cell, px.
    fn half(local: &Mat2) -> Vec2 {
        local.0.map(|[a, b]| 0.5 * (a.abs() + b.abs()) + 1.5)
    }

    /// Whether the cell lies in the image whole.
    pub(super) fn holds(&self, model: &Model, n: Vec2) -> bool {
        let (p, half) = (model.seen(n), Self::half(&model.local(n)));
        let centre = centre(self.width, self.height);
        (0..2).all(|k| p[k].abs() + half[k] <= centre[k])
    }

    /// One period around where the model says that `n` lies, a cell or half-way between two. It must lie in the image whole.
    pub(super) fn cell(&self, model: &Model, n: Vec2) -> Option<Cell> {
        let (p, local) = (model.seen(n), model.local(n));
        let inverse = local.inverse()?;
        let (half, [cx, cy]) = (Self::half(&local), centre(self.width, self.height));
        // Periods per pixel across each side: a pixel that lies over the side counts by its share.
        let [across_u, across_v] = inverse.0.map(|[a, b]| a.hypot(b));
        let share = |at: f64, across: f64| ((0.5 - at.abs()) / across + 0.5).clamp(0.0, 1.0);
        let [columns, rows] = [(p[0] + cx, half[0]), (p[1] + cy, half[1])]
            .map(|(at, half)| (at - half).ceil() as usize..=(at + half).floor() as usize);
        let (mut total, mut sum) = (0.0, 0.0);
        // Of the image and of the window alone, so that the mean can be taken off afterwards.
        let (mut waves, mut of_window) = ([[0.0; 2]; 2], [[0.0; 2]; 2]);
        // From a pixel to the next of a row the phases go on by the same.
        let onwards = [0, 1].map(|k| turned(TAU * inverse.0[k][0]));
        for y in rows {
            let from = *columns.start();
            let [mut u, mut v] = inverse * [from as f64 - cx - p[0], y as f64 - cy - p[1]];
            let mut phases = [turned(TAU * u), turned(TAU * v)];
            for value in &self.values[y * self.width..][columns.clone()] {
                let weight = share(u, across_u) * share(v, across_v);
                if weight > 0.0 {
                    total += weight;
                    sum += weight * value;
                    for (k, phase) in phases.iter().enumerate() {
                        for (i, part) in phase.iter().enumerate() {
                            waves[k][i] += weight * value * part;
                            of_window[k][i] += weight * part;
                        }
                    }
                }
                (u, v) = (u + inverse.0[0][0], v + inverse.0[1][0]);
                phases = [0, 1].map(|k| times(phases[k], onwards[k]));
            }
        }
        let mean = sum / total;
        // A window half a period on sees the wave the other way up.
        let sign = n.map(|v| (TAU * v).cos().signum());
        let wave =
            |k: usize| [0, 1].map(|i| sign[k] * (mean * of_window[k][i] - waves[k][i]) / sum);
        (mean > 0.0).then(|| Cell {
            mean,
            waves: [wave(0), wave(1)],
        })
    }
}

/// Cosine, and less the sine.
fn turned(by: f64) -> Vec2 {
    let (s, c) = by.sin_cos();
    [c, -s]
}

/// The product of two complex numbers.
fn times([a, b]: Vec2, [c, d]: Vec2) -> Vec2 {
    [a * c - b * d, a * d + b * c]
}

/// Distance of an image's corner from its centre.
pub(super) fn corner_px(width: usize, height: usize) -> f64 {
    let [x, y] = centre(width, height);
    x.hypot(y)
}

fn centre(width: usize, height: usize) -> Vec2 {
    [(width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0]
}
