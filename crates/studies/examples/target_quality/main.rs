//! Predicted chance of coming back to a target against what runs do: smears of few cells, saved at 40x, put back anywhere within the lowest view.
//!
//! `cargo run --release -p scopeservo-studies --example target_quality -- --count 120`
//!
//! Instruments are calibrated once, and every run is kept as a line of its own. A target that is refused as hopeless is saved all the same, without a
//! step aside, so that the table has what would have become of it. Exit code 1 when an answer was wrong.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

#[path = "../reposition/scene.rs"]
#[allow(dead_code, reason = "that study draws other scenes")]
mod scene;

use clap::Parser;
use scene::{Bench, Kind, Known, Scene, of};
use scopeservo_geometry::SplitMix64;
use scopeservo_scope::ObjectiveId;
use scopeservo_servo::{
    Bring, FocusOptions, NoSink, Reposition, RepositionOptions, SaveOptions, SaveTarget,
    ServoError, Target, TargetQuality, VisionOptions, run,
};
use scopeservo_studies::rounds::{Outcome, rounds, threads};
use scopeservo_twin::{Sparse, SparseConfig};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::PathBuf;
use std::sync::Arc;

/// Predicted chance against runs.
#[derive(Parser)]
struct Args {
    /// Targets, each with a run.
    #[arg(long, default_value_t = 120)]
    count: u64,
    /// Only this one, in full.
    #[arg(long)]
    only: Option<u64>,
    /// Threads; all processors unless told.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// What features do not find is not looked for by correlation.
    #[arg(long)]
    by_features: bool,
    /// Where calibrations and runs are kept; what lies there is not made again. A new folder for a new build.
    #[arg(long, default_value = "target/target_quality")]
    out: PathBuf,
}

/// What one target and its run came to.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Record {
    index: u64,
    per_mm2: f64,
    features: usize,
    /// None where nothing could be tried: refused before.
    quality: Option<TargetQuality>,
    /// Refused at saving.
    refused: bool,
    verdict: String,
    reason: String,
    #[serde(default)]
    message: String,
    true_um: f64,
    true_deg: f64,
    claimed_um: f64,
}

impl Record {
    fn arrived(&self) -> bool {
        self.verdict == "arrived"
    }

    fn is_false(&self) -> bool {
        self.arrived() && (self.true_um > 1.0 + self.claimed_um || self.true_deg > 0.05)
    }
}

fn word(value: &impl Serialize) -> Outcome<String> {
    let value = serde_json::to_value(value)?;
    Ok(value.as_str().unwrap_or_default().into())
}

fn one(index: u64, known: &[Known], vision: &VisionOptions) -> Outcome<Record> {
    let mut rng = SplitMix64::new(0x7A26_E70F ^ index.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    // 20 to 640 cells a square millimetre: 2 to 50 in a view.
    let per_mm2 = 20.0 * 32f64.powf(rng.uniform());
    let smear = Sparse::new(SparseConfig {
        seed: index + 1,
        per_mm2,
        contrast: 0.3 + 0.6 * rng.uniform(),
        ..SparseConfig::default()
    })?;
    let mut within = |half: f64| (2.0 * rng.uniform() - 1.0) * half;
    let scene = Scene {
        kind: Kind::Turntable,
        seed: 1 + index % 2,
        specimen: 0,
        target_um: [within(300.0), within(300.0)],
        start_um: [within(540.0), within(400.0)],
        turn_deg: within(175.0),
        noise: 0.0025 * f64::powf(4.0, 0.5 + within(0.5)),
        begins_with: "10x",
        saved_with: "40x",
        focused_before: &[],
    };
    let bench = Bench::new((scene.kind, scene.seed), scene.noise, Arc::new(smear))?;
    let scope = &bench.scope;
    let bring = |id: &str| {
        let id = ObjectiveId(id.into());
        let focus = Some(FocusOptions::default());
        run(
            &mut Bring::new(id, focus, vision.clone()),
            scope,
            &mut NoSink,
        )
    };
    bench.twin.centre_specimen(scene.target_um, 0.0);
    let mut record = Record {
        index,
        per_mm2,
        ..Record::default()
    };
    let focused = bring("40x").map(drop);
    let saved = focused.and_then(|()| {
        let mut save = SaveTarget::new(SaveOptions {
            vision: vision.clone(),
            ..SaveOptions::default()
        });
        run(&mut save, scope, &mut NoSink)
    });
    let target = match saved {
        Ok(target) => {
            record.quality.clone_from(&target.quality);
            target
        }
        Err(error) => {
            record.refused = true;
            record.reason = word(&error.code())?;
            let ServoError::HopelessTarget(quality) = error else {
                return Ok(record);
            };
            record.quality = Some(*quality);
            Target::save(scope, vision, &mut NoSink)?
        }
    };
    record.features = target.features.len();
    let truth = bench.twin.truth_now();
    let lies = [0, 1].map(|k| scene.target_um[k] + scene.start_um[k]);
    // Whether 10x finds its focus on a smear is not what is asked.
    bench.twin.centre_specimen(lies, scene.turn_deg);
    let options = RepositionOptions {
        vision: vision.clone(),
        ..RepositionOptions::default()
    };
    let mut back = Reposition::new(target, options).with_calibrations(of(known, &scene));
    let outcome = run(&mut back, scope, &mut NoSink)?;
    let now = bench.twin.truth_now();
    let off = [0, 1].map(|k| now.centre_um[k] - truth.centre_um[k]);
    let turn = (now.angle_deg - truth.angle_deg + 180.0).rem_euclid(360.0) - 180.0;
    Ok(Record {
        verdict: word(&outcome.verdict)?,
        reason: word(&outcome.reason)?,
        message: outcome.message,
        true_um: f64::hypot(off[0], off[1]),
        true_deg: turn.abs(),
        claimed_um: outcome.estimated_error_um.unwrap_or(0.0),
        ..record
    })
}

fn row(name: &str, of: &[&Record]) {
    let n = of.len();
    if n == 0 {
        return;
    }
    let run: Vec<_> = of.iter().filter(|r| !r.verdict.is_empty()).collect();
    let arrived = run.iter().filter(|r| r.arrived()).count();
    let chances = run.iter().filter_map(|r| Some(r.quality.as_ref()?.chance));
    let mean = chances.fold(0.0, |sum, chance| sum + chance) / run.len().max(1) as f64;
    println!(
        "| {name} | {n} | {} | {:.0} % | {arrived} of {} | {:.0} % | {} |",
        of.iter().filter(|r| r.refused).count(),
        100.0 * mean,
        run.len(),
        100.0 * arrived as f64 / run.len().max(1) as f64,
        of.iter().filter(|r| r.is_false()).count(),
    );
}

fn table(records: &[Record]) {
    println!("| targets | number | refused at saving | predicted, mean | arrived | | wrong |");
    println!("|---|---|---|---|---|---|---|");
    let chance = |r: &Record| r.quality.as_ref().map_or(-1.0, |q| q.chance);
    let with = |of: &dyn Fn(&Record) -> bool| records.iter().filter(|r| of(r)).collect::<Vec<_>>();
    row("nothing to try", &with(&|r| r.quality.is_none()));
    for [from, to] in [
        [0.0, 0.3],
        [0.3, 0.6],
        [0.6, 0.8],
        [0.8, 0.9],
        [0.9, 0.97],
        [0.97, 1.1],
    ] {
        let name = format!("chance {from:.2} to {:.2}", f64::min(to, 1.0));
        row(&name, &with(&|r| (from..to).contains(&chance(r))));
    }
    for [from, to] in [[0, 75], [75, 150], [150, 300], [300, 600], [600, 9000]] {
        let of = with(&|r| r.quality.is_some() && (from..to).contains(&r.features));
        row(&format!("{from} to {to} features"), &of);
    }
    row("all", &with(&|_| true));
}

fn main() -> Outcome<()> {
    let args = Args::parse();
    fs::create_dir_all(&args.out)?;
    let known = scene::calibrations(&args.out)?;
    let vision = VisionOptions {
        correlation: !args.by_features,
        ..VisionOptions::default()
    };
    if let Some(index) = args.only {
        println!(
            "{}",
            serde_json::to_string_pretty(&one(index, &known, &vision)?)?
        );
        return Ok(());
    }
    let numbers: Vec<u64> = (0..args.count).collect();
    let path = args.out.join(match args.by_features {
        true => "runs-by-features.jsonl",
        false => "runs.jsonl",
    });
    let records = rounds(
        &path,
        &numbers,
        threads(args.threads)?,
        |r: &Record| r.index,
        |k| one(k, &known, &vision),
    )?;
    table(&records);
    if records.iter().any(Record::is_false) {
        std::process::exit(1);
    }
    Ok(())
}
