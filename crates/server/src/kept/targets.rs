//! Saved views.

use crate::app::App;
use crate::error::ApiError;
use crate::live::jpeg;
use crate::routes::said;
use scopeservo_library::{Chance, Label, TargetQuery, TargetRow, Targets as _, png_of};
use scopeservo_protocol::Place;
use scopeservo_scope::Frame;
use scopeservo_servo::TargetQuality;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The width of a small picture, pixels.
const THUMB: usize = 320;

/// A change of what is said of a target: what is not there stays, and a slide of `null` is none.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Edit {
    pub(crate) name: Option<String>,
    #[serde(deserialize_with = "said")]
    pub(crate) slide: Option<Option<String>>,
    pub(crate) note: Option<String>,
    /// It is taken back out of the bin.
    pub(crate) restore: bool,
}

fn told(app: &App, row: &TargetRow) -> Value {
    let mut told = json!({
        "number": row.number,
        "name": row.name,
        "saved": row.saved,
        "instrument": row.instrument,
        "own": row.instrument == app.bench.config.name,
        "slide": row.label.slide,
        "note": row.label.note,
        "objective": row.objective,
        "um_per_px": row.um_per_px,
        "width": row.size_px[0],
        "height": row.size_px[1],
        "features": row.features,
        "quality": quality(row.quality.as_ref()),
        "at": Place::from(&row.stage),
    });
    if let Some(damaged) = &row.damaged {
        told["damaged"] = json!(damaged);
    }
    if let Some(binned) = &row.binned {
        told["binned"] = json!(binned);
    }
    told
}

/// From such a chance on coming back is as good as sure, and from such a one on it is rather likely.
const GOOD: f64 = 0.9;
const FAIR: f64 = 0.6;

/// How surely a view is come back to, in a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Quality {
    Good,
    Fair,
    Poor,
    Unknown,
}

impl Quality {
    fn of(quality: Option<&TargetQuality>) -> Self {
        match quality.map(|q| q.chance) {
            None => Self::Unknown,
            Some(chance) if chance >= GOOD => Self::Good,
            Some(chance) if chance >= FAIR => Self::Fair,
            Some(_) => Self::Poor,
        }
    }

    /// Those that are called so.
    pub(crate) fn chance(self) -> Chance {
        let of = |least, below| Chance::Of { least, below };
        match self {
            Self::Good => of(GOOD, f64::INFINITY),
            Self::Fair => of(FAIR, GOOD),
            Self::Poor => of(f64::NEG_INFINITY, FAIR),
            Self::Unknown => Chance::Unknown,
        }
    }
}

/// How surely it is come back to, as a word with its reason.
fn quality(quality: Option<&TargetQuality>) -> Value {
    let Some(quality) = quality else {
        return json!({"word": "unknown", "text": "it was saved by an earlier version", "chance": null});
    };
    let word = Quality::of(Some(quality));
    json!({"word": word, "text": quality.to_string(), "chance": quality.chance})
}

/// The newest ones, or those after one of them; one that is damaged is there with what is wrong with it.
pub(crate) fn targets(app: &App, wanted: &TargetQuery<'_>) -> Result<Value, ApiError> {
    let rows = app.bench.library.find_targets(wanted)?;
    Ok(rows.iter().map(|row| told(app, row)).collect())
}

/// One of them.
pub(crate) fn target(app: &App, name: &str) -> Result<Value, ApiError> {
    Ok(told(app, &app.bench.library.target_row(name)?))
}

/// All slides.
pub(crate) fn slides(app: &App) -> Result<Value, ApiError> {
    Ok(json!(app.bench.library.slides()?))
}

fn frame(app: &App, name: &str) -> Result<Frame, ApiError> {
    app.bench.library.target_path(name)?;
    let picture = app.bench.library.target_picture(name);
    picture.ok_or_else(|| ApiError::missing(format!("'{name}' has no picture")))
}

/// Its picture, as a PNG.
pub(crate) fn picture(app: &App, name: &str) -> Result<Vec<u8>, ApiError> {
    Ok(png_of(&frame(app, name)?)?)
}

/// Its picture, small, as a JPEG.
pub(crate) fn thumbnail(app: &App, name: &str) -> Result<Vec<u8>, ApiError> {
    let frame = frame(app, name)?;
    let rgb = frame.rgb8();
    let width = THUMB.min(frame.width);
    let height = (frame.height * width / frame.width).max(1);
    let mut small = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        let rows = y * frame.height / height..((y + 1) * frame.height / height).max(1);
        for x in 0..width {
            let columns = x * frame.width / width..((x + 1) * frame.width / width).max(1);
            for c in 0..3 {
                let all = rows.clone().flat_map(|v| {
                    let columns = columns.clone();
                    columns.map(move |u| (v * frame.width + u) * 3 + c)
                });
                let (sum, count) =
                    all.fold((0u32, 0u32), |(s, n), i| (s + u32::from(rgb[i]), n + 1));
                small.push((sum / count.max(1)) as u8);
            }
        }
    }
    jpeg(&small, [width, height]).map_err(ApiError::fault)
}

/// Changes what is said of it.
pub(crate) fn edit(app: &App, name: &str, edit: &Edit) -> Result<Value, ApiError> {
    let library = &app.bench.library;
    if edit.restore {
        library.restore_target(name, edit.name.as_deref())?;
    } else if let Some(to) = &edit.name {
        library.rename_target(name, to)?;
    }
    let name = edit.name.as_deref().unwrap_or(name);
    if edit.slide.is_some() || edit.note.is_some() {
        let before = library.target_label(name)?;
        let label = Label {
            slide: edit.slide.clone().unwrap_or(before.slide),
            note: edit.note.clone().unwrap_or(before.note),
        };
        library.label_target(name, &label)?;
    }
    app.has_changed();
    target(app, name)
}

/// Takes it out; it lies in the bin.
pub(crate) fn remove(app: &App, name: &str) -> Result<(), ApiError> {
    app.bench.library.remove_target(name)?;
    app.has_changed();
    Ok(())
}

/// Deletes it from the bin for good, with the runs to it.
pub(crate) fn purge(app: &App, name: &str) -> Result<Value, ApiError> {
    let purged = app.bench.library.purge_targets(Some(&[name.to_owned()]))?;
    app.audit.forget(name).map_err(|e| {
        ApiError::fault(format!(
            "'{name}' is deleted, and its name is still in the log of who moved what: {e}"
        ))
    })?;
    app.has_changed();
    Ok(json!({"purged": purged}))
}
