//! Autofocus from random starts: specimens, noise, backlash, every objective.
//!
//! `cargo run --release -p scopeservo-studies --example focus -- --count 1500`
//!
//! Every start is kept as a line of its own: a study that was broken off goes on. `SCOPESERVO_SPECIMENS` gives real slides; without it
//! the tissue is procedural. Exit code 1 when a failure left the stage nearer to the specimen or worse off than it began.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

mod start;
mod table;

use clap::Parser;
use scopeservo_servo::Measure;
use start::{Record, Start};
use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// Autofocus from random starts within 200 um.
#[derive(Parser)]
struct Args {
    /// Starts.
    #[arg(long, default_value_t = 1500)]
    count: u64,
    /// Only this start.
    #[arg(long)]
    only: Option<u64>,
    /// How sharpness is measured: laplacian, tenengrad, band_power or paper.
    #[arg(long, default_value = "laplacian", value_parser = measure)]
    measure: Measure,
    /// Starts on glass without a specimen, with and without dust: none may be in focus.
    #[arg(long)]
    blank: bool,
    /// Threads; all processors unless told.
    #[arg(long, default_value_t = 0)]
    threads: usize,
    /// Where starts are kept; what lies there is not run again. A new folder for a new build.
    #[arg(long, default_value = "target/focus")]
    out: PathBuf,
}

fn measure(text: &str) -> Result<Measure, String> {
    serde_json::from_value(text.into())
        .map_err(|_| "laplacian, tenengrad, band_power or paper".into())
}

fn main() -> Outcome<()> {
    let mut args = Args::parse();
    if args.threads == 0 {
        args.threads = std::thread::available_parallelism()?.get();
    }
    let kind = if args.blank { "blank" } else { "starts" };
    let measure = serde_json::to_value(args.measure)?;
    let name = format!("{kind}-{}.jsonl", measure.as_str().unwrap_or_default());
    fs::create_dir_all(&args.out)?;
    let path = args.out.join(name);
    let records = match args.only {
        Some(index) => {
            let record = Start::draw(index, args.blank)?.run(args.measure, true)?;
            println!("{}", serde_json::to_string_pretty(&record)?);
            vec![record]
        }
        None => all(&args, &path)?,
    };
    let harmed = table::print(&records, args.blank);
    if harmed > 0 {
        std::process::exit(1);
    }
    Ok(())
}

/// The records of all starts, in order.
fn all(args: &Args, path: &PathBuf) -> Outcome<Vec<Record>> {
    let mut done: BTreeMap<u64, Record> = BTreeMap::new();
    for line in fs::read_to_string(path).unwrap_or_default().lines() {
        // The last line of a study that was killed may be cut off.
        if let Ok(record) = serde_json::from_str::<Record>(line) {
            done.insert(record.index, record);
        }
    }
    done.retain(|index, _| *index < args.count);
    let file = Mutex::new(
        fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(path)?,
    );
    let next = AtomicU64::new(0);
    let worker = || -> Outcome<Vec<Record>> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        let mut made = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::SeqCst);
            if index >= args.count {
                return Ok(made);
            }
            if done.contains_key(&index) {
                continue;
            }
            let record =
                pool.install(|| Start::draw(index, args.blank)?.run(args.measure, false))?;
            let line = format!("{}\n", serde_json::to_string(&record)?);
            let mut file = file.lock().map_err(|e| e.to_string())?;
            file.write_all(line.as_bytes())?;
            drop(file);
            made.push(record);
        }
    };
    let made = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..args.threads).map(|_| scope.spawn(worker)).collect();
        let ended = workers.into_iter().map(|w| match w.join() {
            Ok(answer) => answer,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        ended.collect::<Outcome<Vec<_>>>()
    })?;
    done.extend(made.into_iter().flatten().map(|r| (r.index, r)));
    Ok(done.into_values().collect())
}
