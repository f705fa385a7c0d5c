//! Results: one line of JSON per pair and method, ours or a peer's.

use super::scenes::PairId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;

/// An answer with a larger corner error is no success.
pub const SUCCESS_PX: f64 = 3.0;

/// What one method said of one pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The set of pairs.
    pub set: String,
    /// Which pair, as [`PairId`] is written.
    pub pair: String,
    /// Name of the method.
    pub method: String,
    /// Version of the code behind it.
    pub engine: String,
    /// Checksum of the two frames.
    pub frames: String,
    /// Whether it gave a transform.
    pub found: bool,
    /// Corner error of the transform, target pixels.
    pub error_px: Option<f64>,
    /// Matches that agree with the transform.
    pub inliers: usize,
    /// Matches.
    pub matches: usize,
    /// Features of view and target.
    pub features: [usize; 2],
    /// Time for the view's features.
    pub features_ms: f64,
    /// Time to match and fit.
    pub register_ms: f64,
    /// Why nothing was found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// What the method itself expects of the worst corner: one standard deviation, target pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub claimed_px: Option<f64>,
}

impl Row {
    /// Its error, infinite when nothing was found.
    pub fn error_or_infinite(&self) -> f64 {
        self.error_px
            .filter(|_| self.found)
            .unwrap_or(f64::INFINITY)
    }

    /// Whether it gave a transform that is no success and lies more than three of its own standard deviations off, where it
    /// states one.
    pub fn misleading(&self) -> bool {
        let error_px = self.error_or_infinite();
        error_px.is_finite()
            && error_px >= SUCCESS_PX
            && self.claimed_px.is_none_or(|sigma| error_px > 3.0 * sigma)
    }

    /// Whether it found the right place.
    pub fn success(&self) -> bool {
        self.error_or_infinite() < SUCCESS_PX
    }
}

/// Rows of one method, by pair.
pub type ByPair = BTreeMap<PairId, Row>;

/// The rows of a set in a file; none when there is no file. A line that was cut by an interruption is passed over.
///
/// # Errors
/// A file that is there and cannot be read.
pub fn read(path: &Path, set: &str) -> std::io::Result<Vec<Row>> {
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = std::fs::read_to_string(path)?;
    Ok(text
        .lines()
        .filter_map(|line| serde_json::from_str(line).ok())
        .filter(|row: &Row| row.set == set)
        .collect())
}

/// A file of rows to add to; a cut last line is ended first.
///
/// # Errors
/// Those of the file.
pub fn append(path: &Path) -> std::io::Result<File> {
    let mut file = OpenOptions::new()
        .create(true)
        .read(true)
        .append(true)
        .open(path)?;
    if file.seek(SeekFrom::End(0))? > 0 {
        file.seek(SeekFrom::End(-1))?;
        let mut last = [0];
        file.read_exact(&mut last)?;
        if last != *b"\n" {
            file.write_all(b"\n")?;
        }
    }
    Ok(file)
}

/// Writes a row at once, so that an interruption loses one line at most.
///
/// # Errors
/// Those of the file.
pub fn write(file: &mut File, row: &Row) -> std::io::Result<()> {
    let mut line = serde_json::to_string(row)?;
    line.push('\n');
    file.write_all(line.as_bytes())
}

/// Rows by method and pair. Of several for one pair and method the last counts.
pub fn by_method(rows: Vec<Row>) -> BTreeMap<String, ByPair> {
    let mut all: BTreeMap<String, ByPair> = BTreeMap::new();
    for row in rows {
        if let Some(pair) = PairId::parse(&row.pair) {
            all.entry(row.method.clone()).or_default().insert(pair, row);
        }
    }
    all
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A row with this error; none found when it is infinite.
    pub(crate) fn row(pair: &str, method: &str, error_px: f64) -> Row {
        Row {
            set: "1.1".into(),
            pair: pair.into(),
            method: method.into(),
            engine: "test".into(),
            frames: pair.into(),
            found: error_px.is_finite(),
            error_px: error_px.is_finite().then_some(error_px),
            inliers: 40,
            matches: 50,
            features: [100, 200],
            features_ms: 1.0,
            register_ms: 2.0,
            reason: None,
            claimed_px: None,
        }
    }

    #[test]
    fn a_cut_line_is_passed_over_and_not_continued() {
        let path = std::env::temp_dir().join(format!("rows-{}.jsonl", std::process::id()));
        let (first, second) = (row("1-clean-000", "a", 0.1), row("1-clean-001", "a", 0.2));
        let line = serde_json::to_string(&first).unwrap();
        std::fs::write(&path, format!("{line}\n{}", &line[..30])).unwrap();
        write(&mut append(&path).unwrap(), &second).unwrap();
        let there = read(&path, "1.1").unwrap();
        assert_eq!(there, [first, second]);
        assert!(read(&path, "1.2").unwrap().is_empty());
        std::fs::remove_file(&path).unwrap();
        assert!(read(&path, "1.1").unwrap().is_empty());
    }

    #[test]
    fn an_answer_far_off_is_no_success() {
        assert!(row("1-clean-000", "a", 2.9).success());
        assert!(!row("1-clean-000", "a", 3.1).success());
        assert!(!row("1-clean-000", "a", f64::INFINITY).success());
    }

    #[test]
    fn a_rough_answer_that_says_so_does_not_mislead() {
        let said = |error_px: f64, claimed_px: Option<f64>| {
            let row = row("1-clean-000", "a", error_px);
            Row { claimed_px, ..row }.misleading()
        };
        assert!(said(8.0, None) && said(8.0, Some(2.0)));
        assert!(!said(8.0, Some(4.0)) && !said(2.0, Some(0.1)));
        assert!(!said(f64::INFINITY, None));
    }
}
