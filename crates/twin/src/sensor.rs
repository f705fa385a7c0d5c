//! From light to numbers: illumination, exposure, noise, dust, dead pixels, quantisation.

use crate::config::{CameraConfig, ObjectiveConfig};
use crate::render::Planes;
use crate::seeds;
use rand::RngExt;
use rayon::prelude::*;
use scopeservo_scope::{Channels, Samples};

/// What one camera has and another has not: dust on its window, dead pixels.
pub(crate) struct Sensor {
    config: CameraConfig,
    seed: u64,
    /// Light that passes the dust, per pixel.
    window: Vec<f32>,
    dead: Vec<Dead>,
    normal: Vec<f32>,
}

struct Dead {
    index: usize,
    channel: usize,
    bright: bool,
}

impl Sensor {
    pub(crate) fn new(config: &CameraConfig, seed: u64) -> Self {
        let (w, h) = (config.width, config.height);
        let mut rng = seeds::rng(seed, seeds::SENSOR, 0);
        let mut window = vec![1.0f32; w * h];
        for _ in 0..config.dust_specks {
            let x = rng.random::<f64>() * w as f64;
            let y = rng.random::<f64>() * h as f64;
            let radius: f64 = rng.random_range(3.0..8.0);
            let [least, most] = config.dust_attenuation;
            let depth = least + (most - least) * rng.random::<f64>();
            for (i, v) in window.iter_mut().enumerate() {
                let d_sq = ((i % w) as f64 - x).powi(2) + ((i / w) as f64 - y).powi(2);
                // Out of focus: flat in the middle, soft at the edge, half at the radius.
                let shade = depth / (1.0 + (d_sq / (radius * radius)).powi(3));
                if shade > 1e-4 {
                    *v *= 1.0 - shade as f32;
                }
            }
        }
        let dead = (0..config.dead_pixels)
            .map(|_| Dead {
                index: (rng.random::<f64>() * (w * h) as f64) as usize,
                channel: (rng.random::<f64>() * 3.0) as usize,
                bright: rng.random(),
            })
            .collect();
        Self {
            config: config.clone(),
            seed,
            window,
            dead,
            normal: normal_table(),
        }
    }

    /// Reads the picture out. `exposure_ms` scales the light; `lit` is false while the nosepiece blocks the beam.
    pub(crate) fn develop(
        &self,
        light: &Planes,
        optics: &ObjectiveConfig,
        exposure_ms: f64,
        lit: bool,
        sequence: u64,
    ) -> Samples {
        let channels = self.config.channels.count();
        let mut levels = vec![0u16; self.window.len() * channels];
        levels
            .par_chunks_mut(self.config.width * channels)
            .enumerate()
            .for_each(|(y, row)| {
                let strength = if lit {
                    exposure_ms / self.config.nominal_exposure_ms
                } else {
                    0.0
                };
                self.develop_row(light, optics, strength, sequence, y, row);
            });
        let top = full_scale(self.config.bit_depth);
        for d in &self.dead {
            let at = match self.config.channels {
                Channels::Gray => d.index,
                Channels::Rgb => 3 * d.index + d.channel,
            };
            levels[at] = if d.bright { top } else { 0 };
        }
        if self.config.bit_depth == 8 {
            Samples::U8(levels.into_iter().map(|v| v as u8).collect())
        } else {
            Samples::U16(levels)
        }
    }

    fn develop_row(
        &self,
        light: &Planes,
        optics: &ObjectiveConfig,
        strength: f64,
        sequence: u64,
        y: usize,
        row: &mut [u16],
    ) {
        let config = &self.config;
        let w = config.width;
        let mut rng = seeds::rng(self.seed, seeds::PIXELS, (sequence << 14) ^ y as u64);
        let full_well = config.full_well_e as f32;
        let white = (strength * optics.brightness * config.white_level * config.full_well_e
            / config.gain) as f32;
        let top = f32::from(full_scale(config.bit_depth));
        let level_per_e = top * config.gain as f32 / full_well;
        let (half_w, half_h) = (0.5 * w as f32, 0.5 * config.height as f32);
        let v = (y as f32 + 0.5 - half_h) / half_h;
        let corner_sq = half_w * half_w + half_h * half_h;
        let noisy = config.shot_noise || config.read_noise_e > 0.0;
        let read_sq = (config.read_noise_e * config.read_noise_e) as f32;
        let shot = f32::from(u8::from(config.shot_noise));
        let channels = config.channels.count();
        let rows: [&[f32]; 3] = std::array::from_fn(|c| &light[c][y * w..(y + 1) * w]);
        let window = &self.window[y * w..(y + 1) * w];
        for (x, out) in row.chunks_exact_mut(channels).enumerate() {
            let u = (x as f32 + 0.5 - half_w) / half_w;
            let r_sq = (u * u * half_w * half_w + v * v * half_h * half_h) / corner_sq;
            let shade = (1.0 - optics.vignetting as f32 * r_sq)
                * (1.0 + optics.gradient[0] as f32 * u + optics.gradient[1] as f32 * v)
                * window[x]
                * white;
            let rgb = [rows[0][x], rows[1][x], rows[2][x]];
            let mut bits = if noisy { rng.random::<u64>() } else { 0 };
            for (c, out) in out.iter_mut().enumerate() {
                let value = match config.channels {
                    Channels::Gray => 0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2],
                    Channels::Rgb => rgb[c],
                };
                let mut electrons = (value * shade).max(0.0);
                if noisy {
                    let unit = self.normal[(bits & 0xfff) as usize];
                    bits >>= 12;
                    electrons += unit * (shot * electrons + read_sq).sqrt();
                }
                let level = electrons.min(full_well) * level_per_e;
                *out = (level + 0.5).clamp(0.0, top) as u16;
            }
        }
    }
}

/// 4096 equally probable values of the standard normal distribution, in rising order: a random number of 12 bits picks
/// one. Five times faster than drawing exactly, with tails cut at 3.5 standard deviations.
fn normal_table() -> Vec<f32> {
    const COUNT: usize = 4096;
    const STEP: f64 = 1e-4;
    let density = |x: f64| (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
    let (mut x, mut below) = (-6.0, 0.0);
    let mut table = Vec::with_capacity(COUNT);
    while table.len() < COUNT {
        below += STEP * density(x + 0.5 * STEP);
        x += STEP;
        // The share of the table filled so far, at the middle of the next entry.
        while table.len() < COUNT && (below >= (table.len() as f64 + 0.5) / COUNT as f64 || x > 6.0)
        {
            table.push(x as f32);
        }
    }
    table
}

fn full_scale(bit_depth: u8) -> u16 {
    ((1u32 << bit_depth) - 1) as u16
}

#[cfg(test)]
#[path = "sensor_tests.rs"]
mod tests;
