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

/// What is done to one image, in the order of the fields: optics, light, dirt, sensor.
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

    /// Draws what `condition` asks for. `common(rng)` gives a point of the image that the other image shows too: the
    /// square lies around such a point, wholly in the image.
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

    /// The camera's 8-bit frame of an image of grey 0 to 1 with the size [`SIZE`].
    pub fn frame(&self, clean: &[f64], rng: &mut SplitMix64) -> Vec<u8> {
        let [w, h] = SIZE;
        assert_eq!(clean.len(), w * h, "an image has the size of a frame");
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

#[cfg(test)]
mod tests {
    use super::*;

    const N: usize = SIZE[0] * SIZE[1];

    fn drawn(condition: Condition, seed: u64) -> Degradation {
        let common = |rng: &mut SplitMix64| SIZE.map(|n| rng.uniform() * (n as f64 - 1.0));
        Degradation::draw(condition, &mut SplitMix64::new(seed), common)
    }

    fn mean_and_sd(values: &[f64]) -> (f64, f64) {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        (mean, variance.sqrt())
    }

    fn levels(d: &Degradation, clean: &[f64]) -> Vec<f64> {
        let frame = d.frame(clean, &mut SplitMix64::new(5));
        frame.into_iter().map(f64::from).collect()
    }

    #[test]
    fn each_condition_does_what_it_is_called_and_nothing_else() {
        for seed in 0..50 {
            let is = |condition, d: Degradation| assert_eq!(drawn(condition, seed), d);
            let none = Degradation::NONE;
            is(Condition::Clean, none.clone());
            is(
                Condition::Minus80,
                Degradation {
                    offset: -80.0,
                    ..none.clone()
                },
            );
            is(
                Condition::Times08,
                Degradation {
                    gain: 0.8,
                    ..none.clone()
                },
            );
            let blur = drawn(Condition::Blur, seed);
            assert!((1.0..3.0).contains(&blur.blur_sigma_px));
            let noise = drawn(Condition::Noise, seed);
            assert!((5.0..15.0).contains(&noise.noise_sigma));
            let gamma = drawn(Condition::Gamma, seed);
            assert!((2.0 / 3.0..1.5).contains(&gamma.gamma));
            let all = drawn(Condition::All, seed);
            assert!(all.blur_sigma_px >= 1.0 && all.noise_sigma >= 5.0 && all.gamma != 1.0);
            assert!(all.gain == 0.8 && all.offset == -80.0 && all.occluder.is_some());
        }
    }

    #[test]
    fn the_square_hides_120_by_120_pixels_around_its_point() {
        for point in [[300.2, 200.7], [0.0, 0.0], [639.0, 479.0]] {
            let mut rng = SplitMix64::new(1);
            let d = Degradation::draw(Condition::Occlusion, &mut rng, |_| point);
            let quiet = Degradation {
                noise_sigma: 0.0,
                ..d
            };
            let frame = quiet.frame(&vec![0.0; N], &mut rng);
            let hidden: Vec<usize> = (0..N).filter(|i| frame[*i] == 128).collect();
            assert_eq!(hidden.len(), 120 * 120);
            assert!((0..N).all(|i| frame[i] == 128 || frame[i] == 0));
            let [x, y] = [hidden[0] % SIZE[0], hidden[0] / SIZE[0]];
            let inside = |corner: usize, p: f64| (0.0..120.0).contains(&(p - corner as f64));
            assert!(inside(x, point[0]) && inside(y, point[1]));
        }
    }

    #[test]
    fn noise_has_the_sigma_it_says() {
        for sigma in [2.0, 5.0, 15.0] {
            let d = Degradation {
                noise_sigma: sigma,
                ..Degradation::NONE
            };
            let (mean, sd) = mean_and_sd(&levels(&d, &vec![0.5; N]));
            // Rounding to whole levels adds a twelfth to the variance.
            let expected = (sigma * sigma + 1.0 / 12.0).sqrt();
            assert!((mean - 127.5).abs() < 0.1, "{mean}");
            assert!((sd / expected - 1.0).abs() < 0.01, "{sd}");
        }
    }

    #[test]
    fn light_changes_by_what_it_says() {
        let quiet = Degradation {
            noise_sigma: 0.0,
            ..Degradation::NONE
        };
        let level = |d: Degradation, grey: f64| levels(&d, &vec![grey / 255.0; N])[0];
        let minus80 = Degradation {
            offset: -80.0,
            ..quiet.clone()
        };
        assert_eq!(level(minus80.clone(), 200.0), 120.0);
        assert_eq!(level(minus80, 60.0), 0.0);
        let dimmer = Degradation {
            gain: 0.8,
            ..quiet.clone()
        };
        assert_eq!(level(dimmer, 200.0), 160.0);
        let gamma = Degradation {
            gamma: 1.5,
            ..quiet
        };
        assert_eq!(
            level(gamma, 100.0),
            (255.0 * (100.0_f64 / 255.0).powf(1.5)).round()
        );
    }

    #[test]
    fn blur_spreads_a_dot_by_its_sigma_and_keeps_its_light() {
        let mut clean = vec![0.0; N];
        clean[200 * SIZE[0] + 300] = 1.0;
        for sigma in [1.0, 2.2, 3.0] {
            let out = blurred(&clean, sigma);
            let (mut light, mut spread) = (0.0, 0.0);
            for (i, v) in out.iter().enumerate() {
                light += v;
                spread += v * ((i % SIZE[0]) as f64 - 300.0).powi(2);
            }
            assert!((light - 1.0).abs() < 1e-9);
            assert!((spread.sqrt() / sigma - 1.0).abs() < 0.01, "{spread}");
        }
        let even = blurred(&vec![0.4; N], 3.0);
        assert!(even.iter().all(|v| (v - 0.4).abs() < 1e-9));
    }
}
