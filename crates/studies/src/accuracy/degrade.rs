//! What may be wrong with the live image, in grey levels of 0 to 255 and pixels of the image.

use crate::warp::SIZE;
use scopeservo_geometry::{SplitMix64, Vec2};

/// Noise that every camera has, standard deviation in grey levels.
pub const CAMERA_NOISE: f64 = 2.0;
/// Side of the square that hides a part of the view, pixels.
pub const OCCLUDER_PX: usize = 120;
/// Grey level of that square.
pub const OCCLUDER_GREY: f64 = 128.0;

/// One column of the study.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Condition {
    /// Nothing but camera noise.
    Clean,
    /// Gaussian blur, sigma 1 to 3 pixels.
    Blur,
    /// 80 grey levels less.
    Minus80,
    /// 0.8 times the light.
    Times08,
    /// A gamma of 2/3 to 3/2.
    Gamma,
    /// A grey square of 120 x 120 pixels.
    Occlusion,
    /// Noise of 5 to 15 grey levels in place of the camera's.
    Noise,
    /// All of these.
    All,
}

impl Condition {
    /// Each of them, in the order of the tables.
    pub const EACH: [Self; 8] = [
        Self::Clean,
        Self::Blur,
        Self::Minus80,
        Self::Times08,
        Self::Gamma,
        Self::Occlusion,
        Self::Noise,
        Self::All,
    ];

    /// Its name in identifiers and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Clean => "clean",
            Self::Blur => "blur",
            Self::Minus80 => "minus80",
            Self::Times08 => "times0.8",
            Self::Gamma => "gamma",
            Self::Occlusion => "occlusion",
            Self::Noise => "noise",
            Self::All => "all",
        }
    }

    /// The condition of that name.
    pub fn of(name: &str) -> Option<Self> {
        Self::EACH.into_iter().find(|c| c.name() == name)
    }
}

/// What is done to one picture, in the order of the fields: optics, light, dirt, sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Degradation {
    /// Gaussian sigma, pixels; 0 for none.
    pub blur_sigma_px: f64,
    /// Exponent on grey 0 to 1.
    pub gamma: f64,
    /// Factor on the grey level.
    pub gain: f64,
    /// Grey levels added.
    pub offset: f64,
    /// Corner (column, row) of the grey square.
    pub occluder: Option<[usize; 2]>,
    /// Standard deviation of the noise, grey levels.
    pub noise_sigma: f64,
}

impl Degradation {
    /// A camera's frame as it should be.
    pub const NONE: Self = Self {
        blur_sigma_px: 0.0,
        gamma: 1.0,
        gain: 1.0,
        offset: 0.0,
        occluder: None,
        noise_sigma: CAMERA_NOISE,
    };

    /// Draws what `condition` asks for. `common(rng)` gives a point of the picture that the other picture shows too: the
    /// square lies around such a point, wholly in the picture.
    pub fn draw(
        condition: Condition,
        rng: &mut SplitMix64,
        mut common: impl FnMut(&mut SplitMix64) -> Vec2,
    ) -> Self {
        let has = |c: Condition| condition == c || condition == Condition::All;
        let mut d = Self::NONE;
        if has(Condition::Blur) {
            d.blur_sigma_px = 1.0 + 2.0 * rng.uniform();
        }
        if has(Condition::Gamma) {
            d.gamma = 1.5_f64.powf(2.0 * rng.uniform() - 1.0);
        }
        if has(Condition::Times08) {
            d.gain = 0.8;
        }
        if has(Condition::Minus80) {
            d.offset = -80.0;
        }
        if has(Condition::Occlusion) {
            let centre = common(rng);
            d.occluder = Some([0, 1].map(|k| {
                let corner = (centre[k] - (OCCLUDER_PX as f64 - 1.0) / 2.0).round();
                corner.clamp(0.0, (SIZE[k] - OCCLUDER_PX) as f64) as usize
            }));
        }
        if has(Condition::Noise) {
            d.noise_sigma = 5.0 + 10.0 * rng.uniform();
        }
        d
    }

    /// The camera's 8-bit frame of a picture of grey 0 to 1 with the size [`SIZE`].
    pub fn frame(&self, clean: &[f64], rng: &mut SplitMix64) -> Vec<u8> {
        let [w, h] = SIZE;
        assert_eq!(clean.len(), w * h, "a picture has the size of a frame");
        let sharp;
        let picture = if self.blur_sigma_px > 0.0 {
            sharp = blurred(clean, self.blur_sigma_px);
            &sharp
        } else {
            clean
        };
        let hidden = |x: usize, y: usize| {
            self.occluder.is_some_and(|[left, top]| {
                (left..left + OCCLUDER_PX).contains(&x) && (top..top + OCCLUDER_PX).contains(&y)
            })
        };
        (0..w * h)
            .map(|i| {
                let grey = if hidden(i % w, i / w) {
                    OCCLUDER_GREY
                } else {
                    let light = picture[i].clamp(0.0, 1.0).powf(self.gamma);
                    255.0 * light * self.gain + self.offset
                };
                (grey + self.noise_sigma * rng.normal())
                    .round()
                    .clamp(0.0, 255.0) as u8
            })
            .collect()
    }
}

/// Gaussian blur, rows then columns; the border is repeated outwards.
fn blurred(picture: &[f64], sigma_px: f64) -> Vec<f64> {
    let [w, h] = SIZE;
    let radius = (4.0 * sigma_px).ceil() as i64;
    let weights: Vec<f64> = (-radius..=radius)
        .map(|i| (-0.5 * (i as f64 / sigma_px).powi(2)).exp())
        .collect();
    let sum: f64 = weights.iter().sum();
    let at = |i: usize, k: usize, size: usize| {
        (i as i64 + k as i64 - radius).clamp(0, size as i64 - 1) as usize
    };
    let mut rows = vec![0.0; w * h];
    for (y, row) in rows.chunks_exact_mut(w).enumerate() {
        for (x, value) in row.iter_mut().enumerate() {
            for (k, weight) in weights.iter().enumerate() {
                *value += weight / sum * picture[y * w + at(x, k, w)];
            }
        }
    }
    let mut both = vec![0.0; w * h];
    for (y, out) in both.chunks_exact_mut(w).enumerate() {
        for (k, weight) in weights.iter().enumerate() {
            let row = &rows[at(y, k, h) * w..][..w];
            for (value, v) in out.iter_mut().zip(row) {
                *value += weight / sum * v;
            }
        }
    }
    both
}
