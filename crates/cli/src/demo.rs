//! `scopeservo demo`: a reposition on a simulated microscope, from saving the view to the report.

use crate::answer::Answer;
use crate::args::{DemoArgs, Noise};
use crate::bench::{Bench, displace, save_target};
use crate::colour;
use crate::console::hand_on;
use crate::error::CliError;
use crate::output::{self, DemoJson};
use crate::progress::Watcher;
use crate::threads::take_threads;
use crate::views::{ViewWriter, clear_earlier_run, keep_json, keep_report, try_out};
use scopeservo_features::Engine;
use scopeservo_report as report;
use scopeservo_scope::{Instrument, ObjectiveId, deg_in_words, um_in_words};
use scopeservo_servo::{
    Event, Outcome, Reason, RepositionOptions, ServoError, ServoOptions, Sink, Stamped, Verdict,
};
use scopeservo_station::jobs::{RepositionInput, RepositionJob};
use scopeservo_twin::Truth;
use serde_json::json;
use std::path::PathBuf;
use std::time::{Duration, Instant};

const DEFAULT_OUT: &str = "scopeservo-demo";
/// Scales that an image from a microscope can have.
const UM_PER_PX: std::ops::RangeInclusive<f64> = 1e-3..=1e3;
const MAX_SHIFT_UM: f64 = 1e5;
const MAX_TURN_DEG: f64 = 360.0;

pub(crate) fn run(args: &DemoArgs, answer: &Answer) -> Result<bool, CliError> {
    check(args)?;
    take_threads(args.threads)?;
    demo(args, answer)
}

fn check(args: &DemoArgs) -> Result<(), CliError> {
    let usage = |text: &str| Err(CliError::Usage(text.into()));
    args.moving.options()?;
    if args
        .start_deg
        .is_some_and(|d| !(-MAX_TURN_DEG..=MAX_TURN_DEG).contains(&d))
    {
        return usage("--start-deg must be a number of degrees, from -360 to 360");
    }
    if args
        .start_um
        .is_some_and(|s| s.iter().any(|v| v.abs() > MAX_SHIFT_UM))
    {
        return usage("--start-um must be within 100000 um: no slide is larger");
    }
    if args.um_per_px.is_some_and(|u| !UM_PER_PX.contains(&u)) {
        return usage(
            "--um-per-px must be a number above 0, from 0.001 to 1000, like 0.5 for a slide scanned at 20x",
        );
    }
    Ok(())
}

/// The settings of the run.
fn run_options(args: &DemoArgs) -> Result<RepositionOptions, CliError> {
    Ok(RepositionOptions {
        servo: args.moving.options()?,
        ..RepositionOptions::default()
    })
}

fn demo(args: &DemoArgs, answer: &Answer) -> Result<bool, CliError> {
    let started = Instant::now();
    let bench = Bench::new(args, answer)?;
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| PathBuf::from(DEFAULT_OUT));
    try_out(&out)?;
    // Without views the report and the result replace those of an earlier run at the end, whole; until then they stay.
    let views = match &args.out {
        Some(out) => {
            clear_earlier_run(out)?;
            Some(ViewWriter::new(out, bench.twin.clone())?)
        }
        None => None,
    };
    let mut watcher = Watcher::new(views);
    let ran = drive(&bench, run_options(args)?, &mut watcher);
    watcher.finish();
    let ran = ran?;
    bench.scope.check_cancel()?;
    let result = result(args, &bench, &ran, &watcher);
    answer.put(json!(result));
    show(answer, &result, started);
    let Watcher {
        recorder, views, ..
    } = watcher;
    if let Some(views) = views {
        answer.or_warn(views.finish(&out));
        answer.or_warn(keep_json(&out.join("events.json"), &recorder.events()));
    }
    let target = ran.target.as_ref();
    let page = page(args, &bench, &recorder, &result, target, started);
    keep_report(&out, &page, None, answer);
    Ok(ran.outcome.verdict == Verdict::Arrived)
}

/// What became of it.
struct Ran {
    outcome: Outcome,
    /// The target's hidden pose, when there was something to save.
    target: Option<Truth>,
    /// What the instrument did from the displacing of the slide on.
    moves: u64,
    frames: u64,
    time: Duration,
}

/// Saves the view, puts the slide back elsewhere, and brings the view back.
fn drive(
    bench: &Bench,
    options: RepositionOptions,
    watcher: &mut Watcher,
) -> Result<Ran, CliError> {
    let scope = &bench.scope;
    let saved = save_target(bench, &options.vision, watcher)?;
    // The slide is taken out and put back: the view now lies start_um from the target, the slide turned about it.
    let (before, time_before) = (scope.counters(), scope.clock().now());
    let (outcome, target) = match saved {
        Ok((target, truth)) => {
            displace(bench);
            let input = RepositionInput {
                target_id: "demo".into(),
                options,
                ..RepositionInput::default()
            };
            let job = RepositionJob::new(target, input);
            let output = bench
                .console
                .follow(job, |told| hand_on(&told, watcher))??;
            (output.outcome, Some(truth))
        }
        Err(error) => (nothing_to_save(&error, scope, watcher), None),
    };
    let after = scope.counters();
    Ok(Ran {
        outcome,
        target,
        moves: after.moves - before.moves,
        frames: after.frames - before.frames,
        time: scope.clock().now().since(time_before),
    })
}

fn result(args: &DemoArgs, bench: &Bench, ran: &Ran, watcher: &Watcher) -> DemoJson {
    let outcome = &ran.outcome;
    // The truth is that of the last frame: nothing moved after it, and whoever keeps the views can recompute it.
    let last = watcher.last_frame();
    let last = last.and_then(|sequence| bench.twin.truth(sequence));
    let pair = ran.target.as_ref().zip(last);
    let arrival = pair.map(|(target, last)| arrival_error(target, &last));
    let engine = Engine::default().info();
    DemoJson {
        verdict: outcome.verdict,
        reason: outcome.reason,
        message: outcome.message.clone(),
        estimated_error_um: outcome.estimated_error_um,
        estimated_error_deg: outcome.estimated_error_deg,
        limited_by: outcome.limited_by,
        angle_left_deg: outcome.angle_left_deg,
        in_view: outcome.in_view,
        missing: outcome.missing.as_ref().map(output::missing),
        true_error_um: arrival.map(|a| f64::hypot(a.0[0], a.0[1])),
        true_error_deg: arrival.map(|a| a.1.abs()),
        virtual_time_s: ran.time.as_secs_f64(),
        moves: ran.moves,
        frames: ran.frames,
        magnifications: output::magnifications(outcome),
        noise: match args.noise {
            Noise::Default => "default",
            Noise::None => "none",
        },
        method: args.moving.method().word(),
        lambda: args.moving.lambda(),
        seed: args.seed,
        specimen: specimen_name(args, bench),
        start_um: bench.scene.start_um,
        start_deg: bench.scene.turn_deg,
        engine: engine.name,
        cpu_level: engine.cpu_level,
    }
}

fn nothing_to_save(error: &ServoError, scope: &Instrument, watcher: &mut Watcher) -> Outcome {
    let outcome = Outcome {
        verdict: Verdict::Refused,
        reason: Reason::of(error).unwrap_or(Reason::NoFocus),
        message: format!("there was nothing to save as a target: {error}"),
        estimated_error_um: None,
        estimated_error_deg: None,
        limited_by: None,
        angle_left_deg: None,
        in_view: None,
        missing: None,
        remarks: Vec::new(),
        unique_within_um: None,
        magnifications: Vec::new(),
    };
    watcher.event(Stamped {
        time_s: scope.clock().now().seconds(),
        event: Event::Finished {
            outcome: outcome.clone(),
        },
    });
    outcome
}

/// Where the view's centre lies from the target's on the specimen (um), and the angle (deg).
fn arrival_error(target: &Truth, view: &Truth) -> ([f64; 2], f64) {
    let turn = view.angle_deg - target.angle_deg;
    (
        [
            view.centre_um[0] - target.centre_um[0],
            view.centre_um[1] - target.centre_um[1],
        ],
        (turn + 180.0).rem_euclid(360.0) - 180.0,
    )
}

/// A displacement on the specimen, along the target image's columns and rows.
fn along_picture(target: &Truth, offset_um: [f64; 2]) -> [f64; 2] {
    let m = target.specimen_from_pixel;
    [0, 1].map(|k| (m[0][k] * offset_um[0] + m[1][k] * offset_um[1]) / f64::hypot(m[0][k], m[1][k]))
}

fn specimen_name(args: &DemoArgs, bench: &Bench) -> String {
    match &args.specimen {
        Some(path) => path.file_name().map_or_else(
            || bench.specimen.describe(),
            |n| n.to_string_lossy().into_owned(),
        ),
        None => bench.specimen.describe(),
    }
}

/// The page of a run.
fn page(
    args: &DemoArgs,
    bench: &Bench,
    recorder: &report::Recorder,
    result: &DemoJson,
    target: Option<&Truth>,
    started: Instant,
) -> String {
    let truth = target.map(|target| hidden_truth(bench, recorder, target, result));
    let servo = ServoOptions::default();
    let context = report::Context {
        title: format!("Reposition on {}", result.specimen),
        specimen: bench.specimen.describe(),
        instrument: "hexapod, 10x / 20x / 40x, 640x480 camera".into(),
        simulated: true,
        command: output::command_line(),
        seed: Some(args.seed),
        version: env!("CARGO_PKG_VERSION").into(),
        virtual_time: true,
        wall_time_s: Some(started.elapsed().as_secs_f64()),
        date: output::date(),
        convergence: Some(report::Convergence {
            position_px: servo.position_px,
            angle_deg: servo.angle_deg,
        }),
        ..report::Context::default()
    };
    report::html(recorder, truth.as_ref(), &context)
}

/// What the report shows beside the claims.
fn hidden_truth(
    bench: &Bench,
    recorder: &report::Recorder,
    target: &Truth,
    result: &DemoJson,
) -> report::Truth {
    let iterations = recorder
        .events()
        .iter()
        .filter_map(|e| match &e.event {
            Event::Iteration { sequence, .. } => {
                let (offset_um, turn) = arrival_error(target, &bench.twin.truth(*sequence)?);
                let [x_um, y_um] = along_picture(target, offset_um);
                Some(report::TrueIteration {
                    sequence: *sequence,
                    error_um: f64::hypot(x_um, y_um),
                    error_deg: turn,
                    x_um,
                    y_um,
                })
            }
            _ => None,
        })
        .collect();
    let calibrations = bench
        .scope
        .gate()
        .objectives()
        .iter()
        .filter_map(|o| {
            let t = bench.twin.true_calibration(&ObjectiveId(o.id.0.clone()))?;
            Some(report::TrueCalibration {
                objective: o.id.0.clone(),
                kx_px_per_m: t.kx,
                ky_px_per_m: t.ky,
                phi_deg: t.phi_deg,
                eta_mm: t.eta_mm,
            })
        })
        .collect();
    report::Truth {
        error_um: result.true_error_um.unwrap_or(0.0),
        error_deg: result.true_error_deg.unwrap_or(0.0),
        iterations,
        calibrations,
    }
}

fn show(answer: &Answer, result: &DemoJson, started: Instant) {
    let verdict = colour::verdict(output::word(result.verdict), result.verdict.into());
    say!(answer, "{verdict}: {}", result.message);
    say!(
        answer,
        "  slide put back {:.0} um away and turned {:.2} deg, on {}",
        f64::hypot(result.start_um[0], result.start_um[1]),
        result.start_deg,
        result.specimen
    );
    for m in &result.magnifications {
        match (m.iterations, m.inliers, m.error_um, m.error_deg) {
            (Some(n), Some(inliers), Some(um), Some(deg)) => say!(
                answer,
                "  {:>4}x  {n:>2} iterations  {inliers:>4} inliers  {um:7.3} um  {:>8} deg  {:.4} um/px",
                m.magnification,
                output::signed(deg, 4),
                m.calibration.um_per_px
            ),
            _ => say!(answer, "  {:>4}x  the target was not seen", m.magnification),
        }
    }
    if let (Some(um), Some(deg)) = (result.true_error_um, result.true_error_deg) {
        say!(
            answer,
            "  true error {}, {} (only the simulation knows)",
            um_in_words(um, 3),
            deg_in_words(deg, 4)
        );
    }
    say!(
        answer,
        "  {} moves, {} frames, {:.1} s of instrument time, {:.1} s here",
        result.moves,
        result.frames,
        result.virtual_time_s,
        started.elapsed().as_secs_f64()
    );
}
