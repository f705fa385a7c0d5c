//! The scale space by its definition, in f64 and with whole planes: what the sweep is tested against.

use crate::blur::mirrored;
use crate::{GrayImage, Options};

/// A plane of f64.
#[derive(Clone)]
pub(crate) struct Field {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) data: Vec<f64>,
}

impl Field {
    fn from_fn(width: usize, height: usize, f: impl Fn(usize, usize) -> f64) -> Self {
        let data = (0..width * height).map(|i| f(i % width, i / width));
        Self {
            width,
            height,
            data: data.collect(),
        }
    }

    pub(crate) fn at(&self, x: usize, y: usize) -> f64 {
        self.data[y * self.width + x]
    }

    /// Bilinear value at (x / 2, y / 2).
    fn half(&self, x: usize, y: usize) -> f64 {
        let corner = |i, j| self.at((x + i) / 2, (y + j) / 2);
        (corner(0, 0) + corner(1, 0) + corner(0, 1) + corner(1, 1)) / 4.0
    }

    fn blurred(&self, sigma: f64) -> Self {
        let r = (4.0 * sigma).ceil().max(1.0) as isize;
        let weight = |i: isize| (-0.5 * (i as f64 / sigma).powi(2)).exp();
        let sum: f64 = (-r..=r).map(weight).sum();
        let along = Self::from_fn(self.width, self.height, |x, y| {
            (-r..=r)
                .map(|i| weight(i) / sum * self.at(mirrored(x as isize + i, self.width), y))
                .sum()
        });
        Self::from_fn(self.width, self.height, |x, y| {
            (-r..=r)
                .map(|i| weight(i) / sum * along.at(x, mirrored(y as isize + i, self.height)))
                .sum()
        })
    }

    pub(crate) fn halved(&self) -> Self {
        let size = (self.width.div_ceil(2), self.height.div_ceil(2));
        Self::from_fn(size.0, size.1, |x, y| self.at(2 * x, 2 * y))
    }
}

/// Gaussian layers `0..=intervals + 1` of the octaves from `options.first_octave` on; at most `count` octaves. Layers 0 and 1 of an
/// octave after the first are the last two of the one before, halved.
pub(crate) fn octaves(image: &GrayImage, options: &Options, count: usize) -> Vec<Vec<Field>> {
    let (w, h) = (image.width(), image.height());
    let image = Field::from_fn(w, h, |x, y| f64::from(image.get(x, y)));
    let (sigma, n) = (f64::from(options.sigma), options.intervals);
    let sigma_at = |s: usize| sigma * (s as f64 / n as f64).exp2();
    let between = |from: f64, to: f64| (to * to - from * from).sqrt();
    let blur = f64::from(options.assumed_blur);
    let (mut layer_0, first_blur) = if options.first_octave < 0 {
        (
            Field::from_fn(2 * w - 1, 2 * h - 1, |x, y| image.half(x, y)),
            2.0 * blur,
        )
    } else {
        (image, blur)
    };
    let mut before = first_blur;
    for _ in 0..options.first_octave {
        layer_0 = layer_0.blurred(between(before, 2.0 * sigma)).halved();
        before = sigma;
    }
    let blurred = |s: usize| match between(before, sigma_at(s)) {
        0.0 => layer_0.clone(),
        by => layer_0.blurred(by),
    };
    let mut octaves: Vec<Vec<Field>> = vec![(0..n + 2).map(blurred).collect()];
    while octaves.len() < count {
        let finer = &octaves[octaves.len() - 1];
        let mut layers = vec![finer[n].halved(), finer[n + 1].halved()];
        for s in 2..n + 2 {
            layers.push(layers[1].blurred(between(sigma_at(1), sigma_at(s))));
        }
        octaves.push(layers);
    }
    octaves
}
