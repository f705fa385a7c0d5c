//! The rows of targets.

use crate::database::objects::Stored;
use crate::database::rows::{instrument, row_of, slide};
use crate::database::wrong::{Done, Wrong};
use crate::{KeptTarget, Label, LibraryError};
use rusqlite::{Row, Transaction, params};
use scopeservo_scope::StagePose;
use scopeservo_servo::TargetQuality;
use serde::Serialize;

/// What lists tell of a target; its file was not read for it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TargetRow {
    /// Its name.
    pub name: String,
    /// The checksum of all that it is made of; empty for one of the first version of target files.
    pub id: String,
    /// When it was saved, UTC; empty where its file was damaged when it was taken in.
    pub saved: String,
    /// The instrument's name.
    pub instrument: String,
    /// The slide, and what was noted.
    #[serde(flatten)]
    pub label: Label,
    /// The objective's id.
    pub objective: String,
    /// The size of its pixels, where that was kept.
    pub um_per_px: Option<f64>,
    /// The size of its image.
    pub size_px: [usize; 2],
    /// How many features it has.
    pub features: usize,
    /// How surely it is come back to, where that was foretold.
    pub quality: Option<TargetQuality>,
    /// Where the stage was.
    pub stage: StagePose,
    /// What was wrong with its file when it was taken in.
    pub damaged: Option<String>,
    /// When it went into the bin, for one that lies there.
    pub binned: Option<String>,
    /// The object with its file.
    #[serde(skip)]
    pub(crate) file: String,
    /// Its picture for people.
    #[serde(skip)]
    pub(crate) picture: Option<String>,
    /// What tells it from all others, also from those in the bin that have its name.
    #[serde(skip)]
    pub number: i64,
}

/// What [`TargetRow::of`] reads.
pub(crate) const COLUMNS: &str = "targets.name, targets.content, targets.saved, instruments.name, slides.name, \
     targets.note, targets.objective, targets.um_per_px, targets.width_px, targets.height_px, targets.features, \
     targets.quality, targets.stage, targets.damaged, targets.binned, targets.file, targets.picture, targets.id";

/// Where it reads them.
pub(crate) const FROM: &str = "targets JOIN instruments ON instruments.id = targets.instrument \
     LEFT JOIN slides ON slides.id = targets.slide";

impl TargetRow {
    pub(crate) fn of(row: &Row<'_>) -> rusqlite::Result<Self> {
        let size = |at: usize| row.get::<_, i64>(at).map(|n| n as usize);
        let quality: Option<String> = row.get(11)?;
        let stage: String = row.get(12)?;
        Ok(Self {
            name: row.get(0)?,
            id: row.get(1)?,
            saved: row.get(2)?,
            instrument: row.get(3)?,
            label: Label {
                slide: row.get(4)?,
                note: row.get(5)?,
            },
            objective: row.get(6)?,
            um_per_px: row.get(7)?,
            size_px: [size(8)?, size(9)?],
            features: size(10)?,
            quality: quality.and_then(|text| serde_json::from_str(&text).ok()),
            stage: serde_json::from_str(&stage).unwrap_or_default(),
            damaged: row.get(13)?,
            binned: row.get(14)?,
            file: row.get(15)?,
            picture: row.get(16)?,
            number: row.get(17)?,
        })
    }
}

/// A target that is to have a row.
pub(crate) struct NewRow<'a> {
    pub(crate) name: &'a str,
    /// What its file holds, or what is wrong with that.
    pub(crate) kept: Result<&'a KeptTarget, &'a str>,
    pub(crate) label: &'a Label,
    pub(crate) file: &'a Stored,
    pub(crate) picture: Option<&'a Stored>,
    pub(crate) binned: Option<&'a str>,
}

fn json(value: &impl Serialize) -> Result<String, Wrong> {
    let text = serde_json::to_string(value);
    text.map_err(|e| Wrong::Library(LibraryError::Encode(e.to_string())))
}

impl NewRow<'_> {
    /// Puts it in. Nothing is done, and `false` answered, when there is one of that name.
    pub(crate) fn insert(&self, change: &Transaction<'_>) -> Done<bool> {
        let kept = self.kept.ok();
        row_of(change, self.file)?;
        if let Some(picture) = self.picture {
            row_of(change, picture)?;
        }
        let slide = self
            .label
            .slide
            .as_deref()
            .map(|name| slide(change, name))
            .transpose()?;
        let target = kept.map(|kept| &kept.target);
        let quality = target
            .and_then(|t| t.quality.as_ref())
            .map(json)
            .transpose()?;
        let features = target.map(|t| &t.features);
        let made = change.prepare_cached(
            "INSERT INTO targets (name, content, instrument, slide, note, saved, objective, um_per_px, width_px,
                 height_px, features, quality, stage, file, picture, damaged, binned)
             VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17)
             ON CONFLICT DO NOTHING",
        )?.execute(params![
            self.name,
            kept.map_or("", |k| &k.id),
            instrument(change, kept.map_or("", |k| &k.instrument))?,
            slide,
            self.label.note,
            kept.map_or("", |k| &k.saved),
            target.map_or("", |t| &t.objective.0),
            target.and_then(|t| t.taken.as_deref()).map(|t| t.um_per_px),
            features.map_or(0, |f| f.width as i64),
            features.map_or(0, |f| f.height as i64),
            features.map_or(0, |f| f.len() as i64),
            quality,
            json(&kept.map(|k| k.stage).unwrap_or_default())?,
            self.file.name,
            self.picture.map(|p| &p.name),
            self.kept.err(),
            self.binned,
        ])?;
        Ok(made == 1)
    }
}
