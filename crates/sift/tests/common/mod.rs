//! Images with a known truth: smooth functions of the plane that are evaluated, never resampled.

#![allow(dead_code, reason = "each test file uses a part")]

use std::collections::HashMap;

use scopeservo_sift::{Features, GrayImage, Options, detect_and_describe};

/// Small generator (splitmix64), so that every test names its seed.
pub(crate) struct Random(pub u64);

impl Random {
    /// Uniform in 0..1.
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(crate) fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Mean 0, variance 1.
    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.unit()).sum::<f64>() - 6.0
    }
}

/// Isotropic Gaussian spot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spot {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) sigma: f64,
    pub(crate) height: f64,
}

/// A sum of spots over a background, as a function of the plane.
pub(crate) struct Scene {
    pub(crate) spots: Vec<Spot>,
    pub(crate) background: f64,
}

impl Scene {
    /// `n` spots of either sign over a square of `size`, small ones more frequent.
    pub(crate) fn random(seed: u64, n: usize, size: f64, sigmas: std::ops::Range<f64>) -> Self {
        let mut r = Random(seed);
        let spots = (0..n)
            .map(|_| {
                let sigma = sigmas.start * (sigmas.end / sigmas.start).powf(r.unit().powi(2));
                let sign = if r.unit() < 0.5 { -1.0 } else { 1.0 };
                Spot {
                    x: r.range(0.0, size),
                    y: r.range(0.0, size),
                    sigma,
                    height: sign * r.range(0.1, 0.4),
                }
            })
            .collect();
        Self {
            spots,
            background: 0.5,
        }
    }

    /// Image in which pixel p shows the place `place(p)`, each spot reaching 5.5 sigma.
    pub(crate) fn render(
        &self,
        w: usize,
        h: usize,
        place: impl Fn(f64, f64) -> (f64, f64),
    ) -> GrayImage {
        const REACH: f64 = 5.5;
        const CELL: f64 = 16.0;
        let cell = |v: f64| (v / CELL).floor() as i64;
        let mut near: HashMap<(i64, i64), Vec<Spot>> = HashMap::new();
        for s in &self.spots {
            for i in cell(s.x - REACH * s.sigma)..=cell(s.x + REACH * s.sigma) {
                for j in cell(s.y - REACH * s.sigma)..=cell(s.y + REACH * s.sigma) {
                    near.entry((i, j)).or_default().push(*s);
                }
            }
        }
        GrayImage::from_fn(w, h, |x, y| {
            let (x, y) = place(x as f64, y as f64);
            let sum: f64 = near
                .get(&(cell(x), cell(y)))
                .into_iter()
                .flatten()
                .map(|s| {
                    let r_sq = ((x - s.x).powi(2) + (y - s.y).powi(2)) / (s.sigma * s.sigma);
                    if r_sq < REACH * REACH {
                        s.height * (-0.5 * r_sq).exp()
                    } else {
                        0.0
                    }
                })
                .sum();
            (self.background + sum) as f32
        })
        .unwrap()
    }
}

pub(crate) fn features(image: &GrayImage) -> Features {
    detect_and_describe(image, &Options::default()).unwrap()
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
