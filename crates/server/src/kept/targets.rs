//! Saved views.

use crate::app::App;
use crate::error::ApiError;
use crate::kept::remembered::Stamp;
use crate::live::jpeg;
use scopeservo_library::{KeptTarget, Targets as _, png_of};
use scopeservo_protocol::Place;
use scopeservo_scope::Frame;
use scopeservo_servo::TargetQuality;
use serde::Deserialize;
use serde_json::{Value, json};
use std::fmt::Display;

/// The width of a small picture, pixels.
const THUMB: usize = 320;

/// A change of what is said of a target.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct Edit {
    pub(crate) name: Option<String>,
}

fn told(app: &App, name: &str, kept: &KeptTarget) -> Value {
    let target = &kept.target;
    let taken = target.taken.as_deref();
    let size = taken.map(|taken| [taken.frame.width, taken.frame.height]);
    let um_per_px = taken.map(|taken| taken.um_per_px);
    json!({
        "name": name,
        "saved": kept.saved,
        "instrument": kept.instrument,
        "own": kept.instrument == app.bench.config.name,
        "slide": null,
        "note": "",
        "objective": target.objective,
        "um_per_px": um_per_px,
        "width": size.map(|s| s[0]),
        "height": size.map(|s| s[1]),
        "features": target.features.len(),
        "quality": quality(target.quality.as_ref()),
        "at": Place::from(&kept.stage),
    })
}

/// How surely it is come back to, as a word with its reason.
fn quality(quality: Option<&TargetQuality>) -> Value {
    let Some(quality) = quality else {
        return json!({"word": "unknown", "text": "it was saved by an earlier version", "chance": null});
    };
    let word = match quality.chance {
        chance if chance >= 0.9 => "good",
        chance if chance >= 0.6 => "fair",
        _ => "poor",
    };
    json!({"word": word, "text": quality.to_string(), "chance": quality.chance})
}

/// What is to be told of a target that may be damaged: read anew where its file is another.
fn told_or_wrong(app: &App, name: &str) -> Value {
    let damaged =
        |error: &dyn Display| json!({"name": name, "saved": "", "damaged": error.to_string()});
    let path = match app.bench.library.target_path(name) {
        Ok(path) => path,
        Err(error) => return damaged(&error),
    };
    let stamp = Stamp::of(&path);
    if let Some(value) = app.told.get(&path, stamp) {
        return value;
    }
    match app.bench.library.target(name) {
        Err(error) => damaged(&error),
        Ok(kept) => {
            let value = told(app, name, &kept);
            app.told.put(path, stamp, value.clone());
            value
        }
    }
}

/// All of them, the newest first; one that is damaged is there with what is wrong with it.
pub(crate) fn targets(app: &App, text: &str) -> Result<Value, ApiError> {
    let names = app.bench.library.target_names()?;
    let paths = names
        .iter()
        .filter_map(|name| app.bench.library.target_path(name).ok());
    app.told.keep(&paths.collect());
    let names = names.into_iter();
    let wanted = text.to_lowercase();
    let mut all: Vec<Value> = names
        .filter(|name| name.to_lowercase().contains(&wanted))
        .map(|name| told_or_wrong(app, &name))
        .collect();
    all.sort_by(|a, b| b["saved"].as_str().cmp(&a["saved"].as_str()));
    Ok(Value::Array(all))
}

/// One of them.
pub(crate) fn target(app: &App, name: &str) -> Result<Value, ApiError> {
    Ok(told(app, name, &app.bench.library.target(name)?))
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
    let name = match &edit.name {
        Some(to) => {
            app.bench.library.rename_target(name, to)?;
            app.has_changed();
            to
        }
        None => name,
    };
    target(app, name)
}

/// Takes it out; it lies in the bin.
pub(crate) fn remove(app: &App, name: &str) -> Result<(), ApiError> {
    app.bench.library.remove_target(name)?;
    app.has_changed();
    Ok(())
}
