//! Never sure and wrong: whole runs and single pairs made to mislead, by what is fixed to the camera and by what repeats itself.
//!
//! `cargo run --release -p scopeservo-studies --example negatives -- --count 1000 [--family camera] [--objectives 3]`
//!
//! Calibrations are known and lambda is 0.7. Every unit is kept as a file of its own, written whole and then renamed: a study that
//! was broken off goes on, and several machines share one (`--shard`). Exit code 1 when any sure answer is wrong.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

mod fault;
mod pairs;
mod run;
mod scene;
mod table;

use clap::{Parser, Subcommand};
use run::{Calibrations, Record};
use scene::{Family, Scene};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::hash_map::Entry;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// Whole runs and single pairs made to mislead. Exit code 1 when any sure answer is wrong.
#[derive(Parser)]
struct Args {
    /// Units of each family.
    #[arg(long, global = true, default_value_t = 100)]
    count: u64,
    /// The first unit's number.
    #[arg(long, global = true, default_value_t = 0)]
    first: u64,
    /// Only these families.
    #[arg(long, global = true)]
    family: Vec<Family>,
    /// Only kinds whose name contains this, such as "soft dust" or "grating".
    #[arg(long, global = true, default_value = "")]
    kind: String,
    /// 40x alone, or all three.
    #[arg(long, global = true, default_value_t = 1, value_parser = objectives)]
    objectives: usize,
    /// Threads; all processors unless told.
    #[arg(long, global = true, default_value_t = 0)]
    threads: usize,
    /// Which part of the units, such as 2/3: the table is of that part.
    #[arg(long, global = true, value_parser = shard, default_value = "1/1")]
    shard: [u64; 2],
    /// Where units are kept; what lies there is not run again. A new folder for a new build.
    #[arg(long, global = true, default_value = "target/negatives")]
    out: PathBuf,
    #[command(subcommand)]
    mode: Option<Mode>,
}

#[derive(Subcommand)]
enum Mode {
    /// Eight units of each family, in a folder of its own that is emptied first.
    Quick,
}

fn objectives(text: &str) -> Result<usize, String> {
    match text {
        "1" => Ok(1),
        "3" => Ok(3),
        _ => Err("1 (40x alone) or 3 (10x, 20x, 40x)".into()),
    }
}

fn shard(text: &str) -> Result<[u64; 2], String> {
    let parts = text
        .split_once('/')
        .and_then(|(i, n)| Some([i.parse().ok()?, n.parse().ok()?]));
    match parts {
        Some([i, n]) if 1 <= i && i <= n => Ok([i, n]),
        _ => Err("give it as 2/3: the second of three parts".into()),
    }
}

fn main() -> Outcome<()> {
    let mut args = Args::parse();
    if args.threads == 0 {
        args.threads = std::thread::available_parallelism()?.get();
    }
    if let Some(Mode::Quick) = args.mode {
        args.count = 8;
        args.out = args.out.join("quick");
        if args.out.exists() {
            std::fs::remove_dir_all(&args.out)?;
        }
    }
    std::fs::create_dir_all(&args.out)?;
    if args.family.is_empty() {
        args.family = vec![Family::Camera, Family::Lattice, Family::Pairs];
    }
    let mut wrong = 0;
    for &family in &args.family {
        let units: Vec<(u64, Scene)> = (args.first..args.first + args.count)
            .filter(|i| i % args.shard[1] == args.shard[0] - 1)
            .map(|i| (i, Scene::draw(family, i, args.objectives)))
            .filter(|(_, scene)| scene.kind.contains(&args.kind))
            .collect();
        let mut known = Calibrations::new();
        for (_, scene) in units.iter().filter(|_| family != Family::Pairs) {
            if let Entry::Vacant(place) = known.entry(scene.instrument) {
                place.insert(run::calibrations(scene.instrument, &args.out)?);
            }
        }
        let records = all(&args, family, &units, &known)?;
        wrong += table::print(family, args.objectives, &records);
    }
    println!("\n{wrong} sure answers are wrong");
    if wrong > 0 {
        std::process::exit(1);
    }
    Ok(())
}

/// The records of all units, in order. Each worker runs whole units on a pool of its own: nothing that a unit waits for is
/// another unit.
fn all(
    args: &Args,
    family: Family,
    units: &[(u64, Scene)],
    known: &Calibrations,
) -> Outcome<Vec<Record>> {
    let next = AtomicUsize::new(0);
    let worker = || -> Result<Vec<(usize, Vec<Record>)>, String> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .map_err(|e| e.to_string())?;
        let mut done = Vec::new();
        loop {
            let k = next.fetch_add(1, Ordering::SeqCst);
            let Some((index, scene)) = units.get(k) else {
                return Ok(done);
            };
            let records = pool.install(|| {
                unit(args, family, *index, scene, known)
                    .map_err(|e| format!("{family:?} {index}: {e}"))
            })?;
            done.push((k, records));
        }
    };
    let mut done = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..args.threads).map(|_| scope.spawn(worker)).collect();
        let ended = workers.into_iter().map(|w| match w.join() {
            Ok(answer) => answer,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        ended.collect::<Result<Vec<_>, _>>()
    })?
    .concat();
    done.sort_by_key(|(k, _)| *k);
    Ok(done.into_iter().flat_map(|(_, records)| records).collect())
}

/// The records of one unit: from its file, or run now.
fn unit(
    args: &Args,
    family: Family,
    index: u64,
    scene: &Scene,
    known: &Calibrations,
) -> Outcome<Vec<Record>> {
    let name = format!("{family:?}-{}-{index:05}.json", args.objectives).to_lowercase();
    let path = args.out.join(name);
    if let Some(records) = kept(&path)? {
        return Ok(records);
    }
    let records = match family {
        Family::Pairs => vec![pairs::pair(scene, index)?],
        _ => {
            // The same run with a clean camera tells what the fault costs.
            let both: &[bool] = match scene.fault {
                Some(_) => &[false, true],
                None => &[true],
            };
            let known = &known[&scene.instrument];
            both.iter()
                .map(|&faulty| run::whole(scene, index, faulty, known))
                .collect::<Outcome<_>>()?
        }
    };
    keep(&path, &records)?;
    Ok(records)
}

/// What a file keeps, if it is there.
fn kept<T: DeserializeOwned>(path: &Path) -> Outcome<Option<T>> {
    match std::fs::read(path) {
        Ok(text) => match serde_json::from_slice(&text) {
            Ok(what) => Ok(Some(what)),
            Err(e) => Err(format!("{}: {e}", path.display()).into()),
        },
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(format!("{}: {e}", path.display()).into()),
    }
}

/// Writes a file whole, then gives it its name.
fn keep(path: &Path, what: &impl Serialize) -> Outcome<()> {
    let unfinished = path.with_extension("unfinished");
    std::fs::write(&unfinished, serde_json::to_vec(what)?)?;
    std::fs::rename(unfinished, path)?;
    Ok(())
}
