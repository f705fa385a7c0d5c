//! `scopeservo calibrate`.

use super::library_of;
use super::report::{failure, work_page};
use crate::answer::Answer;
use crate::args::CalibrateArgs;
use crate::error::{CliError, Code};
use crate::open_instrument::OpenInstrument;
use crate::output::calibration as calibration_json;
use crate::progress::Watcher;
use crate::views::{keep_report, try_out};
use scopeservo_library::Calibrations as _;
use scopeservo_report::{Work, WorkEnd};
use scopeservo_scope::{Objective, ObjectiveId, um_in_words};
use scopeservo_servo::{
    CalibrateOptions, Calibration, EXAMPLE_MOVE, Known, Parcentric, SwitchingReport,
};
use scopeservo_station::jobs::{CalibrateJob, CalibrateOutput, Whole};
use scopeservo_workbench::{Asked, Made};
use serde_json::json;
use std::path::Path;
use std::time::Instant;

pub(crate) fn calibrate(args: &CalibrateArgs, answer: &Answer) -> Result<bool, CliError> {
    let focus = args.focusing.options()?;
    if args.switching == 1 || args.switching > 100 {
        return Err(CliError::Usage(
            "--switching must be 0, or from 2 to 100: one arrival tells no scatter".into(),
        ));
    }
    // Before anything moves, and before it is opened.
    library_of(&args.instrument.description, answer)?.try_calibrations(&[])?;
    try_out(&args.report.out)?;
    let opened = OpenInstrument::open(&args.instrument, answer)?;
    opened.check_nothing_waits()?;
    let named = args.objective.iter().cloned().map(ObjectiveId);
    let objectives: Vec<ObjectiveId> = named.collect();
    let wanted = |o: &&Objective| objectives.is_empty() || objectives.contains(&o.id);
    let all = opened.scope.gate().objectives().iter();
    let wanted: Vec<Objective> = all.filter(wanted).cloned().collect();
    for named in &objectives {
        opened.scope.objective(named)?;
    }
    opened.library.try_calibrations(&wanted)?;
    let how = CalibrateOptions {
        method: args.method.into(),
        ..CalibrateOptions::default()
    };
    let focus = (!args.no_focus).then_some(focus);
    let input = opened
        .usual()
        .calibrate(objectives, focus, how, args.switching);
    let asked = Asked {
        inputs: json!(input),
        ..Asked::default()
    };
    let job = CalibrateJob::new(input);
    run(&opened, job, asked, &args.report.out, answer)
}

/// Runs the job, from its beginning or from where it was.
pub(super) fn run(
    opened: &OpenInstrument,
    job: CalibrateJob,
    asked: Asked,
    out: &Path,
    answer: &Answer,
) -> Result<bool, CliError> {
    answer.put(json!({"calibrations": []}));
    let before = in_use(opened);
    let mut watcher = Watcher::new(None);
    watcher.recorder.keep_calibration_views();
    let started = Instant::now();
    let ran = opened.run(job, asked, &mut watcher, answer)?;
    match &ran.output {
        Ok(output) => {
            let made = all_made(opened, output, &ran.made);
            show_made(answer, &made, output.together.as_ref());
            show_switching(answer, &output.switching);
        }
        Err(_) => show_made(answer, &ran.made, None),
    }
    let end = WorkEnd {
        work: Work::Calibration,
        failed: failure(&ran.output),
        before,
    };
    let page = work_page(opened, &watcher, &end, started);
    keep_report(out, &page, ran.output.as_ref().err(), answer);
    ran.end(Some(&page), answer).map(|_| true)
}

/// What this camera's objectives are calibrated with now, each with when it was made.
fn in_use(opened: &OpenInstrument) -> Vec<(String, Calibration)> {
    let objectives = opened.scope.gate().objectives().iter();
    // One that is damaged is replaced now, and was of no use.
    let kept = objectives.filter_map(|o| opened.calibration_of(o).ok().flatten());
    kept.filter(|k| k.instrument == opened.config.name)
        .map(|k| (k.made, k.calibration))
        .collect()
}

/// What the job made, those included that a program made and kept before it was killed.
fn all_made(opened: &OpenInstrument, output: &CalibrateOutput, now: &[Made]) -> Vec<Made> {
    let all = output.made.iter().map(|calibration| {
        let made_now = now.iter().find(|made| made.calibration == *calibration);
        made_now.cloned().unwrap_or_else(|| {
            let objective = &calibration.calibration.objective;
            let file = opened
                .library
                .calibration_path(&opened.config.name, objective);
            Made {
                calibration: calibration.clone(),
                file: file.ok().flatten(),
            }
        })
    });
    all.collect()
}

/// What was measured, and where it is kept.
fn show_made(answer: &Answer, made: &[Made], together: Option<&Whole>) {
    let first = made.first().map(|m| m.calibration.calibration.clone());
    for Made { calibration, file } in made {
        let made = calibration;
        show_calibration(answer, &made.calibration, made.residual_px);
        let parcentric = first
            .as_ref()
            .and_then(|first| parcentric_um(first, &made.calibration, together));
        if let (Some(first), Some(([x, y], sigma))) = (&first, parcentric) {
            let from = &first.objective;
            say!(
                answer,
                "  its centre lies {x:.1}, {y:.1} +- {sigma:.1} um from that of {from}"
            );
        }
        if let Some(file) = file {
            say!(answer, "  kept in {}", file.display());
        }
        let entry = json!({
            "objective": made.calibration.objective,
            "file": file.as_deref().map(Path::to_string_lossy),
            "focus_z_um": made.focus_z_um,
            "residual_px": made.residual_px,
            "parcentric_um": parcentric.map(|(offset, _)| offset),
            "calibration": calibration_json(&made.calibration),
        });
        answer.push("calibrations", entry);
    }
    if let Some(together) = together {
        show_together(answer, together);
    }
}

/// Whether the objectives are one instrument.
fn show_together(answer: &Answer, together: &Whole) {
    match together {
        Whole::One(set) => {
            let (chi_sq, freedom) = (set.chi_sq, set.freedom);
            say!(
                answer,
                "all {} objectives agree, as one instrument (chi-square {chi_sq:.1} of {freedom}); {} times one was seen in the view of another",
                set.calibrations.len(),
                set.linked
            );
            answer.put(json!({"set": {
                "agrees": true,
                "chi_square": chi_sq,
                "freedom": freedom,
                "linked": set.linked,
                "parcentric": set.parcentric,
            }}));
        }
        Whole::NotOne(why) => {
            answer.warn(Code::ObjectivesDisagree, why.to_string());
            answer.put(json!({"set": {
                "agrees": false,
                "odd": why.odd,
                "between": why.between,
                "difference": why.difference,
            }}));
        }
    }
}

/// What switching has shown.
fn show_switching(answer: &Answer, all: &[SwitchingReport]) {
    let known = |k: &Known, digits: usize| format!("{:.digits$} +- {:.digits$}", k.value, k.sigma);
    for report in all {
        let SwitchingReport { from, to, .. } = report;
        let ([x, y], [sx, sy]) = (&report.offset_um, &report.repeatability_um);
        say!(
            answer,
            "{to} after {from}, {} times: its centre lies x {}, y {} um from there",
            report.arrivals[1],
            known(x, 2),
            known(y, 2)
        );
        if let Some(focus) = &report.focus {
            say!(
                answer,
                "  its focus lies at z {} um from there, and one arrival repeats to {} um",
                known(&focus.offset_um, 2),
                known(&focus.repeatability_um, 2)
            );
        }
        say!(
            answer,
            "  one arrival repeats to x {}, y {} um and {} deg (standard deviations)",
            known(sx, 2),
            known(sy, 2),
            known(&report.repeatability_deg, 4)
        );
    }
    if !all.is_empty() {
        answer.put(json!({"switching": all}));
    }
}

/// Where the centre of an objective lies beside that of the first one, in stage axes, with the standard deviation of both numbers, um: by what all
/// of them say together, else by their rotation centres.
fn parcentric_um(
    first: &Calibration,
    other: &Calibration,
    together: Option<&Whole>,
) -> Option<([f64; 2], f64)> {
    if first.objective == other.objective {
        return None;
    }
    if let Some(Whole::One(set)) = together {
        let of = |p: &&Parcentric| (&p.from, &p.to) == (&first.objective, &other.objective);
        let [x, y] = set.parcentric.iter().find(of)?.offset_um;
        let sigma = ((x.sigma.powi(2) + y.sigma.powi(2)) / 2.0).sqrt();
        return Some(([x.value, y.value], sigma));
    }
    let (a, b) = (first.rotation_centre_m?, other.rotation_centre_m?);
    let variance = |c: &Calibration| c.covariance.map(|v| (v[4][4] + v[5][5]) / 2.0);
    let sigma = (variance(first)? + variance(other)?).sqrt();
    Some(([1e6 * (b[0] - a[0]), 1e6 * (b[1] - a[1])], 1e6 * sigma))
}

fn show_calibration(answer: &Answer, calibration: &Calibration, residual_px: Option<f64>) {
    // Of the first column's length, relative.
    let column_m = |c: &Calibration| {
        let [[a, _], [b, _]] = c.stage_from_pixel.0;
        f64::hypot(a, b)
    };
    let sigma = calibration
        .sigma_of(|c| Some(column_m(c)))
        .map(|s| 100.0 * s / column_m(calibration));
    say!(
        answer,
        "{}: {:.4} um per pixel{}{}",
        calibration.objective,
        calibration.um_per_px(),
        sigma.map_or(String::new(), |s| format!(" (+-{s:.3} %)")),
        residual_px.map_or(String::new(), |r| format!(
            ", views are within {r:.2} px of where the stage says"
        ))
    );
    if let Some(r) = calibration.reading() {
        say!(
            answer,
            "  kx {:.0}, ky {:.0} pixels per metre, camera turned {:.3} deg against the stage",
            r.kx_px_per_m,
            r.ky_px_per_m,
            r.phi_rad.to_degrees()
        );
    } else {
        say!(answer, "  the image is mirrored against the stage");
    }
    match calibration.rotation_centre_m {
        Some(eta) => say!(
            answer,
            "  the view lies {:.3}, {:.3} mm from the axis of rotation",
            eta[0] * 1e3,
            eta[1] * 1e3
        ),
        None => say!(answer, "  the stage does not turn"),
    }
    if let Some(b) = calibration.backlash {
        let um = |v: f64, sigma: f64| format!("{:.2} +- {:.2} um", 1e6 * v, 1e6 * sigma);
        say!(
            answer,
            "  backlash: x {}, y {}{}",
            um(b.x_m, b.sigma[0]),
            um(b.y_m, b.sigma[1]),
            match b.sigma[2] > 0.0 {
                true => format!(
                    ", rotation {:.4} +- {:.4} deg",
                    b.rz_rad.to_degrees(),
                    b.sigma[2].to_degrees()
                ),
                false => String::new(),
            }
        );
    }
    if let Some(off_um) = calibration.expected_error_um() {
        let turns = calibration.rotation_centre_m.map_or("", |_| " and 1 deg");
        say!(
            answer,
            "  one move of {:.0} um{turns} is expected to end {} off",
            EXAMPLE_MOVE.0 * 1e6,
            um_in_words(off_um, 2)
        );
    }
}
