//! `scopeservo calibrations`: all that are kept, without an instrument.

use crate::answer::Answer;
use crate::args::CalibrationsArgs;
use crate::commands::library_of;
use crate::error::CliError;
use crate::output::{calibration as calibration_json, changes_in_words};
use scopeservo_library::{CalibrationFile, Calibrations as _, KeptCalibration};
use scopeservo_scope::{ObjectiveId, um_in_words};
use scopeservo_servo::{Calibration, changes_between};
use scopeservo_setup::Config;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;

pub(crate) fn run(args: &CalibrationsArgs, answer: &Answer) -> Result<bool, CliError> {
    let history = library_of(&args.kept.description, answer)?.calibration_history()?;
    let own = Config::read(&args.kept.description.config)?.name;
    answer.put(json!({"history": []}));
    let wanted = |id: &ObjectiveId| args.objective.as_ref().is_none_or(|o| *o == id.0);
    let mut shown = 0;
    for files in history {
        let is_own = |file: &CalibrationFile| file.kept.as_ref().map_or(true, |k| k.is_of(&own));
        let in_use = files.iter().rposition(is_own);
        // Of each instrument.
        let mut before: BTreeMap<String, KeptCalibration> = BTreeMap::new();
        for (k, CalibrationFile { path, kept }) in files.into_iter().enumerate() {
            // One that is damaged does not keep the others away.
            let Some(kept) = answer.or_warn(kept) else {
                continue;
            };
            if !wanted(&kept.calibration.objective) {
                continue;
            }
            let former = before.get(&kept.instrument);
            let is_first = before.is_empty();
            let is_in_use = in_use == Some(k);
            show(answer, (&path, &kept), (former, is_first), is_in_use);
            if !kept.is_of(&own) {
                say!(answer, "      of '{}'", kept.instrument);
            }
            before.insert(kept.instrument.clone(), kept);
            shown += 1;
        }
    }
    if shown == 0 {
        say!(answer, "no calibration is kept yet: scopeservo calibrate");
    }
    Ok(true)
}

fn show(
    answer: &Answer,
    (path, kept): (&Path, &KeptCalibration),
    (before, is_first): (Option<&KeptCalibration>, bool),
    in_use: bool,
) {
    let calibration = &kept.calibration;
    if is_first {
        say!(answer, "{}", calibration.objective);
    }
    let changes = before.and_then(|b| changes_between(&b.calibration, calibration));
    if before.is_some() {
        let words = changes.as_ref().map(|c| changes_in_words(c));
        let unknown = || "not told, as not both know their own uncertainty".into();
        say!(answer, "      changed: {}", words.unwrap_or_else(unknown));
    }
    say!(
        answer,
        "  {} {}  {}",
        if in_use { "*" } else { " " },
        kept.made,
        row(calibration)
    );
    say!(
        answer,
        "      {}{}",
        path.display(),
        if in_use { ", in use" } else { "" }
    );
    let entry = json!({
        "objective": calibration.objective,
        "made": kept.made,
        "instrument": kept.instrument,
        "file": path.to_string_lossy(),
        "in_use": in_use,
        "calibration": calibration_json(calibration),
        "changes": changes,
    });
    answer.push("history", entry);
}

fn row(c: &Calibration) -> String {
    let angle = c.reading().map_or("mirrored".into(), |r| {
        format!("camera {:.3} deg", r.phi_rad.to_degrees())
    });
    let centre = c
        .rotation_centre_m
        .map(|[x, y]| format!(", axis {:.3}, {:.3} mm", 1e3 * x, 1e3 * y));
    let play = c
        .backlash
        .map(|b| format!(", backlash {:.2}, {:.2} um", 1e6 * b.x_m, 1e6 * b.y_m));
    let error = c
        .expected_error_um()
        .map(|um| format!(", expected error {}", um_in_words(um, 2)));
    format!(
        "{:.4} um per px, {angle}{}{}{}",
        c.um_per_px(),
        centre.unwrap_or_default(),
        play.unwrap_or_default(),
        error.unwrap_or_default()
    )
}
