//! What is fixed to the camera, when the view is saved and when the slide comes back.

use crate::scene::{between, log_between};
use scopeservo_geometry::SplitMix64;
use scopeservo_twin::{Config, DustConfig, Mark, PatternConfig, Twin, TwinError};

/// Something that moves with the camera.
#[derive(Default)]
pub(crate) struct CameraFault {
    marks: Vec<Mark>,
    pattern: PatternConfig,
    /// Dust while the view is saved...
    saved: Option<Dust>,
    /// ...and while it is looked for.
    back: Option<Dust>,
    /// What the dust does in between.
    pub(crate) story: &'static str,
}

/// Dust, drawn from a seed.
#[derive(Clone)]
struct Dust {
    kinds: Vec<DustConfig>,
    seed: u64,
}

impl CameraFault {
    /// What is there from the beginning on.
    pub(crate) fn build_into(&self, config: &mut Config) {
        config.camera.marks = self.marks.clone();
        config.camera.pattern = self.pattern;
    }

    /// The window while the view is saved.
    pub(crate) fn save(&self, twin: &Twin) -> Result<(), TwinError> {
        settle(twin, self.saved.as_ref())
    }

    /// The window while it is looked for.
    pub(crate) fn come_back(&self, twin: &Twin) -> Result<(), TwinError> {
        settle(twin, self.back.as_ref())
    }
}

fn settle(twin: &Twin, dust: Option<&Dust>) -> Result<(), TwinError> {
    twin.clean_window();
    dust.map_or(Ok(()), |d| twin.settle_dust(&d.kinds, d.seed))
}

/// Eight kinds in turn. Dust was there at saving, came, went, or is other dust in the end.
pub(crate) fn draw_fault(turn: u64, rng: &mut SplitMix64) -> (&'static str, CameraFault) {
    let mut fault = CameraFault::default();
    let name = match turn % 8 {
        0 => {
            lie(&mut fault, vec![hard(rng)], rng);
            "hard dust"
        }
        1 => {
            lie(&mut fault, vec![soft(rng)], rng);
            "soft dust"
        }
        2 => {
            let kinds = vec![hard(rng), soft(rng), fibres(rng)];
            lie(&mut fault, kinds, rng);
            "any dust"
        }
        3 => {
            fault.marks = text(rng);
            "text"
        }
        4 => {
            fault.marks = vec![place(rng)];
            "coordinates"
        }
        5 => {
            fault.marks = vec![reticle(rng)];
            "reticle"
        }
        6 => {
            fault.pattern = pattern(rng);
            "pattern"
        }
        _ => {
            fault.marks = text(rng);
            fault.marks.push(place(rng));
            fault.marks.push(reticle(rng));
            fault.pattern = pattern(rng);
            let kinds = vec![hard(rng), soft(rng)];
            lie(&mut fault, kinds, rng);
            "mixture"
        }
    };
    (name, fault)
}

/// Most dust stays; some comes, goes, or is wiped off and replaced.
fn lie(fault: &mut CameraFault, kinds: Vec<DustConfig>, rng: &mut SplitMix64) {
    let mut dust = || {
        Some(Dust {
            kinds: kinds.clone(),
            seed: rng.next_u64(),
        })
    };
    let (first, other) = (dust(), dust());
    (fault.story, fault.saved, fault.back) = match rng.below(8) {
        0 => ("the dust came", None, first),
        1 => ("the dust went", first, None),
        2 => ("other dust came", first, other),
        _ => ("", first.clone(), first),
    };
}

fn hard(rng: &mut SplitMix64) -> DustConfig {
    DustConfig {
        specks: 5 + rng.below(80),
        radius_px: [1.0, log_between(rng, 2.0, 15.0)],
        attenuation: [0.15, between(rng, 0.3, 0.95)],
        steepness: [15, 60],
        stretch: [1.0, between(rng, 1.0, 3.0)],
        rings: between(rng, 0.0, 0.5),
    }
}

fn soft(rng: &mut SplitMix64) -> DustConfig {
    DustConfig {
        specks: 5 + rng.below(60),
        radius_px: [3.0, log_between(rng, 5.0, 60.0)],
        attenuation: [0.03, between(rng, 0.1, 0.35)],
        steepness: [1, 4],
        stretch: [1.0, between(rng, 1.0, 2.0)],
        rings: between(rng, 0.0, 0.3),
    }
}

fn fibres(rng: &mut SplitMix64) -> DustConfig {
    DustConfig {
        specks: 1 + rng.below(8),
        radius_px: [1.0, 3.0],
        attenuation: [0.1, 0.6],
        steepness: [3, 20],
        stretch: [8.0, 40.0],
        rings: 0.0,
    }
}

/// Bright or dark, with a box behind it or without.
fn ink(rng: &mut SplitMix64) -> (f64, Option<f64>) {
    match rng.below(4) {
        0 => (1.0, None),
        1 => (0.0, None),
        2 => (1.0, Some(0.0)),
        _ => (0.0, Some(1.0)),
    }
}

fn text(rng: &mut SplitMix64) -> Vec<Mark> {
    let lines = [
        "Laboratory 3, microscope 2",
        "Sample 20-1147 HE",
        "40x NA 0.65  10 ms",
        "26 Nov 2026 10:14",
        "50 um",
    ];
    let (level, box_level) = ink(rng);
    let dot_px = 1 + rng.below(3);
    (0..1 + rng.below(4))
        .map(|i| Mark::Text {
            text: lines[rng.below(lines.len())].into(),
            at_px: [
                8 + rng.below(200) as i64,
                8 + rng.below(60) as i64 + 110 * i as i64,
            ],
            dot_px,
            level,
            box_level,
        })
        .collect()
}

fn place(rng: &mut SplitMix64) -> Mark {
    let (level, box_level) = ink(rng);
    Mark::StagePlace {
        at_px: [8 + rng.below(100) as i64, 380 + rng.below(60) as i64],
        dot_px: 1 + rng.below(3),
        level,
        box_level,
        packed: false,
    }
}

fn reticle(rng: &mut SplitMix64) -> Mark {
    Mark::Reticle {
        centre_px: [between(rng, 280.0, 360.0), between(rng, 200.0, 280.0)],
        arm_px: between(rng, 60.0, 320.0),
        line_px: between(rng, 0.7, 3.0),
        tick_px: between(rng, 8.0, 40.0),
        circles_px: (0..rng.below(3))
            .map(|_| between(rng, 20.0, 220.0))
            .collect(),
        attenuation: between(rng, 0.2, 0.95),
    }
}

fn pattern(rng: &mut SplitMix64) -> PatternConfig {
    PatternConfig {
        offset_e: log_between(rng, 5.0, 120.0),
        gain: log_between(rng, 0.003, 0.04),
        column_offset_e: log_between(rng, 5.0, 80.0),
        column_gain: log_between(rng, 0.001, 0.01),
    }
}
