//! What lies in the way of the light and moves with the camera: dust, a reticle.

use crate::camera_config::{CameraConfig, DustConfig, Mark};
use crate::faults::DriftingHair;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// Shadows fainter than this share of the light are left out.
const FAINTEST: f64 = 1e-4;

/// The light that passes a window without dust, per pixel.
pub(super) fn clean_window(config: &CameraConfig) -> Vec<f32> {
    let mut window = vec![1.0f32; config.width * config.height];
    for mark in &config.marks {
        if let Mark::Reticle { attenuation, .. } = mark {
            window
                .par_chunks_mut(config.width)
                .enumerate()
                .for_each(|(y, row)| {
                    for (x, v) in row.iter_mut().enumerate() {
                        let share = reticle_share(mark, [x as f64, y as f64]);
                        *v *= 1.0 - (attenuation * share) as f32;
                    }
                });
        }
    }
    window
}

/// Lets dust settle on a window of `width` columns.
pub(super) fn settle(window: &mut [f32], width: usize, kinds: &[DustConfig], rng: &mut Pcg64Mcg) {
    let size = [width as f64, (window.len() / width) as f64];
    for kind in kinds {
        for _ in 0..kind.specks {
            Speck::draw(kind, size, rng).shade(window, width);
        }
    }
}

/// The shadow of a hair that has drifted for some seconds.
pub(super) fn hair(window: &mut [f32], width: usize, hair: &DriftingHair, seconds: f64) {
    let (s, c) = hair.angle_deg.to_radians().sin_cos();
    let speck = Speck {
        at: std::array::from_fn(|i| hair.at_px[i] + seconds * hair.px_per_s[i]),
        radius: hair.radius_px,
        depth: hair.attenuation,
        // As sharp as what lies near the field stop.
        steepness: 4,
        stretch: hair.stretch,
        direction: [c, s],
        rings: 0.0,
    };
    speck.shade(window, width);
}

fn between(rng: &mut Pcg64Mcg, [least, most]: [f64; 2]) -> f64 {
    if least < most {
        rng.random_range(least..most)
    } else {
        least
    }
}

struct Speck {
    at: [f64; 2],
    radius: f64,
    depth: f64,
    steepness: i32,
    /// Length over width, and the direction of the length.
    stretch: f64,
    direction: [f64; 2],
    rings: f64,
}

impl Speck {
    /// What has no range takes nothing from the generator.
    fn draw(kind: &DustConfig, [w, h]: [f64; 2], rng: &mut Pcg64Mcg) -> Self {
        let x = rng.random::<f64>() * w;
        let y = rng.random::<f64>() * h;
        let radius = between(rng, kind.radius_px);
        let [least, most] = kind.attenuation;
        let depth = least + (most - least) * rng.random::<f64>();
        let [soft, hard] = kind.steepness;
        let steepness = if soft < hard {
            rng.random_range(soft..=hard)
        } else {
            soft
        };
        let stretch = between(rng, kind.stretch);
        let angle = if stretch > 1.0 {
            rng.random_range(0.0..std::f64::consts::PI)
        } else {
            0.0
        };
        Self {
            at: [x, y],
            radius,
            depth,
            steepness,
            stretch,
            direction: [angle.cos(), angle.sin()],
            rings: kind.rings,
        }
    }

    fn shade(&self, window: &mut [f32], width: usize) {
        // A ring fades with e^-u of its distance, a shadow with its steepness.
        let fades = if self.rings > 0.0 { 10.0 } else { 1.0 };
        let reach = (self.depth / FAINTEST)
            .powf(0.5 / f64::from(self.steepness))
            .max(fades);
        let reach = (self.radius * self.stretch * reach + 1.0) as i64;
        let rows = |at: f64, n: usize| {
            let middle = at as i64;
            ((middle - reach).max(0) as usize)..((middle + reach + 1).clamp(0, n as i64) as usize)
        };
        let height = window.len() / width;
        for y in rows(self.at[1], height) {
            for x in rows(self.at[0], width) {
                let (dx, dy) = (x as f64 - self.at[0], y as f64 - self.at[1]);
                let shade = self.taken(dx, dy);
                if shade.abs() > FAINTEST {
                    window[y * width + x] *= 1.0 - shade as f32;
                }
            }
        }
    }

    /// Share of the light that is taken: flat in the middle, half the depth at the radius. Rings take and give.
    fn taken(&self, dx: f64, dy: f64) -> f64 {
        let d_sq = if self.stretch > 1.0 {
            let [c, s] = self.direction;
            let (along, across) = (c * dx + s * dy, c * dy - s * dx);
            (along / self.stretch).powi(2) + across.powi(2)
        } else {
            dx.powi(2) + dy.powi(2)
        };
        let u_sq = d_sq / (self.radius * self.radius);
        let shadow = self.depth / (1.0 + u_sq.powi(self.steepness));
        if self.rings == 0.0 {
            return shadow;
        }
        // The phase of a zone plate grows with the square of the distance.
        let ripple = (std::f64::consts::PI * u_sq).sin() * (-u_sq.sqrt()).exp();
        shadow + self.depth * self.rings * ripple
    }
}

/// How much of a pixel a reticle's lines cover, 0..1.
fn reticle_share(mark: &Mark, p: [f64; 2]) -> f64 {
    let Mark::Reticle {
        centre_px,
        arm_px,
        line_px,
        tick_px,
        circles_px,
        ..
    } = mark
    else {
        return 0.0;
    };
    let (x, y) = (p[0] - centre_px[0], p[1] - centre_px[1]);
    let line = |off: f64| (0.5 * line_px + 0.5 - off.abs()).clamp(0.0, 1.0);
    // Along and across the nearer arm.
    let (along, across) = if x.abs() > y.abs() { (x, y) } else { (y, x) };
    let mut share = 0.0f64;
    if along.abs() <= *arm_px {
        share = line(across);
        if *tick_px > 0.0 && across.abs() <= 4.0 * line_px + 2.0 {
            let tick = (along / tick_px).round() * tick_px;
            share = share.max(line(along - tick));
        }
    }
    for radius in circles_px {
        share = share.max(line(x.hypot(y) - radius));
    }
    share
}
