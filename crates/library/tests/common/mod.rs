//! Views without features, each its own: enough to be kept.

#![allow(dead_code, reason = "each test uses what it needs")]

use scopeservo_features::Features;
use scopeservo_geometry::Mat2;
use scopeservo_library::{Database, Label, LibraryError, NewTarget, RunHead, Runs as _, Targets};
use scopeservo_scope::{Channels, Frame, ObjectiveId, Samples, StagePose, Timestamp};
use scopeservo_servo::{Calibration, Target};
use serde_json::json;
use std::path::PathBuf;
use std::time::Duration;

/// An image that differs from that of another level.
pub(crate) fn frame(level: u8) -> Frame {
    Frame {
        width: 4,
        height: 3,
        channels: Channels::Gray,
        bit_depth: 8,
        samples: Samples::U8(vec![level; 12]),
        sequence: 0,
        exposure_start: Timestamp::default(),
        exposure: Duration::ZERO,
    }
}

pub(crate) fn view() -> Target {
    Target {
        objective: ObjectiveId("40x".into()),
        features: Features::none("sift", 4, 3),
        picture: None,
        periods_px: Vec::new(),
        moved: None,
        mask: None,
        quality: None,
        taken: None,
    }
}

pub(crate) fn label(slide: &str, note: &str) -> Label {
    Label {
        slide: (!slide.is_empty()).then(|| slide.into()),
        note: note.into(),
    }
}

pub(crate) fn keep(
    library: &impl Targets,
    name: &str,
    label: &Label,
) -> Result<PathBuf, LibraryError> {
    let level = name.bytes().fold(0, u8::wrapping_add);
    library.keep_target(NewTarget {
        name,
        instrument: "lab",
        stage: StagePose::default(),
        target: view(),
        frame: &frame(level),
        label,
    })
}

pub(crate) fn calibration(objective: &str, um_per_px: f64) -> Calibration {
    Calibration {
        schema: scopeservo_servo::CALIBRATION_SCHEMA,
        objective: ObjectiveId(objective.into()),
        image_size_px: [640, 480],
        stage_from_pixel: Mat2::diagonal(um_per_px * 1e-6, um_per_px * 1e-6),
        rotation_centre_m: None,
        covariance: None,
        backlash: None,
        scatter: None,
    }
}

pub(crate) fn head(job: &str, target: &str) -> RunHead {
    RunHead {
        job: job.into(),
        instrument: "lab".into(),
        version: "scopeservo 0.1.0".into(),
        inputs: json!({"name": target, "user": "anna"}),
    }
}

/// A run with events and a report; its id.
pub(crate) fn run(
    library: &Database,
    job: &str,
    target: &str,
    events: usize,
    report: &[u8],
) -> String {
    let mut run = library.begin_run(&head(job, target)).unwrap();
    for n in 0..events {
        run.event(&json!({"event": n, "about": target}).to_string());
    }
    run.attach("report.html", report).unwrap();
    let id = run.id().to_owned();
    run.end(&json!({"verdict": "arrived", "message": "it is back", "seconds": 1.5}))
        .unwrap();
    id
}
