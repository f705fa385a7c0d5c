//! The keys of the JSON that `--json` prints, where they are many. Keys are stable: they are added to, never renamed.

use scopeservo_geometry::Affine2;
use scopeservo_scope::Axis;
use scopeservo_servo::{
    Calibration, Change, Changing, LimitedBy, Missing, Outcome, Reason, TargetQuality, Verdict,
};
use serde::Serialize;

/// A verdict as people read it.
pub(crate) fn word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Arrived => "arrived",
        Verdict::NotFound => "not found",
        Verdict::Refused => "refused",
        Verdict::Ambiguous => "ambiguous",
    }
}

/// The command that this run is.
pub(crate) fn command_line() -> String {
    std::iter::once("scopeservo".to_string())
        .chain(
            std::env::args_os()
                .skip(1)
                .map(|a| a.to_string_lossy().into_owned()),
        )
        .collect::<Vec<_>>()
        .join(" ")
}

/// Now, for people: 2026-11-24 20:15 UTC.
pub(crate) fn date() -> String {
    scopeservo_workbench::readable(&scopeservo_library::utc(std::time::SystemTime::now()))
}

/// A number of so many decimals, without a sign of nothing.
pub(crate) fn signed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|b| matches!(b, b'0' | b'.')) => rest.into(),
        _ => text,
    }
}

#[derive(Debug, Serialize)]
pub(crate) struct DemoJson {
    pub(crate) verdict: Verdict,
    pub(crate) reason: Reason,
    pub(crate) message: String,
    pub(crate) estimated_error_um: Option<f64>,
    pub(crate) estimated_error_deg: Option<f64>,
    pub(crate) limited_by: Option<LimitedBy>,
    pub(crate) angle_left_deg: Option<f64>,
    pub(crate) in_view: Option<f64>,
    pub(crate) missing: Option<MissingJson>,
    pub(crate) true_error_um: Option<f64>,
    pub(crate) true_error_deg: Option<f64>,
    pub(crate) virtual_time_s: f64,
    pub(crate) moves: u64,
    pub(crate) frames: u64,
    pub(crate) magnifications: Vec<MagnificationJson>,
    pub(crate) noise: &'static str,
    pub(crate) method: &'static str,
    pub(crate) lambda: Option<f64>,
    pub(crate) seed: u64,
    pub(crate) specimen: String,
    pub(crate) start_um: [f64; 2],
    pub(crate) start_deg: f64,
    pub(crate) engine: String,
    pub(crate) cpu_level: String,
}

#[derive(Debug, Serialize)]
pub(crate) struct MagnificationJson {
    pub(crate) objective: String,
    pub(crate) magnification: f64,
    pub(crate) end: &'static str,
    pub(crate) iterations: Option<usize>,
    pub(crate) inliers: Option<usize>,
    pub(crate) error_um: Option<f64>,
    pub(crate) error_deg: Option<f64>,
    pub(crate) calibration: CalibrationJson,
}

#[derive(Debug, Serialize)]
pub(crate) struct CalibrationJson {
    pub(crate) um_per_px: f64,
    pub(crate) kx_px_per_m: Option<f64>,
    pub(crate) ky_px_per_m: Option<f64>,
    pub(crate) phi_deg: Option<f64>,
    pub(crate) rotation_centre_mm: Option<[f64; 2]>,
    /// x, y (um), rotation (deg).
    pub(crate) backlash: Option<[f64; 3]>,
    /// Of one move of 100 um and, where the stage turns, 1 deg: standard deviation of the distance, um.
    pub(crate) expected_error_um: Option<f64>,
    pub(crate) full: Calibration,
}

/// What is expected of a target.
#[derive(Debug, Serialize)]
pub(crate) struct QualityJson<'a> {
    /// Whether it can be told from its surroundings.
    pub(crate) ok: bool,
    /// In words, with what would help.
    pub(crate) message: String,
    #[serde(flatten)]
    pub(crate) expected: &'a TargetQuality,
}

pub(crate) fn quality(expected: &TargetQuality) -> QualityJson<'_> {
    QualityJson {
        ok: expected.can_be_told(),
        message: format!("it {expected}"),
        expected,
    }
}

#[derive(Debug, Serialize)]
pub(crate) struct MissingJson {
    pub(crate) axes: Vec<BeyondJson>,
    pub(crate) turned_deg: f64,
    pub(crate) turn_back_deg: Option<f64>,
}

/// In um or deg: above the upper end, or below the lower one where it is negative.
#[derive(Debug, Serialize)]
pub(crate) struct BeyondJson {
    pub(crate) axis: Axis,
    pub(crate) by: f64,
    pub(crate) unit: &'static str,
    pub(crate) from: f64,
    pub(crate) to: f64,
}

pub(crate) fn missing(missing: &Missing) -> MissingJson {
    let axes = missing.beyond.iter().map(|b| BeyondJson {
        axis: b.axis,
        by: b.axis.to_display(b.by),
        unit: b.axis.display_unit(),
        from: b.axis.to_display(b.min),
        to: b.axis.to_display(b.max),
    });
    MissingJson {
        axes: axes.collect(),
        turned_deg: missing.turned_deg,
        turn_back_deg: missing.turn_back_deg,
    }
}

pub(crate) fn magnifications(outcome: &Outcome) -> Vec<MagnificationJson> {
    outcome
        .magnifications
        .iter()
        .map(|m| {
            let (end, result) = (m.end.word(), m.end.result());
            MagnificationJson {
                objective: m.objective.0.clone(),
                magnification: m.magnification,
                end,
                iterations: result.map(|r| r.iterations),
                inliers: result.map(|r| r.inliers),
                error_um: result.map(|r| r.error.distance_um()),
                error_deg: result.map(|r| r.error.angle_deg()),
                calibration: calibration(&m.calibration),
            }
        })
        .collect()
}

pub(crate) fn calibration(c: &Calibration) -> CalibrationJson {
    let reading = c.reading();
    CalibrationJson {
        um_per_px: c.um_per_px(),
        kx_px_per_m: reading.map(|r| r.kx_px_per_m),
        ky_px_per_m: reading.map(|r| r.ky_px_per_m),
        phi_deg: reading.map(|r| r.phi_rad.to_degrees()),
        rotation_centre_mm: c.rotation_centre_m.map(|e| e.map(|v| v * 1e3)),
        backlash: c
            .backlash
            .map(|b| [b.x_m * 1e6, b.y_m * 1e6, b.rz_rad.to_degrees()]),
        expected_error_um: c.expected_error_um(),
        full: c.clone(),
    }
}

#[derive(Debug, Serialize)]
pub(crate) struct RegisterJson {
    pub(crate) verdict: &'static str,
    pub(crate) reason: String,
    pub(crate) message: String,
    pub(crate) target_from_view: Option<Affine2>,
    /// Where it is as well: of two that say as much.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) other_target_from_view: Option<Affine2>,
    /// Whether the view is a mirror image.
    pub(crate) mirrored: bool,
    pub(crate) inliers: usize,
    pub(crate) sigma_px: Option<f64>,
    pub(crate) scale: Option<f64>,
    pub(crate) rotation_deg: Option<f64>,
    pub(crate) matches: usize,
    pub(crate) keypoints: [usize; 2],
    pub(crate) log10_false_alarms: Option<f64>,
    /// Factor by which view and target were reduced before looking; coordinates are full-resolution all the same.
    pub(crate) reduced: [usize; 2],
    /// Levels of view and target that were looked at.
    pub(crate) level: [usize; 2],
    /// Pixel sizes of these levels, um, where the files state them.
    pub(crate) um_per_px: [Option<f64>; 2],
    /// What there was to choose from in view and target, where there was: pages and channels.
    pub(crate) choices: [Option<String>; 2],
    /// With `--time`: median milliseconds of the view's features, match and fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) ms: Option<f64>,
    pub(crate) engine: String,
    pub(crate) cpu_level: String,
}

/// How a number of a calibration has changed, with how sure that is.
pub(crate) fn change_in_words(change: &Change) -> String {
    let (name, unit, digits) = match change.what {
        Changing::ScalePercent => ("scale", "%", 2),
        Changing::AngleDeg => ("camera's angle", "deg", 3),
        Changing::StretchPercent => ("x against y", "%", 2),
        Changing::SquareDeg => ("right angle", "deg", 3),
        Changing::CentreXUm => ("axis of rotation x", "um", 0),
        Changing::CentreYUm => ("axis of rotation y", "um", 0),
    };
    format!(
        "{name} {:+.digits$} +- {:.digits$} {unit} ({:.1} sigma)",
        change.by,
        change.sigma,
        change.sigmas()
    )
}

/// All of them; of the axes only what is there for sure.
pub(crate) fn changes_in_words(changes: &[Change]) -> String {
    let of_axes = |c: &Change| matches!(c.what, Changing::StretchPercent | Changing::SquareDeg);
    let told = changes.iter().filter(|c| !of_axes(c) || c.sigmas() > 3.0);
    let all: Vec<String> = told.map(change_in_words).collect();
    all.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_has_no_sign() {
        for (value, text) in [
            (-0.00001, "0.0000"),
            (-0.0, "0.0000"),
            (-0.00006, "-0.0001"),
            (0.00001, "0.0000"),
            (-1.5, "-1.5000"),
        ] {
            assert_eq!(signed(value, 4), text);
        }
    }
}
