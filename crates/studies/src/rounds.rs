//! Many rounds of a study, on several threads: each is kept as a line of its own, so that a study that was broken off goes on.

use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What a study may end with.
pub type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// The records of the rounds of these numbers, in order. Those whose lines lie in the file at `path` are not run again; `index` is the
/// number of a record.
///
/// # Errors
/// Those of the rounds, and of the file.
pub fn rounds<R: Serialize + DeserializeOwned + Send>(
    path: &Path,
    numbers: &[u64],
    threads: usize,
    index: impl Fn(&R) -> u64,
    run: impl Fn(u64) -> Outcome<R> + Sync,
) -> Outcome<Vec<R>> {
    let mut done: BTreeMap<u64, R> = BTreeMap::new();
    for line in fs::read_to_string(path).unwrap_or_default().lines() {
        // The last line of a study that was killed may be cut off.
        if let Ok(record) = serde_json::from_str::<R>(line) {
            done.insert(index(&record), record);
        }
    }
    done.retain(|index, _| numbers.contains(index));
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    let file = Mutex::new(
        fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(path)?,
    );
    let left: Vec<u64> = numbers
        .iter()
        .copied()
        .filter(|k| !done.contains_key(k))
        .collect();
    let (next, made) = (AtomicUsize::new(0), AtomicUsize::new(done.len()));
    let worker = || -> Outcome<Vec<R>> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
        let mut records = Vec::new();
        loop {
            let Some(&k) = left.get(next.fetch_add(1, Ordering::SeqCst)) else {
                return Ok(records);
            };
            let record = pool.install(|| run(k))?;
            let line = format!("{}\n", serde_json::to_string(&record)?);
            file.lock()
                .map_err(|e| e.to_string())?
                .write_all(line.as_bytes())?;
            records.push(record);
            progress(made.fetch_add(1, Ordering::SeqCst) + 1, numbers.len());
        }
    };
    let ended = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(worker)).collect();
        let ended = workers.into_iter().map(|w| match w.join() {
            Ok(answer) => answer,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        ended.collect::<Outcome<Vec<_>>>()
    })?;
    done.extend(ended.into_iter().flatten().map(|r| (index(&r), r)));
    Ok(done.into_values().collect())
}

/// Says every tenth part.
fn progress(made: usize, count: usize) {
    if made * 10 / count != (made - 1) * 10 / count {
        #[expect(clippy::print_stderr, reason = "a study tells how far it is")]
        {
            eprintln!("{made} of {count}");
        }
    }
}

/// All processors where 0 are asked for.
///
/// # Errors
/// When the system does not say how many there are.
pub fn threads(asked: usize) -> Outcome<usize> {
    match asked {
        0 => Ok(std::thread::available_parallelism()?.get()),
        asked => Ok(asked),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_kept_is_not_run_again_and_a_line_that_was_cut_off_is() {
        let path = std::env::temp_dir().join(format!("rounds-{}.jsonl", std::process::id()));
        fs::write(&path, "[0, 10]\n[2, 12]\n[1, ").unwrap();
        fs::OpenOptions::new()
            .append(true)
            .open(&path)
            .unwrap()
            .write_all(b"\n")
            .unwrap();
        let run = |k: u64| -> Outcome<[u64; 2]> { Ok([k, 100 + k]) };
        let all = rounds(&path, &[0, 1, 2, 3], 2, |r: &[u64; 2]| r[0], run).unwrap();
        assert_eq!(all, [[0, 10], [1, 101], [2, 12], [3, 103]]);
        let again = rounds(
            &path,
            &[0, 1, 2, 3],
            1,
            |r: &[u64; 2]| r[0],
            |_| Err("ran".into()),
        )
        .unwrap();
        assert_eq!(again, all);
        fs::remove_file(&path).unwrap();
    }
}
