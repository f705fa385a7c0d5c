//! Images that are known everywhere: round spots, each a Gaussian, drawn where a transform puts them. Nothing is interpolated.

#![allow(dead_code, reason = "each test program uses its share")]

use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, SplitMix64, Vec2};

/// A spot: place, sigma, depth.
#[derive(Clone, Copy)]
pub(crate) struct Spot {
    pub(crate) at: Vec2,
    pub(crate) sigma: f64,
    pub(crate) depth: f64,
}

/// Round things on a bright field.
#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) spots: Vec<Spot>,
}

impl Scene {
    /// So many spots anywhere within `reach` of the origin along both axes.
    pub(crate) fn random(seed: u64, count: usize, reach: f64, sigma: std::ops::Range<f64>) -> Self {
        let mut rng = SplitMix64::new(seed);
        let spots = (0..count).map(|_| Spot {
            at: [0.0; 2].map(|_: f64| reach * (2.0 * rng.uniform() - 1.0)),
            sigma: sigma.start * (sigma.end / sigma.start).powf(rng.uniform()),
            depth: 0.05 + 0.15 * rng.uniform(),
        });
        Self {
            spots: spots.collect(),
        }
    }

    /// Equal spots on a square lattice.
    pub(crate) fn lattice(spacing: f64, reach: f64, sigma: f64) -> Self {
        let n = (reach / spacing) as i64;
        let at = |i: i64, j: i64| [i as f64 * spacing, j as f64 * spacing];
        let spots = (-n..=n).flat_map(|j| (-n..=n).map(move |i| (i, j)));
        Self {
            spots: spots
                .map(|(i, j)| Spot {
                    at: at(i, j),
                    sigma,
                    depth: 0.3,
                })
                .collect(),
        }
    }

    /// Light at each pixel: 0.85, less what the spots take away. Each pixel sees the mean over its area, and `blur_px` more.
    pub(crate) fn light(
        &self,
        [w, h]: [usize; 2],
        pixel_from_scene: &Affine2,
        blur_px: f64,
    ) -> Vec<f64> {
        let mut light = vec![0.85; w * h];
        let scale = pixel_from_scene.linear.det().abs().sqrt();
        for spot in &self.spots {
            let c = pixel_from_scene.apply(spot.at);
            let own = (spot.sigma * scale).powi(2);
            let variance = own + blur_px * blur_px + 1.0 / 12.0;
            let depth = spot.depth * own / variance;
            let reach = 4.5 * variance.sqrt();
            let range = |v: f64, n: usize| {
                let from = (v - reach).ceil().max(0.0) as usize;
                from..((v + reach).floor() + 1.0).clamp(0.0, n as f64) as usize
            };
            for y in range(c[1], h) {
                for x in range(c[0], w) {
                    let d = (x as f64 - c[0]).powi(2) + (y as f64 - c[1]).powi(2);
                    light[y * w + x] -= depth * (-0.5 * d / variance).exp();
                }
            }
        }
        light
    }

    /// The frame of a camera with noise.
    pub(crate) fn frame(
        &self,
        size: [usize; 2],
        pixel_from_scene: &Affine2,
        noise: f64,
        seed: u64,
    ) -> GrayImage {
        frame(&self.light(size, pixel_from_scene, 0.0), size, noise, seed)
    }
}

/// What a camera makes of light.
pub(crate) fn frame(light: &[f64], [w, h]: [usize; 2], noise: f64, seed: u64) -> GrayImage {
    let mut rng = SplitMix64::new(seed);
    GrayImage::from_fn(w, h, |x, y| {
        let v = (light[y * w + x] + noise * rng.normal()).clamp(0.0, 1.0);
        ((v * 255.0).round() / 255.0) as f32
    })
    .unwrap()
}

/// How far two transforms take the middle of an image of this size apart.
pub(crate) fn apart(a: &Affine2, b: &Affine2, [w, h]: [usize; 2]) -> f64 {
    let c = [(w as f64 - 1.0) / 2.0, (h as f64 - 1.0) / 2.0];
    let (p, q) = (a.apply(c), b.apply(c));
    f64::hypot(p[0] - q[0], p[1] - q[1])
}

/// A similarity that takes `from` to `to`.
pub(crate) fn placed(scale: f64, angle_deg: f64, from: Vec2, to: Vec2) -> Affine2 {
    let linear = scopeservo_geometry::Mat2::rotation(angle_deg.to_radians()) * scale;
    let moved = linear * from;
    Affine2 {
        linear,
        offset: [to[0] - moved[0], to[1] - moved[1]],
    }
}
