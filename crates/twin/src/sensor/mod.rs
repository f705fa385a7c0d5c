//! From light to numbers: illumination, exposure, noise, dust, patterns, dead pixels, quantisation, what is written on top.

mod dust;
mod normal;
mod overlay;
mod pattern;

use crate::camera_config::{CameraConfig, DustConfig};
use crate::config::ObjectiveConfig;
use crate::faults::DriftingHair;
use crate::scene::Planes;
use crate::seeds;
use normal::normal_table;
use pattern::Pattern;
use rand::RngExt;
use rayon::prelude::*;
use scopeservo_scope::{Channels, Samples, StagePose};
use std::sync::Arc;

/// What one camera has and another has not: a pattern, dead pixels, the dust it came with.
pub(crate) struct Sensor {
    config: CameraConfig,
    seed: u64,
    window: Arc<Vec<f32>>,
    pattern: Option<Pattern>,
    dead: Vec<Dead>,
    normal: Vec<f32>,
}

struct Dead {
    index: usize,
    channel: usize,
    bright: bool,
}

/// One exposure, apart from its light.
pub(crate) struct Exposure<'a> {
    pub(crate) ms: f64,
    /// False while the nosepiece blocks the beam.
    pub(crate) lit: bool,
    pub(crate) sequence: u64,
    /// Light that passes dust and reticle, per pixel.
    pub(crate) window: &'a [f32],
    /// Where the stage says that it is.
    pub(crate) place: &'a StagePose,
}

impl Sensor {
    pub(crate) fn new(config: &CameraConfig, seed: u64) -> Self {
        let mut rng = seeds::rng(seed, seeds::SENSOR, 0);
        let mut window = dust::clean_window(config);
        dust::settle(&mut window, config.width, &config.dust, &mut rng);
        let pixels = (config.width * config.height) as f64;
        let dead = (0..config.dead_pixels)
            .map(|_| Dead {
                index: (rng.random::<f64>() * pixels) as usize,
                channel: (rng.random::<f64>() * 3.0) as usize,
                bright: rng.random(),
            })
            .collect();
        Self {
            config: config.clone(),
            seed,
            window: Arc::new(window),
            pattern: Pattern::draw(config, &mut seeds::rng(seed, seeds::SENSOR, 1)),
            dead,
            normal: normal_table(),
        }
    }

    /// The window as it was made, with its dust.
    pub(crate) fn window(&self) -> Arc<Vec<f32>> {
        self.window.clone()
    }

    /// The window after somebody cleaned it.
    pub(crate) fn clean_window(&self) -> Arc<Vec<f32>> {
        Arc::new(dust::clean_window(&self.config))
    }

    /// A window on which more dust has settled, drawn from a seed of its own.
    pub(crate) fn settle(&self, window: &[f32], kinds: &[DustConfig], seed: u64) -> Arc<Vec<f32>> {
        let mut window = window.to_vec();
        let mut rng = seeds::rng(seed, seeds::SENSOR, 2);
        dust::settle(&mut window, self.config.width, kinds, &mut rng);
        Arc::new(window)
    }

    /// A window with a hair before it that has drifted for some seconds.
    pub(crate) fn behind(
        &self,
        window: &[f32],
        hair: &DriftingHair,
        seconds: f64,
    ) -> Arc<Vec<f32>> {
        let mut window = window.to_vec();
        dust::hair(&mut window, self.config.width, hair, seconds);
        Arc::new(window)
    }

    /// Reads the image out.
    pub(crate) fn develop(
        &self,
        light: &Planes,
        optics: &ObjectiveConfig,
        exposure: &Exposure<'_>,
    ) -> Samples {
        let channels = self.config.channels.count();
        let mut levels = vec![0u16; exposure.window.len() * channels];
        levels
            .par_chunks_mut(self.config.width * channels)
            .enumerate()
            .for_each(|(y, row)| {
                self.develop_row(light, optics, exposure, y, row);
            });
        let top = full_scale(self.config.bit_depth);
        for d in &self.dead {
            let at = match self.config.channels {
                Channels::Gray => d.index,
                Channels::Rgb => 3 * d.index + d.channel,
            };
            levels[at] = if d.bright { top } else { 0 };
        }
        overlay::write(&self.config, top, exposure.place, &mut levels);
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
        exposure: &Exposure<'_>,
        y: usize,
        row: &mut [u16],
    ) {
        let config = &self.config;
        let w = config.width;
        let stream = (exposure.sequence << 14) ^ y as u64;
        let mut rng = seeds::rng(self.seed, seeds::PIXELS, stream);
        let strength = match exposure.lit {
            true => exposure.ms / config.nominal_exposure_ms,
            false => 0.0,
        };
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
        let window = &exposure.window[y * w..(y + 1) * w];
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
                if let Some(pattern) = &self.pattern {
                    electrons = pattern.apply(y * w + x, electrons);
                }
                let level = electrons.min(full_well) * level_per_e;
                *out = (level + 0.5).clamp(0.0, top) as u16;
            }
        }
    }
}

fn full_scale(bit_depth: u8) -> u16 {
    ((1u32 << bit_depth) - 1) as u16
}

#[cfg(test)]
mod tests;
