//! What each pixel does to every image.

use super::normal::normal_table;
use crate::camera_config::{CameraConfig, PatternConfig};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

/// Gain and offset of every pixel.
pub(super) struct Pattern {
    gain: Vec<f32>,
    offset_e: Vec<f32>,
}

impl Pattern {
    /// `None` for a camera without any.
    pub(super) fn draw(config: &CameraConfig, rng: &mut Pcg64Mcg) -> Option<Self> {
        let p = &config.pattern;
        if *p == PatternConfig::default() {
            return None;
        }
        let table = normal_table();
        let mut unit = || f64::from(table[rng.random::<u64>() as usize % table.len()]);
        let columns: Vec<[f64; 2]> = (0..config.width)
            .map(|_| [p.column_gain * unit(), p.column_offset_e * unit()])
            .collect();
        let count = config.width * config.height;
        let (mut gain, mut offset_e) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for i in 0..count {
            let [column_gain, column_offset_e] = columns[i % config.width];
            gain.push((1.0 + column_gain + p.gain * unit()) as f32);
            offset_e.push((column_offset_e + p.offset_e * unit()) as f32);
        }
        Some(Self { gain, offset_e })
    }

    /// The electrons that pixel `i` shows.
    pub(super) fn apply(&self, i: usize, electrons: f32) -> f32 {
        electrons * self.gain[i] + self.offset_e[i]
    }
}
