//! Every view of a run as a PNG, with its hidden pose, so that an outsider can recompute the errors.

use crate::answer::Answer;
use crate::error::CliError;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use scopeservo_library::LibraryError;
use scopeservo_library::files::{make_folder, replace, try_folder};
use scopeservo_scope::Frame;
use scopeservo_servo::{Event, FrameRole, Stamped};
use scopeservo_twin::{Truth, Twin};
use serde::Serialize;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

#[derive(Debug, Serialize)]
struct ViewRecord {
    file: String,
    sequence: u64,
    time_s: f64,
    role: FrameRole,
    objective: String,
    truth: Truth,
}

/// Writes frames as they come.
pub(crate) struct ViewWriter {
    folder: PathBuf,
    twin: Twin,
    records: Vec<ViewRecord>,
    failed: Option<CliError>,
}

impl ViewWriter {
    /// Makes `DIR/views`.
    pub(crate) fn new(out: &Path, twin: Twin) -> Result<Self, CliError> {
        let folder = out.join("views");
        make_folder(&folder).map_err(cannot_write(&folder))?;
        Ok(Self {
            folder,
            twin,
            records: Vec::new(),
            failed: None,
        })
    }

    fn file_name(sequence: u64) -> String {
        format!("{sequence:05}.png")
    }

    pub(crate) fn frame(&mut self, frame: &Frame) {
        if self.failed.is_some() {
            return;
        }
        let path = self.folder.join(Self::file_name(frame.sequence));
        let (width, height) = (frame.width as u32, frame.height as u32);
        let mut png = Vec::new();
        let written =
            PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Sub)
                .write_image(&frame.rgb8(), width, height, ExtendedColorType::Rgb8)
                .map_err(std::io::Error::other)
                .and_then(|()| fs::write(&path, png));
        if let Err(source) = written {
            // Half an image is none.
            let _ = fs::remove_file(&path);
            self.failed = Some(LibraryError::not_kept(&path)(source).into());
        }
    }

    pub(crate) fn event(&mut self, stamped: &Stamped) {
        if let Event::FrameGrabbed {
            sequence,
            role,
            objective,
            ..
        } = &stamped.event
            && let Some(truth) = self.twin.truth(*sequence)
        {
            self.records.push(ViewRecord {
                file: format!("views/{}", Self::file_name(*sequence)),
                sequence: *sequence,
                time_s: stamped.time_s,
                role: *role,
                objective: objective.0.clone(),
                truth,
            });
        }
    }

    /// Writes `DIR/views.json`.
    pub(crate) fn finish(self, out: &Path) -> Result<(), CliError> {
        if let Some(error) = self.failed {
            return Err(error);
        }
        keep_json(&out.join("views.json"), &self.records)
    }
}

/// Files that a run leaves in its folder, beside the views.
const OURS: [&str; 4] = ["report.html", "result.json", "events.json", "views.json"];

/// Removes what an earlier run left in `out`, so that nothing of it can pass for this run's: our four files, and the views
/// that its `views.json` lists. Other files are not touched.
pub(crate) fn clear_earlier_run(out: &Path) -> Result<(), CliError> {
    let listed = fs::read_to_string(out.join("views.json"))
        .ok()
        .and_then(|text| serde_json::from_str::<Vec<serde_json::Value>>(&text).ok())
        .unwrap_or_default();
    let views = listed
        .iter()
        .filter_map(|view| view["sequence"].as_u64())
        .map(|sequence| out.join("views").join(ViewWriter::file_name(sequence)));
    for path in views.chain(OURS.map(|name| out.join(name))) {
        match fs::remove_file(&path) {
            Err(source) if source.kind() != std::io::ErrorKind::NotFound => {
                return Err(cannot_write(&path)(source));
            }
            _ => {}
        }
    }
    Ok(())
}

/// Why nothing can be kept in the folder of `--out`.
fn cannot_write(path: &Path) -> impl FnOnce(io::Error) -> CliError {
    let path = path.into();
    |source| CliError::CannotWrite {
        path,
        source,
        instead: "give another folder with --out",
    }
}

/// Refuses a folder of `--out` that takes no files, before anything is done for it.
pub(crate) fn try_out(out: &Path) -> Result<(), CliError> {
    try_folder(out).map_err(cannot_write(out))
}

/// Keeps a file of a run, in a folder that is made for it, in place of an earlier run's.
fn keep(path: &Path, text: &str) -> Result<(), CliError> {
    path.parent()
        .map_or(Ok(()), make_folder)
        .and_then(|()| replace(path, text.as_bytes()))
        .map_err(LibraryError::not_kept(path))?;
    Ok(())
}

/// The same for a JSON file.
pub(crate) fn keep_json(path: &Path, value: &impl Serialize) -> Result<(), CliError> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|e| CliError::Internal(format!("{} could not be made: {e}", path.display())))?;
    keep(path, &text)
}

/// Keeps the report of a run and, last, its result: the answer as it then stands, or the error that it ended with.
pub(crate) fn keep_report(out: &Path, page: &str, error: Option<&CliError>, answer: &Answer) {
    let report = out.join("report.html");
    if answer.or_warn(keep(&report, page)).is_some() {
        say!(answer, "  report: {}", report.display());
    }
    let object = match error {
        Some(error) => answer.object_with(error),
        None => answer.object(),
    };
    answer.or_warn(keep_json(&out.join("result.json"), &object));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_an_earlier_run_left_is_removed() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path();
        fs::create_dir(out.join("views")).unwrap();
        let list = r#"[{"sequence": 7, "file": "../../etc/passwd"}]"#;
        for (name, text) in [
            ("views.json", list),
            ("report.html", "old"),
            ("notes.txt", "mine"),
            ("views/00007.png", "old"),
            ("views/holiday.png", "mine"),
            ("views/00008.png", "not listed"),
        ] {
            fs::write(out.join(name), text).unwrap();
        }
        clear_earlier_run(out).unwrap();
        for (name, kept) in [
            ("views.json", false),
            ("report.html", false),
            ("notes.txt", true),
            ("views/00007.png", false),
            ("views/holiday.png", true),
            ("views/00008.png", true),
        ] {
            assert_eq!(out.join(name).exists(), kept, "{name}");
        }
        clear_earlier_run(out).unwrap();
    }
}
