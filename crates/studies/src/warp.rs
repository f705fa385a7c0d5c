//! Pairs of images with a known transform between them. Both are rendered from one large source, each sampled once.

use rayon::prelude::*;
use scopeservo_geometry::{Affine2, Mat2, SplitMix64, Vec2};
use scopeservo_registration::{Prior, ScalePrior};
use scopeservo_sift::GrayImage;

/// Size of the images.
pub const SIZE: [usize; 2] = [640, 480];
/// How the views lie on the source. On its own grid a view would see the same interpolation error everywhere, 0.004 pixels or so, which no
/// camera has.
const VIEW_ANGLE_RAD: f64 = 0.2;

/// A rendered pair and its truth.
pub struct Pair {
    /// The wide image.
    pub view: GrayImage,
    /// The narrow one.
    pub target: GrayImage,
    /// The truth: target pixel from view pixel.
    pub target_from_view: Affine2,
    /// Target pixels per view pixel.
    pub zoom: f64,
}

/// Grey source image, 0..=1.
pub struct Source {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major.
    pub data: Vec<f32>,
}

impl Source {
    /// The same turned so that the longer side lies along the rows.
    #[must_use]
    pub fn landscape(self) -> Self {
        if self.width >= self.height {
            return self;
        }
        let (width, height) = (self.height, self.width);
        let data = (0..width * height)
            .map(|i| self.data[(i % width) * self.width + (self.width - 1 - i / width)])
            .collect();
        Self {
            width,
            height,
            data,
        }
    }

    /// Catmull-Rom interpolation at a place in source pixels; clamped at the border.
    pub(crate) fn sample(&self, x: f64, y: f64) -> f64 {
        let (fx, fy) = (x.floor(), y.floor());
        let (wx, wy) = (catmull_rom(x - fx), catmull_rom(y - fy));
        let mut sum = 0.0;
        for (j, wy) in wy.iter().enumerate() {
            let row = (fy as i64 + j as i64 - 1).clamp(0, self.height as i64 - 1) as usize;
            for (i, wx) in wx.iter().enumerate() {
                let col = (fx as i64 + i as i64 - 1).clamp(0, self.width as i64 - 1) as usize;
                sum += wx * wy * f64::from(self.data[row * self.width + col]);
            }
        }
        sum
    }

    /// What pixel p of an image sees at `source_from_pixel(p)`, integrated over the pixel's area; row-major, 0..=1 but for
    /// the overshoot of the interpolation.
    pub fn integrate(&self, source_from_pixel: &Affine2) -> Vec<f64> {
        self.integrate_sized(SIZE, source_from_pixel)
    }

    fn integrate_sized(&self, [w, h]: [usize; 2], source_from_pixel: &Affine2) -> Vec<f64> {
        let pitch = source_from_pixel.linear.det().abs().sqrt();
        let sub = (pitch * 1.5).ceil().max(2.0) as usize;
        let mut data = vec![0.0; w * h];
        data.par_chunks_mut(w).enumerate().for_each(|(y, row)| {
            for (x, value) in row.iter_mut().enumerate() {
                let mut sum = 0.0;
                for j in 0..sub {
                    for i in 0..sub {
                        let offset = |k: usize| (k as f64 + 0.5) / sub as f64 - 0.5;
                        let p =
                            source_from_pixel.apply([x as f64 + offset(i), y as f64 + offset(j)]);
                        sum += self.sample(p[0], p[1]);
                    }
                }
                *value = sum / (sub * sub) as f64;
            }
        });
        data
    }

    /// An image of [`SIZE`] whose pixel p shows the source at `source_from_pixel(p)`, integrated over the pixel's area,
    /// with Gaussian noise and 8-bit rounding as a camera has.
    pub fn render(&self, source_from_pixel: &Affine2, noise: f64, seed: u64) -> GrayImage {
        self.render_sized(SIZE, source_from_pixel, noise, seed)
    }

    /// As [`render`](Self::render), of any size.
    pub fn render_sized(
        &self,
        [w, h]: [usize; 2],
        source_from_pixel: &Affine2,
        noise: f64,
        seed: u64,
    ) -> GrayImage {
        let clean = self.integrate_sized([w, h], source_from_pixel);
        let mut data = vec![0.0f32; w * h];
        data.par_chunks_mut(w).enumerate().for_each(|(y, row)| {
            let mut rng = SplitMix64::new(seed ^ (y as u64).wrapping_mul(0x9E37_79B9));
            for (value, clean) in row.iter_mut().zip(&clean[y * w..]) {
                let noisy = (clean + noise * rng.normal()).clamp(0.0, 1.0);
                *value = ((noisy * 255.0).round() / 255.0) as f32;
            }
        });
        GrayImage::new(w, h, data).expect("a rendered image is finite and not empty")
    }
}

fn catmull_rom(t: f64) -> [f64; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        (-t3 + 2.0 * t2 - t) / 2.0,
        (3.0 * t3 - 5.0 * t2 + 2.0) / 2.0,
        (-3.0 * t3 + 4.0 * t2 + t) / 2.0,
        (t3 - t2) / 2.0,
    ]
}

/// A pair at `zoom` from a random place of the source, turned by any angle, with independent noise of `noise` (of full
/// scale). The target's pixel covers `target_pitch` source pixels, the view's `zoom` times as much. `None` when the
/// source is too small.
pub fn random_pair(
    source: &Source,
    zoom: f64,
    target_pitch: f64,
    noise: f64,
    seed: u64,
) -> Option<Pair> {
    let mut rng = SplitMix64::new(seed);
    let view_pitch = zoom * target_pitch;
    let half = SIZE.map(|n| 0.5 * view_pitch * n as f64);
    // Of what the turned view covers.
    let (sin, cos) = VIEW_ANGLE_RAD.sin_cos();
    let reach = [cos * half[0] + sin * half[1], sin * half[0] + cos * half[1]];
    let place = |rng: &mut SplitMix64, size: usize, half: f64| {
        let room = size as f64 - 2.0 * half - 8.0;
        (room >= 0.0).then(|| half + 4.0 + rng.uniform() * room)
    };
    let centre = [
        place(&mut rng, source.width, reach[0])?,
        place(&mut rng, source.height, reach[1])?,
    ];
    let source_from_view = about(centre, VIEW_ANGLE_RAD, view_pitch);
    // The target's centre stays in the middle third of the view, so that it shows the same tissue.
    let angle = rng.uniform() * std::f64::consts::TAU;
    let off = |rng: &mut SplitMix64, half: f64| {
        (rng.uniform() - 0.5) * 2.0 * half * (1.0 - 1.0 / zoom).max(0.1) * 0.5
    };
    let target_centre = [
        centre[0] + off(&mut rng, half[0]),
        centre[1] + off(&mut rng, half[1]),
    ];
    let source_from_target = about(target_centre, angle, target_pitch);
    Some(Pair {
        view: source.render(&source_from_view, noise, rng.next_u64()),
        target: source.render(&source_from_target, noise, rng.next_u64()),
        target_from_view: source_from_target.inverse()?.after(&source_from_view),
        zoom,
    })
}

/// An image whose centre shows `centre`, turned by the angle, with pixels of `pitch` source pixels.
pub fn about(centre: Vec2, angle_rad: f64, pitch: f64) -> Affine2 {
    let linear = Mat2::rotation(angle_rad) * pitch;
    let middle = [(SIZE[0] as f64 - 1.0) / 2.0, (SIZE[1] as f64 - 1.0) / 2.0];
    let moved = linear * middle;
    Affine2 {
        linear,
        offset: [centre[0] - moved[0], centre[1] - moved[1]],
    }
}

impl Pair {
    /// What a calibration would know: the scale, to a per cent or so.
    pub fn prior(&self) -> Prior {
        Prior {
            scale: Some(ScalePrior {
                ratio: self.zoom,
                tolerance: 0.03,
            }),
            rotation: None,
            ..Prior::default()
        }
    }

    /// Mean distance, in target pixels, between the four corners of the target and where `estimate` puts what is
    /// truly there.
    pub fn corner_error(&self, estimate: &Affine2) -> f64 {
        let back = self
            .target_from_view
            .inverse()
            .expect("a known warp is regular");
        let (w, h) = (SIZE[0] as f64 - 1.0, SIZE[1] as f64 - 1.0);
        [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]]
            .into_iter()
            .map(|corner| {
                let p = estimate.apply(back.apply(corner));
                f64::hypot(p[0] - corner[0], p[1] - corner[1])
            })
            .sum::<f64>()
            / 4.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dot_is_rendered_where_the_truth_says() {
        let (w, h) = (1500, 1200);
        let dot = [700.3, 600.8];
        let data = (0..w * h)
            .map(|i| {
                let (x, y) = ((i % w) as f64 - dot[0], (i / w) as f64 - dot[1]);
                (-(x * x + y * y) / (2.0 * 36.0)).exp() as f32
            })
            .collect();
        let source = Source {
            width: w,
            height: h,
            data,
        };
        let source_from_pixel = about(dot, 0.7, 1.5).after(&Affine2 {
            linear: Mat2::IDENTITY,
            offset: [3.25, -7.6],
        });
        let image = source.render(&source_from_pixel, 0.0, 1);
        let expected = source_from_pixel.inverse().unwrap().apply(dot);
        let (mut mass, mut cx, mut cy) = (0.0, 0.0, 0.0);
        for y in 0..SIZE[1] {
            for x in 0..SIZE[0] {
                let v = f64::from(image.get(x, y));
                mass += v;
                cx += v * x as f64;
                cy += v * y as f64;
            }
        }
        assert!((cx / mass - expected[0]).abs() < 0.01 && (cy / mass - expected[1]).abs() < 0.01);
    }

    #[test]
    fn the_truth_has_no_corner_error() {
        let source = Source {
            width: 2000,
            height: 1600,
            data: vec![0.5; 2000 * 1600],
        };
        let pair = random_pair(&source, 2.0, 1.0, 0.01, 3).unwrap();
        assert!(pair.corner_error(&pair.target_from_view) < 1e-9);
        assert!(random_pair(&source, 4.0, 1.0, 0.01, 3).is_none());
    }
}
