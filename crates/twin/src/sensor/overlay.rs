//! What a camera or its program writes into an image after the read-out.

use crate::camera_config::{CameraConfig, Mark};
use crate::font;
use scopeservo_scope::{Axis, StagePose};

/// Writes every line of text into the numbers of an image. `place` is what the stage reports.
pub(super) fn write(config: &CameraConfig, top: u16, place: &StagePose, levels: &mut [u16]) {
    for mark in &config.marks {
        let (said, at_px, dot_px, level, box_level) = match mark {
            Mark::Text {
                text,
                at_px,
                dot_px,
                level,
                box_level,
            } => (text.clone(), at_px, dot_px, level, box_level),
            Mark::StagePlace {
                at_px,
                dot_px,
                level,
                box_level,
                packed,
            } => (digits(place, *packed), at_px, dot_px, level, box_level),
            Mark::Reticle { .. } => continue,
        };
        let number = |share: f64| (share * f64::from(top)).round() as u16;
        let line = Line {
            text: &said,
            at_px: *at_px,
            dot_px: *dot_px,
            ink: number(*level),
            ground: box_level.map(number),
        };
        line.write(config, levels);
    }
}

/// "X:1234.5 Y:-20.0 Z:3.1", um, for the axes that there are. Labels keep their places, unless packed.
pub(super) fn digits(place: &StagePose, packed: bool) -> String {
    let wide = if packed { 0 } else { 8 };
    let axes = [("X", Axis::X), ("Y", Axis::Y), ("Z", Axis::Z)];
    let told: Vec<String> = axes
        .iter()
        .filter_map(|&(label, axis)| Some(format!("{label}:{:>wide$.1}", place.si(axis)? * 1e6)))
        .collect();
    told.join(" ")
}

struct Line<'a> {
    text: &'a str,
    at_px: [i64; 2],
    dot_px: usize,
    ink: u16,
    ground: Option<u16>,
}

impl Line<'_> {
    fn write(&self, config: &CameraConfig, levels: &mut [u16]) {
        let channels = config.channels.count();
        let n = self.dot_px as i64;
        // One dot of ground all around.
        let (across, down) = (font::width(self.text) as i64 + 1, font::HIGH as i64 + 2);
        let ends = |at: i64, dots: i64, size: usize| {
            (at - n).max(0)..(at - n).saturating_add(dots * n).min(size as i64)
        };
        for y in ends(self.at_px[1], down, config.height) {
            for x in ends(self.at_px[0], across, config.width) {
                let (i, j) = (
                    (x - self.at_px[0]).div_euclid(n),
                    (y - self.at_px[1]).div_euclid(n),
                );
                let inked = i >= 0 && j >= 0 && font::dot(self.text, i as usize, j as usize);
                if let Some(v) = if inked { Some(self.ink) } else { self.ground } {
                    let at = channels * (y as usize * config.width + x as usize);
                    levels[at..at + channels].fill(v);
                }
            }
        }
    }
}
