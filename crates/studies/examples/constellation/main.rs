//! Targets of few things, looked for by how they lie: how often a view of the lowest magnification is placed rightly where descriptors say nothing,
//! and how often a view that does not show the target is.
//!
//! `cargo run --release -p scopeservo-studies --example constellation -- --count 200`
//!
//! Smears of 20 to 640 cells a square millimetre, and scanned cytology (`SCOPESERVO_SPECIMENS`); targets are seen at 40x, views at 10x, turned by any angle,
//! with shot noise of 0.25 to 1 % of full scale at mid grey, out of focus by up to a third of the depth of field. Exit code 1 when an answer was wrong.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

use clap::Parser;
use scopeservo_features::{Features, GrayImage};
use scopeservo_geometry::SplitMix64;
use scopeservo_registration::constellation::constellation;
use scopeservo_registration::{
    Prior, Registration, RotationPrior, ScalePrior, find_rivals, register,
};
use scopeservo_scope::{Axis, CancelToken, Clock, Instrument, ObjectiveId, VirtualClock};
use scopeservo_servo::VisionOptions;
use scopeservo_studies::rounds::{Outcome, rounds, threads};
use scopeservo_twin::specimen::{FileSpecimen, Specimen};
use scopeservo_twin::{Config, Sparse, SparseConfig, StageConfig, Truth, Twin};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Few things, by how they lie.
#[derive(Parser)]
struct Args {
    /// Pairs of each family.
    #[arg(long, default_value_t = 200)]
    count: u64,
    /// Only this pair, told in full.
    #[arg(long)]
    only: Option<u64>,
    /// Threads; all processors unless told.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Where pairs are kept; what lies there is not made again. A new folder for a new build.
    #[arg(long, default_value = "target/constellation")]
    out: PathBuf,
}

/// What a view shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Family {
    /// The target, somewhere in it.
    Same,
    /// Another place of the smear.
    Elsewhere,
    /// Scanned cytology, the target somewhere in it.
    Scanned,
    /// Another place of it.
    ScannedElsewhere,
}

const FAMILIES: [Family; 4] = [
    Family::Same,
    Family::Elsewhere,
    Family::Scanned,
    Family::ScannedElsewhere,
];
/// Scanned cytology, um per pixel, and half of what is covered, um.
const SCANNED: [(&str, f64, f64); 2] = [
    ("cytology_scanner_a.tif", 0.25, 500.0),
    ("cytology_scanner_b.tif", 0.25, 500.0),
];
/// Nearer than this to the truth an answer is right, pixels of the view.
const RIGHT_PX: f64 = 2.0;

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Record {
    index: u64,
    family: Family,
    per_mm2: f64,
    features: usize,
    /// By descriptors, and by how things lie.
    by: [Answer; 2],
}

/// What one way of looking says.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Answer {
    found: bool,
    right: bool,
    ambiguous: bool,
    inliers: usize,
    places: usize,
    log10_nfa: f64,
    /// Of the target's centre, pixels of the view.
    off_px: Option<f64>,
    sigma_px: Option<f64>,
    why: String,
}

struct Bench {
    twin: Twin,
    scope: Instrument,
    vision: VisionOptions,
}

impl Bench {
    fn new(specimen: Arc<dyn Specimen>, noise: f64, seed: u64) -> Outcome<Self> {
        let mut config = Config::realistic().with_stage(StageConfig::xyz_theta());
        config.camera.full_well_e = 0.5 / (noise * noise);
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let twin = Twin::new(config, specimen, seed, clock)?;
        let scope = Instrument::new(twin.devices(), twin.rules(), CancelToken::new())?;
        Ok(Self {
            twin,
            scope,
            vision: VisionOptions::default(),
        })
    }

    /// A view with an objective, out of focus by so much.
    fn look(
        &self,
        id: &str,
        at_um: [f64; 2],
        turn_deg: f64,
        defocus_um: f64,
    ) -> Outcome<(GrayImage, Truth)> {
        self.scope.select_objective(&ObjectiveId(id.into()))?;
        self.twin.centre_specimen(at_um, turn_deg);
        for _ in 0..3 {
            let now = self.scope.stand_still()?;
            let nearer = self.twin.truth_now().defocus_um - defocus_um;
            let z = now.si(Axis::Z).unwrap_or_default() - nearer * 1e-6;
            self.scope.move_to(&now.with_si(Axis::Z, z))?;
        }
        let frame = self.scope.grab()?;
        let truth = self.twin.truth(frame.sequence).ok_or("no truth")?;
        Ok((
            GrayImage::new(frame.width, frame.height, frame.luminance())?,
            truth,
        ))
    }
}

/// A specimen, its cells per square millimetre, and half of what is covered, um.
type Laid = (Arc<dyn Specimen>, f64, f64);

fn specimen(family: Family, rng: &mut SplitMix64, index: u64) -> Outcome<Option<Laid>> {
    if matches!(family, Family::Same | Family::Elsewhere) {
        let per_mm2 = 20.0 * 32f64.powf(rng.uniform());
        let smear = Sparse::new(SparseConfig {
            seed: index + 1,
            per_mm2,
            contrast: 0.3 + 0.6 * rng.uniform(),
            ..SparseConfig::default()
        })?;
        return Ok(Some((Arc::new(smear), per_mm2, 1500.0)));
    }
    let Some(folder) = std::env::var_os("SCOPESERVO_SPECIMENS") else {
        return Ok(None);
    };
    let (name, um_per_px, half) = SCANNED[(index / 4) as usize % SCANNED.len()];
    let slide = FileSpecimen::open(&Path::new(&folder).join(name), Some(um_per_px))?;
    Ok(Some((Arc::new(slide), 0.0, half)))
}

fn one(index: u64) -> Outcome<Option<Record>> {
    let family = FAMILIES[(index % 4) as usize];
    let mut rng = SplitMix64::new(0xC0_57E1 ^ index.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let Some((specimen, per_mm2, half)) = specimen(family, &mut rng, index)? else {
        return Ok(None);
    };
    let mut within = |half: f64| (2.0 * rng.uniform() - 1.0) * half;
    let noise = 0.0025 * f64::powf(4.0, 0.5 + within(0.5));
    let bench = Bench::new(specimen, noise, index)?;
    let is_there = matches!(family, Family::Same | Family::Scanned);
    let at = [within(half), within(half)];
    // With its corners inside the view, or beside all of it.
    let aside = match is_there {
        true => [within(380.0), within(240.0)],
        false => [1500.0, within(300.0)],
    };
    let lies = [0, 1].map(|k| at[k] + aside[k]);
    let turn = within(175.0);
    let (target, of_target) = bench.look("40x", at, 0.0, within(0.4))?;
    let (view, of_view) = bench.look("10x", lies, turn, within(2.5))?;
    let engine = &*bench.vision.engine;
    let target_features = engine.features(&target, bench.vision.target_features)?;
    let view_features = engine.features(&view, bench.vision.view_features)?;
    let prior = Prior {
        scale: Some(ScalePrior {
            ratio: of_view.um_per_px / of_target.um_per_px * (1.0 + within(0.005)),
            tolerance: 0.03,
        }),
        rotation: None::<RotationPrior>,
        ..Prior::default()
    };
    let options = bench.vision.registration;
    let truth = is_there.then_some([&of_view, &of_target]);
    let by_features = register(engine, &view_features, &target_features, &prior, &options);
    let first = answer(&by_features, truth, &[&view, &target]);
    let seen = constellation(&view_features, &target_features, &prior, &options);
    let mut second = Answer {
        why: "not asked".into(),
        ..Answer::default()
    };
    if let Some(seen) = seen {
        second = answer(&seen.registration, truth, &[&view, &target]);
        let others = rivals(
            &view_features,
            &target_features,
            &seen.registration,
            &prior,
            &options,
        );
        second.ambiguous = !seen.rivals.is_empty();
        if others > 0 {
            second.why = format!("{} {others} others", second.why);
        }
    }
    Ok(Some(Record {
        index,
        family,
        per_mm2,
        features: target_features.len(),
        by: [first, second],
    }))
}

fn rivals(
    view: &Features,
    target: &Features,
    answer: &Registration,
    prior: &Prior,
    options: &scopeservo_registration::Options,
) -> usize {
    let all = find_rivals(view, target, answer, prior, options, false);
    all.iter().filter(|r| r.significant).count()
}

/// Pixel of an image that shows a place of the specimen.
fn pixel(truth: &Truth, at: [f64; 2]) -> [f64; 2] {
    let [[a, b, c], [d, e, f]] = truth.specimen_from_pixel;
    let det = a * e - b * d;
    let [x, y] = [at[0] - c, at[1] - f];
    [(e * x - b * y) / det, (a * y - d * x) / det]
}

fn answer(of: &Registration, truth: Option<[&Truth; 2]>, [_, target]: &[&GrayImage; 2]) -> Answer {
    let mut answer = Answer {
        inliers: of.inliers,
        places: of.matches,
        log10_nfa: of.log10_nfa.unwrap_or(0.0),
        ..Answer::default()
    };
    match &of.outcome {
        Err(why) => answer.why = why.to_string(),
        Ok(estimate) => {
            answer.found = true;
            if let Some([view, of_target]) = truth {
                let centre = [target.width(), target.height()].map(|n| (n as f64 - 1.0) / 2.0);
                let in_view = pixel(view, of_target.specimen(centre));
                let got = estimate.target_from_view.apply(in_view);
                let ratio = view.um_per_px / of_target.um_per_px;
                let off_px = f64::hypot(got[0] - centre[0], got[1] - centre[1]) / ratio;
                answer.off_px = Some(off_px);
                answer.sigma_px = Some(estimate.sigma_px / ratio);
                answer.right = off_px < RIGHT_PX;
            }
        }
    }
    answer
}

fn row(name: &str, of: &[&Record]) {
    if of.is_empty() {
        return;
    }
    let told = [0, 1].map(|k| {
        let count = |is: &dyn Fn(&Answer) -> bool| of.iter().filter(|r| is(&r.by[k])).count();
        let right = count(&|a| a.right && !a.ambiguous);
        let wrong = count(&|a| a.found && !a.right && !a.ambiguous);
        let ambiguous = count(&|a| a.found && a.ambiguous);
        format!("{right} | {wrong} | {ambiguous}")
    });
    let either = of
        .iter()
        .filter(|r| r.by[0].right || (!r.by[0].found && r.by[1].right && !r.by[1].ambiguous));
    let least = of.iter().map(|r| r.by[1].log10_nfa).fold(0.0, f64::min);
    println!(
        "| {name} | {} | {} | {} | {} | {least:.1} |",
        of.len(),
        told[0],
        told[1],
        either.count()
    );
}

fn main() -> Outcome<std::process::ExitCode> {
    let args = Args::parse();
    if let Some(index) = args.only {
        println!("{}", serde_json::to_string_pretty(&one(index)?)?);
        return Ok(std::process::ExitCode::SUCCESS);
    }
    let numbers: Vec<u64> = (0..4 * args.count).collect();
    let path = args.out.join("pairs.jsonl");
    #[derive(Serialize, Deserialize)]
    struct Kept(u64, Option<Record>);
    let kept = rounds(
        &path,
        &numbers,
        threads(args.threads)?,
        |k: &Kept| k.0,
        |k| Ok(Kept(k, one(k)?)),
    )?;
    let records: Vec<Record> = kept.into_iter().filter_map(|k| k.1).collect();
    println!(
        "| pairs | number | by descriptors: right | wrong | ambiguous | by how they lie: right | wrong | ambiguous | either | least log10 of chance |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for family in FAMILIES {
        let of: Vec<&Record> = records.iter().filter(|r| r.family == family).collect();
        row(&format!("{family:?}"), &of);
        for [from, to] in [
            [0, 75],
            [75, 150],
            [150, 300],
            [300, 600],
            [600, usize::MAX],
        ] {
            let these: Vec<&Record> = of
                .iter()
                .copied()
                .filter(|r| (from..to).contains(&r.features))
                .collect();
            row(&format!("{family:?}, {from} features and more"), &these);
        }
    }
    let wrong = records
        .iter()
        .any(|r| r.by[1].found && !r.by[1].right && !r.by[1].ambiguous);
    Ok(std::process::ExitCode::from(u8::from(wrong)))
}
