//! Ours on the pairs, and the peers as another program.

use crate::Outcome;
use clap::Args;
use scopeservo_studies::accuracy::degrade::Condition;
use scopeservo_studies::accuracy::ours::{Keep, Runner, SETTINGS, Setting};
use scopeservo_studies::accuracy::rows::{self, Row, by_method};
use scopeservo_studies::accuracy::scenes::{
    PAIRS_PER_CELL, PairId, SPECIMENS, SceneId, Slides, all_scenes, set_name,
};
use scopeservo_studies::accuracy::table::{self, PRECISE};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// What `ours` is asked.
#[derive(Args)]
pub(crate) struct OursArgs {
    /// File to append to.
    #[arg(long)]
    out: PathBuf,
    /// The peers' results: the setting `equal` uses as many features as they.
    #[arg(long)]
    peers: Option<PathBuf>,
    /// Pairs of each cell.
    #[arg(long, default_value_t = PAIRS_PER_CELL)]
    per_cell: usize,
    /// Only these settings, with commas between.
    #[arg(long, value_delimiter = ',')]
    settings: Vec<String>,
}

/// The last commit that changed the code under study; `-changed` when the working tree differs from it.
fn engine() -> Outcome<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let crates = ["crates/sift", "crates/registration", "crates/geometry"];
    let git = |args: &[&str]| -> Outcome<String> {
        let output = Command::new("git")
            .args(args)
            .arg("--")
            .args(crates)
            .current_dir(&root)
            .output()
            .map_err(|e| {
                format!(
                    "git cannot name the engine's commit in {}: {e}",
                    root.display()
                )
            })?;
        Ok(String::from_utf8(output.stdout)?.trim().to_string())
    };
    let commit = git(&["log", "-1", "--format=%h"])?;
    let changed = !git(&["status", "--porcelain"])?.is_empty();
    Ok(commit + if changed { "-changed" } else { "" })
}

/// How many features OpenCV's precise SIFT found in view and target, by pair.
fn peer_counts(file: Option<&Path>, set: &str) -> Outcome<BTreeMap<PairId, [usize; 2]>> {
    let Some(file) = file else {
        return Ok(BTreeMap::new());
    };
    let precise = by_method(rows::read(file, set)?).remove(PRECISE);
    let precise = precise.unwrap_or_default().into_iter();
    Ok(precise.map(|(id, row)| (id, row.features)).collect())
}

pub(crate) fn ours(args: &OursArgs, mut slides: Slides, seed: u64) -> Outcome<()> {
    for name in &args.settings {
        Setting::of(name).ok_or_else(|| format!("no setting is called {name}"))?;
    }
    let set = set_name(seed);
    let engine = engine()?;
    let counts = peer_counts(args.peers.as_deref(), &set)?;
    let there: BTreeSet<(String, String)> = rows::read(&args.out, &set)?
        .into_iter()
        .filter(|row| row.engine == engine)
        .map(|row| (row.pair, row.method))
        .collect();
    let wanted = |id: PairId, s: &Setting| {
        (args.settings.is_empty() || args.settings.iter().any(|n| n == s.name))
            && (s.keep != Keep::AsPeer || counts.contains_key(&id))
            && !there.contains(&(id.to_string(), s.name.to_string()))
    };
    let scenes: Vec<SceneId> = all_scenes(args.per_cell)
        .filter(|scene| {
            Condition::EACH.into_iter().any(|condition| {
                let id = PairId {
                    scene: *scene,
                    condition,
                };
                SETTINGS.iter().any(|s| wanted(id, s))
            })
        })
        .collect();
    let mut out = rows::append(&args.out)?;
    let mut runner = Runner::default();
    let start = Instant::now();
    for (i, id) in scenes.iter().enumerate() {
        let scene = slides.scene(*id, seed)?;
        for mut row in runner.rows(&scene, wanted, |id| counts.get(&id).copied())? {
            row.engine.clone_from(&engine);
            rows::write(&mut out, &row)?;
        }
        let minutes = start.elapsed().as_secs_f64() / 60.0;
        let left = minutes / (i + 1) as f64 * (scenes.len() - i - 1) as f64;
        println!(
            "{id}: {} of {} scenes, {left:.0} minutes left",
            i + 1,
            scenes.len()
        );
    }
    println!("engine {engine}, set {set}: complete");
    Ok(())
}

/// The peers' driver with these arguments; `None` without their Python.
fn peers(python: &Path, seed: u64, args: &[&str]) -> Outcome<Option<Command>> {
    if !python.exists() {
        println!(
            "without the peers: there is no {}, see docs/sift-accuracy.md",
            python.display()
        );
        return Ok(None);
    }
    let mut command = Command::new(python);
    command
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/peers.py"))
        .arg("--renderer")
        .arg(std::env::current_exe()?)
        .args(["--seed", &seed.to_string()])
        .args(args);
    Ok(Some(command))
}

fn print_row(row: &Row) {
    let error = row
        .error_px
        .map_or("not found".into(), |e| format!("{e:.4} px"));
    println!(
        "{:22} {error:>12} {:5} inliers of {:5} matches, {:5} / {:5} features {}",
        row.method,
        row.inliers,
        row.matches,
        row.features[0],
        row.features[1],
        row.reason.as_deref().unwrap_or_default()
    );
}

pub(crate) fn pair(id: &str, mut slides: Slides, seed: u64, python: &Path) -> Outcome<()> {
    let id = PairId::parse(id).ok_or_else(|| format!("no pair is called {id}"))?;
    let mut theirs: Vec<Row> = Vec::new();
    if let Some(mut command) = peers(python, seed, &["--pair", &id.to_string()])? {
        let output = command.output()?;
        if !output.status.success() {
            return Err(String::from_utf8_lossy(&output.stderr).into());
        }
        for line in String::from_utf8(output.stdout)?.lines() {
            theirs.push(serde_json::from_str(line)?);
        }
    }
    let count = theirs.iter().find(|r| r.method == PRECISE);
    let count = count.map(|r| r.features);
    let scene = slides.scene(id.scene, seed)?;
    let (degradation, _) = scene.view(id.condition);
    println!("{id} of {}: {degradation:?}", id.scene.specimen());
    println!("target_from_view {:?}", scene.target_from_view);
    let rows = Runner::default().rows(&scene, |i, _| i == id, |_| count)?;
    rows.iter().chain(&theirs).for_each(print_row);
    Ok(())
}

/// Pairs per cell of the quick form.
const QUICK: usize = 2;

pub(crate) fn quick(mut slides: Slides, seed: u64, python: &Path) -> Outcome<()> {
    let file = std::env::temp_dir().join(format!("accuracy-{}.jsonl", std::process::id()));
    let name = file.to_string_lossy().into_owned();
    let per_cell = QUICK.to_string();
    let peers = peers(python, seed, &["--out", &name, "--per-cell", &per_cell])?;
    let mut all = Vec::new();
    if let Some(mut command) = peers {
        let done = command.output()?;
        all = rows::read(&file, &set_name(seed))?;
        std::fs::remove_file(&file)?;
        if !done.status.success() {
            return Err(String::from_utf8_lossy(&done.stderr).into());
        }
    }
    let counts: BTreeMap<String, [usize; 2]> = all
        .iter()
        .filter(|r| r.method == PRECISE)
        .map(|r| (r.pair.clone(), r.features))
        .collect();
    let mut runner = Runner::default();
    // A clean pair of each slide at 1:1, and a few of every cell.
    let more = (QUICK..SPECIMENS.len()).map(|index| SceneId { zoom: 1, index });
    for id in all_scenes(QUICK).chain(more) {
        let wanted =
            |pair: PairId, _: &Setting| id.index < QUICK || pair.condition == Condition::Clean;
        let peer = |pair: PairId| counts.get(&pair.to_string()).copied();
        all.extend(runner.rows(&slides.scene(id, seed)?, wanted, peer)?);
    }
    let lost: Vec<String> = all
        .iter()
        .filter(|r| SETTINGS.iter().any(|s| s.name == r.method))
        .filter(|r| r.pair.starts_with("1-clean-") && !r.success())
        .map(|r| format!("{} by {}", r.pair, r.method))
        .collect();
    let methods = by_method(all);
    table::check_frames(&methods)?;
    println!(
        "{}\n{}",
        table::summary(&methods),
        table::table_one(&methods)
    );
    match lost.is_empty() {
        true => Ok(()),
        false => Err(format!("clean pairs at 1:1 not found: {}", lost.join(", ")).into()),
    }
}
