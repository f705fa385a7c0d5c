//! `scopeservo reposition`.

use super::report::context;
use super::{known_calibrations, library_of};
use crate::answer::Answer;
use crate::args::RepositionArgs;
use crate::colour;
use crate::error::{CliError, Code};
use crate::open_instrument::{OpenInstrument, Ran};
use crate::output;
use crate::progress::Watcher;
use crate::views::{keep_report, try_out};
use scopeservo_library::{KeptTarget, Targets as _};
use scopeservo_report as report;
use scopeservo_scope::Axis;
use scopeservo_servo::{FrameRole, Outcome, Reason, ServoOptions, Sink as _, Verdict};
use scopeservo_setup::Config;
use scopeservo_station::jobs::{RepositionInput, RepositionJob, RepositionOutput};
use scopeservo_workbench::{Asked, Usual};
use serde_json::json;
use std::path::Path;
use std::time::Instant;

pub(crate) fn reposition(args: &RepositionArgs, answer: &Answer) -> Result<bool, CliError> {
    let asked = args.moving.options()?;
    let focus = args.focusing.options()?;
    // What can be wrong without the instrument is found before it is touched.
    let config = Config::read(&args.instrument.description.config)?;
    let options = Usual::of(&config).reposition(asked, focus);
    let kept = library_of(&args.instrument.description, answer)?.target(&args.name)?;
    let foreign_um_per_px = match kept.instrument == config.name {
        true => None,
        false => Some(foreign_scale(&args.name, &kept, &config, answer)?),
    };
    try_out(&args.report.out)?;
    let opened = OpenInstrument::open(&args.instrument, answer)?;
    opened.check_nothing_waits()?;
    let known = match args.calibrate {
        true => Vec::new(),
        false => known_calibrations(&opened, answer),
    };
    let input = RepositionInput {
        target_id: kept.id.clone(),
        options,
        foreign_um_per_px: foreign_um_per_px.or_else(|| opened.other_mode_um_per_px(&kept, &known)),
        known,
        switchings: opened.switchings.clone(),
        parcentric: opened.parcentric.clone(),
    };
    let asked = Asked {
        inputs: json!({"name": args.name, "options": input.options}),
        target: Some([args.name.clone(), kept.id]),
        ..Asked::default()
    };
    let job = RepositionJob::new(kept.target, input);
    run(&opened, &args.name, job, asked, &args.report.out, answer)
}

/// Runs the job, from its beginning or from where it was.
pub(super) fn run(
    opened: &OpenInstrument,
    name: &str,
    job: RepositionJob,
    asked: Asked,
    out: &Path,
    answer: &Answer,
) -> Result<bool, CliError> {
    let started = Instant::now();
    let options: ServoOptions =
        serde_json::from_value(asked.inputs["options"]["servo"].clone()).unwrap_or_default();
    let mut watcher = Watcher::new(None);
    if let Some(picture) = opened.library.target_picture(name) {
        watcher.frame(&picture, FrameRole::Target);
    }
    let ran = opened.run(job, asked, &mut watcher, answer)?;
    let seconds = started.elapsed().as_secs_f64();
    if let Ok(output) = &ran.output {
        show(opened, name, output, seconds, answer);
    }
    keep(
        opened,
        name,
        ran,
        &watcher,
        (&options, seconds),
        out,
        answer,
    )
}

fn show(
    opened: &OpenInstrument,
    name: &str,
    output: &RepositionOutput,
    seconds: f64,
    answer: &Answer,
) {
    let RepositionOutput {
        outcome, counters, ..
    } = output;
    answer.put(json!({
        "verdict": outcome.verdict,
        "reason": outcome.reason,
        "message": outcome.message,
        "target": name,
        "estimated_error_um": outcome.estimated_error_um,
        "estimated_error_deg": outcome.estimated_error_deg,
        "limited_by": outcome.limited_by,
        "angle_left_deg": outcome.angle_left_deg,
        "in_view": outcome.in_view,
        "missing": outcome.missing.as_ref().map(output::missing),
        "remarks": outcome.remarks,
        "unique_within_um": outcome.unique_within_um,
        "moves": counters.moves,
        "frames": counters.frames,
        "objective_changes": counters.objective_changes,
        "seconds": seconds,
        "magnifications": output::magnifications(outcome),
    }));
    show_outcome(answer, outcome);
    // The verdict stands, whether or not the stage still answers.
    let z = opened.scope.gate().position().ok();
    let z = z.and_then(|at| at.si(Axis::Z));
    say!(
        answer,
        "  {} moves, {} images, {seconds:.1} s{}",
        counters.moves,
        counters.frames,
        z.map_or(String::new(), |z| format!(", z = {:.1} um", z * 1e6))
    );
}

/// The report, in the folder of the run and as the last one's copy.
fn keep(
    opened: &OpenInstrument,
    name: &str,
    mut ran: Ran<RepositionOutput>,
    watcher: &Watcher,
    (servo, seconds): (&ServoOptions, f64),
    out: &Path,
    answer: &Answer,
) -> Result<bool, CliError> {
    let Ok(output) = &ran.output else {
        return ran.end(None, answer).map(|_| false);
    };
    if output.outcome.verdict == Verdict::Arrived {
        ran.arrived(watcher.recorder.last_seen(), answer);
    }
    let target = opened.library.target(name).map_or_else(
        |_| name.into(),
        |kept| format!("{name}, saved {} on {}", kept.saved, kept.instrument),
    );
    let context = report::Context {
        title: format!("Back to {name}"),
        target,
        wall_time_s: Some(seconds),
        convergence: Some(report::Convergence {
            position_px: servo.position_px,
            angle_deg: servo.angle_deg,
        }),
        ..context(opened)
    };
    let page = report::html(&watcher.recorder, None, &context);
    keep_report(out, &page, None, answer);
    let output = ran.end(Some(&page), answer)?;
    Ok(output.outcome.verdict == Verdict::Arrived)
}

/// The size of a pixel of a target that another microscope took; what is not known of it cannot be guessed.
fn foreign_scale(
    name: &str,
    kept: &KeptTarget,
    config: &Config,
    answer: &Answer,
) -> Result<f64, CliError> {
    let Some(taken) = &kept.target.taken else {
        return Err(CliError::Usage(format!(
            "the target '{name}' was saved on '{}', and this is '{}': its image has another scale and other axes, and an earlier version \
             did not keep which. Save it anew here",
            kept.instrument, config.name
        )));
    };
    if taken.calibration.is_none() {
        let what = format!(
            "the target '{name}' was saved on '{}' with an objective that was not calibrated: its scale is the engraved one",
            kept.instrument
        );
        answer.warn(Code::ForeignTarget, what);
    }
    Ok(taken.um_per_px)
}

fn show_outcome(answer: &Answer, outcome: &Outcome) {
    let verdict = colour::verdict(output::word(outcome.verdict), outcome.verdict.into());
    say!(answer, "{verdict}: {}", outcome.message);
    // A calibration that is off looks like a specimen that is.
    let astray = [
        Reason::TargetNotInView,
        Reason::IterationLimit,
        Reason::Diverged,
    ];
    if astray.contains(&outcome.reason) {
        say!(
            answer,
            "  `scopeservo check` over tissue tells whether a calibration is off"
        );
    }
    for m in output::magnifications(outcome) {
        match (m.iterations, m.inliers, m.error_um, m.error_deg) {
            (Some(n), Some(inliers), Some(um), Some(deg)) => say!(
                answer,
                "  {:>4}  {n:>2} iterations  {inliers:>4} inliers  {um:7.3} um  {:>8} deg",
                m.objective,
                output::signed(deg, 4)
            ),
            _ => say!(answer, "  {:>4}  {}", m.objective, m.end.replace('_', " ")),
        }
    }
    if let (Verdict::Arrived, Some([w, h])) = (outcome.verdict, outcome.unique_within_um) {
        say!(
            answer,
            "  unique only within {w:.0} x {h:.0} um: what looks the same farther away was not in view"
        );
    }
}
