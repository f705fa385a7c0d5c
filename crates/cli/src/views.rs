//! Every view of a run as a PNG, with its hidden pose, so that an outsider can recompute the errors.

use crate::error::CliError;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};
use scopeservo_scope::Frame;
use scopeservo_servo::{Event, FrameRole, Stamped};
use scopeservo_twin::{Truth, Twin};
use serde::Serialize;
use std::fs;
use std::io::BufWriter;
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
        fs::create_dir_all(&folder).map_err(|source| CliError::Write {
            path: folder.clone(),
            source,
        })?;
        // Views of an earlier run would pass for this one's.
        let old = fs::read_dir(&folder).into_iter().flatten().flatten();
        for entry in old.filter(|e| e.path().extension().is_some_and(|x| x == "png")) {
            let path = entry.path();
            fs::remove_file(&path).map_err(|source| CliError::Write { path, source })?;
        }
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
        let written = fs::File::create(&path).and_then(|file| {
            PngEncoder::new_with_quality(
                BufWriter::new(file),
                CompressionType::Fast,
                FilterType::Sub,
            )
            .write_image(
                &frame.rgb8(),
                frame.width as u32,
                frame.height as u32,
                ExtendedColorType::Rgb8,
            )
            .map_err(std::io::Error::other)
        });
        if let Err(source) = written {
            self.failed = Some(CliError::Write { path, source });
        }
    }

    pub(crate) fn event(&mut self, stamped: &Stamped) {
        if let Event::FrameGrabbed {
            sequence,
            role,
            objective,
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
        write_json(&out.join("views.json"), &self.records)
    }
}

/// Writes a JSON file whole or not at all.
pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), CliError> {
    let text = serde_json::to_string_pretty(value)
        .map_err(|e| CliError::Internal(format!("{} could not be made: {e}", path.display())))?;
    scopeservo_report::write(path, &text).map_err(|source| CliError::Write {
        path: path.into(),
        source,
    })
}
