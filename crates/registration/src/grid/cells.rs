//! Where one cell lies: by the phases of its two fundamental waves, taken over exactly one period of each.
//!
//! Over a whole period all other waves of what repeats itself vanish, whatever its shape. The middle of a cell is where it is darkest; of a
//! bright pattern that lies between two of its cells, which is as good.

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

/// An image in the middle of which its cells are looked for.
pub(super) struct Flat {
    width: usize,
    height: usize,
    values: Vec<f64>,
}

impl Flat {
    /// An image divided by its light.
    pub(super) fn new(image: &GrayImage, light: impl Fn(Vec2) -> f64) -> Self {
        let (width, height) = (image.width(), image.height());
        let [cx, cy] = centre(width, height);
        let at = |i: usize| [(i % width) as f64 - cx, (i / width) as f64 - cy];
        let values = image.data().iter().enumerate();
        Self {
            width,
            height,
            values: values.map(|(i, v)| f64::from(*v) / light(at(i))).collect(),
        }
    }

    pub(super) fn corner_px(&self) -> f64 {
        let [x, y] = centre(self.width, self.height);
        x.hypot(y)
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
        for y in rows {
            for x in columns.clone() {
                let [u, v] = inverse * [x as f64 - cx - p[0], y as f64 - cy - p[1]];
                let weight = share(u, across_u) * share(v, across_v);
                if weight == 0.0 {
                    continue;
                }
                let value = weight * self.values[y * self.width + x];
                total += weight;
                sum += value;
                for (k, phase) in [TAU * u, TAU * v].into_iter().enumerate() {
                    let (s, c) = phase.sin_cos();
                    for (i, part) in [c, -s].into_iter().enumerate() {
                        waves[k][i] += value * part;
                        of_window[k][i] += weight * part;
                    }
                }
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

fn centre(width: usize, height: usize) -> Vec2 {
    [(width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0]
}
