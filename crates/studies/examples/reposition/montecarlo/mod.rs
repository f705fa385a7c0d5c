//! The paper's repeated repositioning (Section V-B): specimens of three kinds, each a number of times, focus and calibration reused. Every start
//! is run by the paper's law, by direct control, and by direct control with calibrations that are as far off as the paper's scatter.

mod page;

use crate::many::{EACH, Many};
use crate::scene::{Known, Scene, draw, of};
use crate::whole::{self, Record};
use scopeservo_geometry::{Mat2, SplitMix64};
use scopeservo_scope::ObjectiveId;
use scopeservo_servo::{Calibration, Law, RepositionOptions};
use scopeservo_studies::rounds::{Outcome, rounds};
use serde::{Deserialize, Serialize};
use std::fs;

/// Numbers of the specimens of `scene.rs`: in place of porcine pancreas, frog liver and mesophytic root a carcinoma, a liver and an embryo.
const SPECIMENS: [u64; 3] = [1, 3, 5];

/// How a start is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Method {
    /// A fifth of the error at a time, at every magnification.
    Paper,
    /// Direct control.
    Direct,
    /// Direct control, with calibrations off by the standard deviations of the paper's Table II, and nobody told.
    DirectOff,
}

impl Method {
    const ALL: [Self; 3] = [Self::Paper, Self::Direct, Self::DirectOff];

    fn name(self) -> &'static str {
        match self {
            Self::Paper => "the paper's law",
            Self::Direct => "direct control",
            Self::DirectOff => "direct, calibration off as the paper's",
        }
    }

    fn options(self) -> RepositionOptions {
        let mut options = RepositionOptions {
            reuse_focus: true,
            ..RepositionOptions::default()
        };
        options.servo.law = match self {
            Self::Paper => Law::Proportional,
            Self::Direct | Self::DirectOff => Law::Direct,
        };
        options
    }
}

/// What one run came to.
#[derive(Debug, Serialize, Deserialize)]
struct Run {
    number: u64,
    method: Method,
    record: Record,
}

/// Table II: standard deviations of scale (of itself), angle (deg) and rotation centre (mm) at 100x, 200x and 400x.
const SCATTER: [(&str, [f64; 3]); 3] = [
    ("10x", [0.0009, 0.0198, 0.1072]),
    ("20x", [0.0014, 0.0401, 0.1570]),
    ("40x", [0.0015, 0.0597, 0.2071]),
];

/// A calibration of the paper's scatter.
fn scattered(
    (id, calibration): (ObjectiveId, Calibration),
    rng: &mut SplitMix64,
) -> (ObjectiveId, Calibration) {
    let scatter = SCATTER.iter().find(|(name, _)| *name == id.0);
    let [scale, deg, mm] = scatter.map_or([0.0; 3], |s| s.1);
    // Twelve uniform numbers less six are normal enough.
    let mut normal = || (0..12).map(|_| rng.uniform()).sum::<f64>() - 6.0;
    let zoom = Mat2::diagonal(1.0 + scale * normal(), 1.0 + scale * normal());
    let turn = Mat2::rotation((deg * normal()).to_radians());
    let mut off_m = || 1e-3 * mm * normal();
    let centre = calibration.rotation_centre_m;
    let off = Calibration {
        stage_from_pixel: turn * zoom * calibration.stage_from_pixel,
        rotation_centre_m: centre.map(|[x, y]| [x + off_m(), y + off_m()]),
        ..calibration
    };
    (id, off)
}

/// A start on the paper's hexapod. Those of even repeats begin at 400x, the others at 100x.
fn scene(specimen: u64, repeat: u64) -> Scene {
    Scene {
        begins_with: if repeat.is_multiple_of(2) {
            "40x"
        } else {
            "10x"
        },
        focused_before: &["10x", "20x"],
        // An even number is one of the hexapod; the twelve before the next have one of each specimen.
        ..draw(2 * (specimen + 6 * repeat))
    }
}

fn run(number: u64, known: &[Known], trace: bool) -> Outcome<Run> {
    let (kind, repeat) = ((number / EACH) as usize, number % EACH);
    let (specimen, method) = (SPECIMENS[kind / 3], Method::ALL[kind % 3]);
    let scene = scene(specimen, repeat);
    let mut known = of(known, &scene);
    if method == Method::DirectOff {
        let mut rng = SplitMix64::new(0x7AB1E ^ number);
        known = known.into_iter().map(|k| scattered(k, &mut rng)).collect();
    }
    let record = whole::run(&scene, repeat, known, method.options(), trace)?;
    Ok(Run {
        number,
        method,
        record,
    })
}

/// Makes the runs, their tables and their page; returns how many answers were wrong.
pub(crate) fn study(many: &Many<'_>, known: &[Known]) -> Outcome<usize> {
    if let Some(number) = many.only {
        println!(
            "{}",
            serde_json::to_string_pretty(&run(number, known, true)?)?
        );
        return Ok(0);
    }
    let numbers = many.numbers(0..SPECIMENS.len() * Method::ALL.len());
    let file = |ending: &str| many.out.join(format!("montecarlo.{ending}"));
    let runs = rounds(
        &file("jsonl"),
        &numbers,
        many.threads,
        |r: &Run| r.number,
        |number| run(number, known, false),
    )?;
    fs::write(file("csv"), page::csv(&runs))?;
    fs::write(file("html"), page::page(&runs))?;
    Ok(page::print(&runs))
}
