//! Targets by what is asked for: name, note and slide by full text, the newest first.

use crate::LibraryError;
use crate::database::store::Database;
use crate::database::target_rows::{COLUMNS, FROM, TargetRow};
use rusqlite::types::Value;
use rusqlite::{OptionalExtension as _, params_from_iter};

/// The index knows three letters that follow each other; what is shorter is looked for row by row.
const INDEXED: usize = 3;

/// Which targets are wanted, the newest first.
#[derive(Debug, Clone, Default)]
pub struct TargetQuery<'a> {
    /// Words that are all in name, note or slide, or parts of words.
    pub text: &'a str,
    /// Only those on this slide.
    pub slide: Option<&'a str>,
    /// So many at most; all where it is 0.
    pub limit: usize,
    /// Only those after this one in the list.
    pub after: Option<&'a str>,
    /// The same by its number, wherever it lies by now: in the bin several may have one name.
    pub after_number: Option<i64>,
    /// Those in the bin, instead of those that are not.
    pub binned: bool,
    /// Only those of which coming back is expected so surely.
    pub chance: Option<Chance>,
}

/// How surely a target is come back to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Chance {
    /// From `least` on, below `below`.
    Of {
        /// From this share on.
        least: f64,
        /// Below this one.
        below: f64,
    },
    /// Nobody foretold it.
    Unknown,
}

const BY_INDEX: &str = "targets.id IN (SELECT rowid FROM words WHERE words MATCH ?)";
/// For what many have: target by target, from the newest on, until there are enough.
const AMONG_THE_NEWEST: &str =
    "EXISTS (SELECT 1 FROM words WHERE words MATCH ? AND rowid = targets.id)";
/// What so many have is frequent.
const FREQUENT: i64 = 2000;
const BY_ROW: &str =
    "(targets.name || ' ' || targets.note || ' ' || coalesce(slides.name, '')) LIKE ? ESCAPE '\\'";

/// A word as it is looked for row by row, whatever is in it.
fn like(word: &str) -> String {
    let escaped = word
        .replace('\\', r"\\")
        .replace('%', r"\%")
        .replace('_', r"\_");
    format!("%{escaped}%")
}

impl Database {
    /// Targets, the newest first.
    ///
    /// # Errors
    /// [`LibraryError::NoTarget`] for the one after which they were wanted, [`LibraryError::NoTargetNumbered`]; those of the database.
    pub fn find_targets(&self, wanted: &TargetQuery<'_>) -> Result<Vec<TargetRow>, LibraryError> {
        let after = match (wanted.after_number, wanted.after) {
            (Some(number), _) => {
                let place = self.place("id = ?1", number.into())?;
                Some(place.ok_or(LibraryError::NoTargetNumbered { number })?)
            }
            (None, Some(name)) => {
                let place = self.place("name = ?1 AND binned IS NULL", name.to_owned().into())?;
                Some(place.ok_or_else(|| self.no_target(name))?)
            }
            (None, None) => None,
        };
        let mut given: Vec<Value> = Vec::new();
        let mut rules = vec![match wanted.binned {
            true => "binned IS NOT NULL",
            false => "binned IS NULL",
        }];
        if let Some((saved, id)) = after {
            rules.push("(targets.saved, targets.id) < (?, ?)");
            given.extend([Value::from(saved), id.into()]);
        }
        match wanted.chance {
            None => {}
            Some(Chance::Unknown) => rules.push("targets.quality IS NULL"),
            Some(Chance::Of { least, below }) => {
                rules.push("json_extract(targets.quality, '$.chance') >= ? AND json_extract(targets.quality, '$.chance') < ?");
                given.extend([Value::from(least), below.into()]);
            }
        }
        if let Some(slide) = wanted.slide {
            rules.push("targets.slide = (SELECT id FROM slides WHERE name = ?)");
            given.push(slide.to_owned().into());
        }
        let words = wanted.text.split_whitespace();
        let (long, short): (Vec<&str>, Vec<&str>) =
            words.partition(|w| w.chars().count() >= INDEXED);
        if !long.is_empty() {
            let quoted = long
                .iter()
                .map(|w| format!("\"{}\"", w.replace('"', "\"\"")));
            let text = quoted.collect::<Vec<_>>().join(" ");
            rules.push(match self.is_frequent(&text)? {
                true => AMONG_THE_NEWEST,
                false => BY_INDEX,
            });
            given.push(text.into());
        }
        for word in short {
            rules.push(BY_ROW);
            given.push(like(word).into());
        }
        let limit = match wanted.limit {
            0 => -1,
            limit => i64::try_from(limit).unwrap_or(-1),
        };
        let rule = rules.join(" AND ");
        let sql = format!(
            "SELECT {COLUMNS} FROM {FROM} WHERE {rule} ORDER BY targets.saved DESC, targets.id DESC LIMIT {limit}"
        );
        self.read(|c| {
            let mut rows = c.prepare_cached(&sql)?;
            let rows = rows.query_map(params_from_iter(given), TargetRow::of)?;
            Ok(rows.collect::<Result<_, _>>()?)
        })
    }

    /// Where a target stands in the list.
    fn place(&self, rule: &str, of: Value) -> Result<Option<(String, i64)>, LibraryError> {
        self.read(|c| {
            let sql = format!("SELECT saved, id FROM targets WHERE {rule}");
            let place = c.query_row(&sql, [of], |row| Ok((row.get(0)?, row.get(1)?)));
            Ok(place.optional()?)
        })
    }

    /// Whether so many targets have all of these words that collecting them takes longer than asking the newest.
    fn is_frequent(&self, text: &str) -> Result<bool, LibraryError> {
        self.read(|c| {
            let count = "SELECT count(*) FROM (SELECT 1 FROM words WHERE words MATCH ?1 LIMIT ?2)";
            let count: i64 = c
                .prepare_cached(count)?
                .query_row((text, FREQUENT), |r| r.get(0))?;
            Ok(count == FREQUENT)
        })
    }
}
