//! The rows of what was measured of instruments.

use crate::database::objects::Stored;
use crate::database::rows::{instrument, row_of};
use crate::database::wrong::Done;
use rusqlite::{Transaction, params};

/// A kind of measurement, as its rows have it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Calibration,
    Set,
    Switching,
    Shadows,
}

impl Kind {
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Calibration => "calibration",
            Self::Set => "set",
            Self::Switching => "switching",
            Self::Shadows => "shadows",
        }
    }
}

/// Puts the row of a measurement in.
pub(crate) fn insert(
    change: &Transaction<'_>,
    kind: Kind,
    [of_instrument, of, made]: [&str; 3],
    file: &Stored,
) -> Done<()> {
    row_of(change, file)?;
    let instrument = instrument(change, of_instrument)?;
    change
        .prepare_cached("INSERT INTO measurements (kind, instrument, of, made, file) VALUES (?1, ?2, ?3, ?4, ?5)")?
        .execute(params![kind.word(), instrument, of, made, file.name])?;
    Ok(())
}

/// An image's size, as rows have it.
pub(crate) fn size_word([width, height]: [usize; 2]) -> String {
    format!("{width}x{height}")
}
