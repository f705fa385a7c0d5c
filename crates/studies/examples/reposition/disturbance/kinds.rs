//! How a view may be disturbed.

use super::camera::Change;
use scopeservo_geometry::SplitMix64;
use scopeservo_twin::{DustConfig, SpecimenEvent, Twin};

/// What is done to the microscope, and to its images.
type What = fn(&Twin, [f64; 2], &mut SplitMix64) -> Vec<Change>;

/// One way.
pub(crate) struct Kind {
    pub(crate) name: &'static str,
    pub(crate) what: What,
}

fn two(rng: &mut SplitMix64) -> [f64; 2] {
    [rng.uniform(), rng.uniform()]
}

fn dust(twin: &Twin, rng: &mut SplitMix64, steepness: i32, radius_px: [f64; 2], specks: usize) {
    let dust = DustConfig {
        specks,
        radius_px,
        attenuation: [0.3, 0.9],
        steepness: [steepness; 2],
        ..DustConfig::default()
    };
    // What can be drawn was checked when this was written.
    let _ = twin.settle_dust(&[dust], (rng.uniform() * 1e9) as u64);
}

/// Somewhere around a place of the specimen, um.
fn near([x, y]: [f64; 2], rng: &mut SplitMix64, um: f64) -> [f64; 2] {
    let [a, b] = two(rng);
    [x + um * (2.0 * a - 1.0), y + um * (2.0 * b - 1.0)]
}

/// Each alone. Things on the specimen lie around the target.
pub(crate) const ALONE: [Kind; 18] = [
    Kind {
        name: "nothing",
        what: |_, _, _| Vec::new(),
    },
    Kind {
        name: "mask of 20 %",
        what: |_, _, rng| vec![Change::Mask(0.2, two(rng))],
    },
    Kind {
        name: "mask of 40 %",
        what: |_, _, rng| vec![Change::Mask(0.4, two(rng))],
    },
    Kind {
        name: "blur, sigma 2 px",
        what: |_, _, _| vec![Change::Blur(2.0)],
    },
    Kind {
        name: "blur, sigma 4 px",
        what: |_, _, _| vec![Change::Blur(4.0)],
    },
    Kind {
        name: "grey -80",
        what: |_, _, _| vec![Change::Add(-80.0)],
    },
    Kind {
        name: "light x0.1",
        what: |_, _, _| vec![Change::Times(0.1)],
    },
    Kind {
        name: "light x1.8",
        what: |_, _, _| vec![Change::Times(1.8)],
    },
    Kind {
        name: "gamma 0.5",
        what: |_, _, _| vec![Change::Gamma(0.5)],
    },
    Kind {
        name: "gamma 2",
        what: |_, _, _| vec![Change::Gamma(2.0)],
    },
    Kind {
        name: "noise, sigma 15",
        what: |_, _, _| vec![Change::Noise(15.0)],
    },
    Kind {
        name: "another stain",
        what: |twin, _, _| {
            twin.inject(SpecimenEvent::counterstain());
            Vec::new()
        },
    },
    Kind {
        name: "contrast x0.4",
        what: |_, _, _| vec![Change::Contrast(0.4)],
    },
    Kind {
        name: "uneven light",
        what: |_, _, rng| vec![Change::Uneven(two(rng).map(|v| 0.8 * v - 0.4))],
    },
    Kind {
        name: "hard dust",
        what: |twin, _, rng| {
            dust(twin, rng, 60, [3.0, 12.0], 30);
            Vec::new()
        },
    },
    Kind {
        name: "soft dust",
        what: |twin, _, rng| {
            dust(twin, rng, 2, [10.0, 40.0], 15);
            Vec::new()
        },
    },
    Kind {
        name: "bubble",
        what: |twin, target, rng| {
            twin.inject(SpecimenEvent::Bubble {
                centre_um: near(target, rng, 120.0),
                radius_um: 60.0,
            });
            Vec::new()
        },
    },
    Kind {
        name: "debris",
        what: |twin, target, rng| {
            for _ in 0..12 {
                twin.inject(SpecimenEvent::Occlusion {
                    centre_um: near(target, rng, 200.0),
                    size_um: two(rng).map(|v| 5.0 + 30.0 * v),
                    rgb: [60, 50, 40],
                });
            }
            Vec::new()
        },
    },
];

/// The paper's three, at 20x.
pub(crate) const PAPER: [Kind; 3] = [
    Kind {
        name: "paper: mask 120 x 120",
        what: |_, _, rng| vec![Change::Square(120, two(rng))],
    },
    Kind {
        name: "paper: blur",
        what: |_, _, _| vec![Change::Blur(2.0)],
    },
    Kind {
        name: "paper: grey -80",
        what: |_, _, _| vec![Change::Add(-80.0)],
    },
];

/// More than is asked for: what is aimed at, alone.
pub(crate) const AIMED_AT: [Kind; 3] = [
    Kind {
        name: "aimed at: blur, sigma 8 px",
        what: |_, _, _| vec![Change::Blur(8.0)],
    },
    Kind {
        name: "aimed at: mask of 60 %",
        what: |_, _, rng| vec![Change::Mask(0.6, two(rng))],
    },
    Kind {
        name: "aimed at: mask of 90 %",
        what: |_, _, rng| vec![Change::Mask(0.9, two(rng))],
    },
];
