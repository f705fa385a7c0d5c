//! Images computed by formula, and what is done to them.

mod evidence;
mod refine;
mod softness;

use scopeservo_features::{GrayImage, Mask};
use scopeservo_geometry::{Affine2, Mat2, Similarity, SplitMix64, Vec2};
use scopeservo_registration::Estimate;
use scopeservo_registration::pixels::{
    Abstained, Judgement, Pictures, Refined, Sharpness, refine, sharpness, weigh,
};

const SIZE: [usize; 2] = [320, 240];

/// A sum of waves, known everywhere and under any blur.
struct Scene {
    /// Wave number along x and y, phase, amplitude.
    waves: Vec<[f64; 4]>,
}

impl Scene {
    fn new(seed: u64) -> Self {
        let mut rng = SplitMix64::new(seed);
        let waves = (0..45).map(|_| {
            let k = (0.04f64.ln() + rng.uniform() * (1.4f64 / 0.04).ln()).exp();
            let (s, c) = (std::f64::consts::TAU * rng.uniform()).sin_cos();
            let phase = std::f64::consts::TAU * rng.uniform();
            [k * c, k * s, phase, 0.06 * (k / 0.2).powf(-0.5)]
        });
        Self {
            waves: waves.collect(),
        }
    }

    /// As a camera sees it whose pixel p lies at `scene_from_pixel(p)`, under a Gaussian blur of `blur` of its pixels. Along a row each wave
    /// turns on by one angle.
    fn image(&self, scene_from_pixel: &Affine2, blur: f64) -> GrayImage {
        let sigma = scene_from_pixel.linear.det().sqrt() * blur;
        let mut values = vec![0.5; SIZE[0] * SIZE[1]];
        for (y, row) in values.chunks_exact_mut(SIZE[0]).enumerate() {
            let p = scene_from_pixel.apply([0.0, y as f64]);
            let [[ax, _], [ay, _]] = scene_from_pixel.linear.0;
            for &[kx, ky, phase, amplitude] in &self.waves {
                let damped = amplitude * (-0.5 * (kx * kx + ky * ky) * sigma * sigma).exp();
                let (mut s, mut c) = (kx * p[0] + ky * p[1] + phase).sin_cos();
                let (ds, dc) = (kx * ax + ky * ay).sin_cos();
                for value in row.iter_mut() {
                    *value += damped * c;
                    (s, c) = (s * dc + c * ds, c * dc - s * ds);
                }
            }
        }
        let values = values.iter().map(|&v| v as f32).collect();
        GrayImage::new(SIZE[0], SIZE[1], values).unwrap()
    }
}

fn middle() -> Vec2 {
    SIZE.map(|side| (side as f64 - 1.0) / 2.0)
}

/// Of an image whose middle shows `at`.
fn placed(at: Vec2, angle_rad: f64, pitch: f64) -> Affine2 {
    let turned = Affine2::from(Similarity {
        scale: pitch,
        angle_rad,
        offset: [0.0; 2],
    });
    let off = turned.apply(middle());
    Affine2 {
        offset: [at[0] - off[0], at[1] - off[1]],
        ..turned
    }
}

struct Case {
    view: GrayImage,
    target: GrayImage,
    target_from_view: Affine2,
    zoom: f64,
}

/// The target has pixels of 1; the view's are `zoom` times as large.
fn case(seed: u64, zoom: f64, angle_rad: f64, [view_blur, target_blur]: [f64; 2]) -> Case {
    let scene = Scene::new(seed);
    let view = placed([3.3, -8.7], 0.1, zoom);
    let target = placed([10.4, 6.2], 0.1 + angle_rad, 1.0);
    Case {
        view: scene.image(&view, view_blur),
        target: scene.image(&target, target_blur),
        target_from_view: target.inverse().unwrap().after(&view),
        zoom,
    }
}

fn noisy(image: &GrayImage, sigma: f64, seed: u64) -> GrayImage {
    let mut rng = SplitMix64::new(seed);
    changed(image, |_, v| {
        let v = v + sigma * rng.normal();
        (v.clamp(0.0, 1.0) * 255.0).round() / 255.0
    })
}

fn changed(image: &GrayImage, mut change: impl FnMut(Vec2, f64) -> f64) -> GrayImage {
    GrayImage::from_fn(image.width(), image.height(), |x, y| {
        let v = f64::from(image.get(x, y));
        change([x as f64, y as f64], v) as f32
    })
    .unwrap()
}

fn at(image: &GrayImage, p: Vec2) -> f64 {
    f64::from(image.get(p[0] as usize, p[1] as usize))
}

impl Case {
    fn noisy(mut self, sigma: f64) -> Self {
        self.view = noisy(&self.view, sigma, 5);
        self.target = noisy(&self.target, sigma, 6);
        self
    }

    fn view(mut self, change: impl FnMut(Vec2, f64) -> f64) -> Self {
        self.view = changed(&self.view, change);
        self
    }

    /// A start that is off by so much in the middle of the view, coarse pixels, and known as well as that.
    fn start(&self, off: f64) -> Estimate {
        let off_px = off * self.zoom;
        let turn = off / 200.0;
        let t = &self.target_from_view;
        let wrong = Affine2 {
            linear: Mat2::rotation(turn) * t.linear,
            offset: t.offset,
        };
        let [p, q] = [wrong.apply(middle()), t.apply(middle())];
        let wrong = Affine2 {
            offset: [0, 1].map(|k| wrong.offset[k] + q[k] - p[k] + off_px * [0.8, -0.6][k]),
            ..wrong
        };
        let [x, y] = middle();
        // Shift and turn about the middle, each known as well as they are off.
        let way = |linear: Mat2, shift: Vec2| {
            let [bx, by] = linear * [x, y];
            let [[a, b], [c, d]] = linear.0;
            [a, b, shift[0] - bx, c, d, shift[1] - by]
        };
        let zero = Mat2::diagonal(0.0, 0.0);
        let turned = Mat2([[0.0, -1.0], [1.0, 0.0]]) * (turn * self.zoom);
        let mut covariance = [[0.0; 6]; 6];
        for deviation in [
            way(zero, [off_px, 0.0]),
            way(zero, [0.0, off_px]),
            way(turned, [0.0; 2]),
        ] {
            for (row, a) in covariance.iter_mut().zip(deviation) {
                for (cell, b) in row.iter_mut().zip(deviation) {
                    *cell += a * b;
                }
            }
        }
        Estimate {
            target_from_view: wrong,
            covariance,
            sigma_px: off_px,
            corner_sigma_px: 1.5 * off_px,
            sigma_angle_rad: turn,
        }
    }

    fn pictures(&self) -> Pictures<'_> {
        Pictures {
            view: &self.view,
            target: &self.target,
            of_view: None,
            of_target: None,
        }
    }

    fn refine(&self, off: f64) -> Result<Refined, Abstained> {
        refine(&self.pictures(), &self.start(off))
    }

    /// Target pixels in the middle of the view.
    fn error(&self, found: &Affine2) -> f64 {
        let (p, q) = (found.apply(middle()), self.target_from_view.apply(middle()));
        f64::hypot(p[0] - q[0], p[1] - q[1])
    }

    fn turned_rad(&self, found: &Affine2) -> f64 {
        let left = found.after(&self.target_from_view.inverse().unwrap());
        left.linear.rotation_angle().unwrap()
    }
}

/// Soft shadows fixed to a camera: middle, radius, depth.
fn dust(seed: u64, count: usize) -> impl Fn(Vec2) -> f64 {
    let mut rng = SplitMix64::new(seed);
    let [w, h] = SIZE.map(|v| v as f64);
    let all: Vec<[f64; 4]> = (0..count)
        .map(|_| {
            let at = [rng.uniform() * w, rng.uniform() * h];
            [at[0], at[1], 5.0 + 10.0 * rng.uniform(), 0.15]
        })
        .collect();
    move |p| {
        all.iter()
            .map(|&[x, y, r, depth]| {
                let d = ((p[0] - x).powi(2) + (p[1] - y).powi(2)) / (r * r);
                1.0 - depth * (-0.5 * d).exp()
            })
            .product()
    }
}
