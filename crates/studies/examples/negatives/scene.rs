//! What is under the microscope, what is wrong with the camera, and where the slide is put back. All from a number.

use crate::fault::{CameraFault, draw_fault};
use clap::ValueEnum;
use scopeservo_geometry::SplitMix64;
use scopeservo_scope::Axis;
use scopeservo_twin::{CellKind, Config, LatticeConfig, LatticeKind, MadeSpecimen, SparseConfig};
use serde::{Deserialize, Serialize};

/// What is tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Family {
    /// Whole runs to sparse or blank targets under a camera with something fixed to it, and the same runs without.
    Camera,
    /// Whole runs to specimens that repeat themselves.
    Lattice,
    /// Single pairs of frames of both, as `register` sees them.
    Pairs,
}

/// So many different instruments there are: offsets, noise and calibration of each are its own.
const INSTRUMENTS: u64 = 6;
/// Size of a pixel of the 40x objective, um.
pub(crate) const UM_PER_PX: f64 = 0.5083;

/// One situation.
pub(crate) struct Scene {
    /// Where and how often things are, in words; the table groups by it.
    pub(crate) kind: String,
    /// What is under the microscope.
    pub(crate) specimen: MadeSpecimen,
    /// Of a lattice.
    pub(crate) pitch_px: Option<f64>,
    /// What is wrong with the camera; the usual dust when nothing is.
    pub(crate) fault: Option<CameraFault>,
    /// Which instrument it is.
    pub(crate) instrument: Instrument,
    /// Specimen point in the middle of the target, um.
    pub(crate) target_um: [f64; 2],
    /// Specimen point under the view's centre after the slide was put back, seen from the target, um.
    pub(crate) start_um: [f64; 2],
    /// How far the slide is turned then.
    pub(crate) turn_deg: f64,
}

/// What a calibration is good for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(crate) struct Instrument {
    /// Of offsets, noise and pattern.
    pub(crate) seed: u64,
    /// Without a focus drive: no sweep that finds nothing stands in the way.
    pub(crate) by_hand: bool,
    /// 1: 40x alone; 3: all.
    pub(crate) objectives: usize,
}

impl Instrument {
    /// The instrument without anything fixed to its camera.
    pub(crate) fn config(&self) -> Config {
        let mut config = Config::realistic();
        if self.by_hand {
            config.stage.axes.retain(|a| a.axis != Axis::Z);
            // Whoever puts the slide back focuses.
            config.slide.seat_um = 0.0;
        }
        if self.objectives == 1 {
            config.optics.retain(|o| o.id.0 == "40x");
        }
        config.camera.dust.clear();
        config
    }
}

/// A number between two, evenly.
pub(crate) fn between(rng: &mut SplitMix64, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.uniform()
}

/// A number between two, evenly in its logarithm.
pub(crate) fn log_between(rng: &mut SplitMix64, low: f64, high: f64) -> f64 {
    between(rng, low.ln(), high.ln()).exp()
}

fn pick<T: Copy>(rng: &mut SplitMix64, all: &[T]) -> T {
    all[rng.below(all.len())]
}

impl Scene {
    /// The situation of this number. The same for any number of objectives but for the instrument.
    pub(crate) fn draw(family: Family, index: u64, objectives: usize) -> Self {
        // Numbers of one family never meet those of another.
        let stream = (family as u64 + 1) << 40;
        let mut rng = SplitMix64::new(SplitMix64::new(stream ^ index).next_u64());
        let of_lattice = match family {
            Family::Camera => false,
            Family::Lattice => true,
            Family::Pairs => index % 2 == 1,
        };
        let target_um = [
            between(&mut rng, -2000.0, 2000.0),
            between(&mut rng, -2000.0, 2000.0),
        ];
        let instrument = Instrument {
            seed: 1 + rng.next_u64() % INSTRUMENTS,
            by_hand: rng.below(2) == 1,
            objectives,
        };
        // Pairs take every second number each.
        let turn = match family {
            Family::Pairs => index / 2,
            _ => index,
        };
        let (kind, specimen, pitch_px, fault) = if of_lattice {
            let (kind, lattice) = draw_lattice(turn, target_um, &mut rng);
            let pitch_px = lattice.pitch_um / UM_PER_PX;
            (kind, MadeSpecimen::Lattice(lattice), Some(pitch_px), None)
        } else {
            let (target, specimen) = draw_sparse(&mut rng);
            let (name, fault) = draw_fault(turn, &mut rng);
            (format!("{target}, {name}"), specimen, None, Some(fault))
        };
        let mut scene = Self {
            kind,
            specimen,
            pitch_px,
            fault,
            instrument,
            target_um,
            start_um: [0.0; 2],
            turn_deg: between(&mut rng, -4.0, 4.0),
        };
        loop {
            // A pair may also show places that have nothing in common.
            let far = family == Family::Pairs && rng.below(2) == 1;
            let distance_um = match far {
                true => between(&mut rng, 600.0, 2000.0),
                false => between(&mut rng, 20.0, 120.0),
            };
            let (s, c) = between(&mut rng, 0.0, std::f64::consts::TAU).sin_cos();
            scene.start_um = [distance_um * c, distance_um * s];
            if scene.is_off_the_lattice() {
                return scene;
            }
        }
    }

    /// What else there is to know of it.
    pub(crate) fn note(&self) -> String {
        let mut notes = Vec::new();
        if self.instrument.by_hand {
            notes.push("no focus drive");
        }
        notes.extend(
            self.fault
                .as_ref()
                .map(|f| f.story)
                .filter(|s| !s.is_empty()),
        );
        if let MadeSpecimen::Lattice(lattice) = &self.specimen {
            notes.extend(lattice.numbered.then_some("numbered"));
            notes.extend(lattice.odd_cell.map(|_| "a cell is missing"));
        }
        notes.join(", ")
    }

    /// Whether the slide lies off by no multiple of the period: a tenth of it at least.
    fn is_off_the_lattice(&self) -> bool {
        let MadeSpecimen::Lattice(lattice) = &self.specimen else {
            return true;
        };
        let (s, c) = lattice.turned_deg.to_radians().sin_cos();
        let [x, y] = self.start_um.map(|v| v / lattice.pitch_um);
        let (u, v) = (c * x + s * y, c * y - s * x);
        let off = |v: f64| (v - v.round()).abs();
        let (row, shift) = match lattice.kind {
            LatticeKind::Hexagonal => (0.75f64.sqrt(), 0.5),
            LatticeKind::Chequer => (0.5, 0.5),
            LatticeKind::Grating => return off(u) > 0.1,
            LatticeKind::Square | LatticeKind::Lines | LatticeKind::Dies => (1.0, 0.0),
        };
        let nearest_row = (v / row).round() as i64;
        (nearest_row - 1..=nearest_row + 1).all(|j| {
            let u = if j % 2 == 0 { u } else { u - shift };
            off(u).hypot(v - j as f64 * row) > 0.1
        })
    }
}

/// A smear of single cells, a weakly stained one, or blank glass.
fn draw_sparse(rng: &mut SplitMix64) -> (&'static str, MadeSpecimen) {
    let seed = rng.next_u64();
    let smear = |rng: &mut SplitMix64, contrast: [f64; 2]| {
        MadeSpecimen::Sparse(SparseConfig {
            seed,
            per_mm2: log_between(rng, 60.0, 900.0),
            contrast: between(rng, contrast[0], contrast[1]),
            ..SparseConfig::default()
        })
    };
    match rng.below(8) {
        0 | 1 => ("blank", MadeSpecimen::Blank {}),
        2 | 3 => ("weak", smear(rng, [0.05, 0.2])),
        _ => ("sparse", smear(rng, [0.3, 0.9])),
    }
}

/// Five kinds in turn, ordered and with 5 % disorder; some have a cell that is missing or numbers.
fn draw_lattice(turn: u64, target_um: [f64; 2], rng: &mut SplitMix64) -> (String, LatticeConfig) {
    let kinds = [
        ("square", LatticeKind::Square),
        ("hexagonal", LatticeKind::Hexagonal),
        ("grating", LatticeKind::Grating),
        ("chequer", LatticeKind::Chequer),
        ("dies", LatticeKind::Dies),
    ];
    let (name, kind) = kinds[(turn % 5) as usize];
    let disorder = [0.0, 0.05][(turn / 5 % 2) as usize];
    let pitch_um = UM_PER_PX * log_between(rng, 5.0, 200.0);
    let mut lattice = LatticeConfig {
        seed: rng.next_u64(),
        kind,
        cells: pick(rng, &[CellKind::Discs, CellKind::Squares, CellKind::Cells]),
        pitch_um,
        turned_deg: between(rng, 0.0, 90.0),
        fill: between(rng, 0.4, 0.8),
        disorder,
        contrast: between(rng, 0.3, 0.9),
        holes: rng.below(3) == 0 && kind != LatticeKind::Dies,
        ..LatticeConfig::default()
    };
    if kind == LatticeKind::Dies {
        lattice.fill = 0.9;
        lattice.numbered = rng.below(4) == 0;
    }
    if rng.below(6) == 0 {
        // Near the target: both views show it.
        let (s, c) = lattice.turned_deg.to_radians().sin_cos();
        let [x, y] = target_um.map(|v| v / pitch_um);
        lattice.odd_cell = Some([
            (c * x + s * y).round() as i64,
            (c * y - s * x).round() as i64,
        ]);
    }
    let share = (100.0 * disorder) as u32;
    (format!("{name}, disorder {share} %"), lattice)
}
