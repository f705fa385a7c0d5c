//! `focus`, `calibrate`, `target` and `reposition` on the user's instrument.

use crate::args::{CalibrateArgs, FocusArgs, RepositionArgs, TargetListArgs, TargetSaveArgs};
use crate::demo::check_servo;
use crate::desk::Desk;
use crate::error::CliError;
use crate::output::{self, SCHEMA, calibration as calibration_json};
use crate::progress::Watcher;
use crate::store::Store;
use crate::views::write_json;
use scopeservo_report as report;
use scopeservo_scope::{Axis, Frame, Length, Objective, StagePose};
use scopeservo_servo::{
    Bring, Calibrate, CalibrateOptions, Calibration, Event, FocusOptions, FocusResult, FrameRole,
    Outcome, Reposition, RepositionOptions, ServoOptions, Sink, Stamped, Target, Verdict,
    VisionOptions,
};
use scopeservo_setup::Config;
use serde_json::json;
use std::fs;
use std::time::Instant;

/// Brings an objective into the beam, into focus where that is wanted, and shows which it is where only somebody's word tells.
fn bring(
    desk: &Desk,
    objective: &Objective,
    focus: Option<FocusOptions>,
    sink: &mut dyn Sink,
) -> Result<Option<FocusResult>, CliError> {
    let mut bring = Bring::new(objective.id.clone(), focus, VisionOptions::default());
    Ok(scopeservo_servo::run(&mut bring, &desk.scope, sink)?)
}

fn show_focus(objective: &Objective, result: &FocusResult) {
    match result.z_um {
        Some(z) => say!(
            "{} is in focus at z = {z:.2} um (sharpness {:.4}, {:.1} times the least seen, {} pictures)",
            objective.id,
            result.sharpness,
            result.contrast,
            result.samples
        ),
        None => say!("{}: this stage has no z axis; focus by hand", objective.id),
    }
}

pub(crate) fn focus(args: &FocusArgs) -> Result<bool, CliError> {
    let range_um = args.range_um.unwrap_or(40.0);
    if !(range_um > 0.0 && range_um <= 2000.0) {
        return Err(CliError::Usage(
            "--range-um must be above 0 and at most 2000".into(),
        ));
    }
    if args.near_z_um.is_some_and(|z| !z.is_finite()) {
        return Err(CliError::Usage("--near-z-um must be a number".into()));
    }
    let desk = Desk::open(&args.instrument)?;
    let objective = desk.objective(args.objective.as_deref())?;
    let mut watcher = Watcher::new(None);
    if let Some(um) = args.near_z_um {
        // With the objective in that is to be focused, not with another.
        desk.scope.select_objective(&objective.id)?;
        let to = StagePose::default().with_si(Axis::Z, um * 1e-6);
        desk.scope.move_to(&to)?;
    }
    let default = FocusOptions::default();
    let options = FocusOptions {
        half_range_um: range_um,
        nearest_um: args.range_um.unwrap_or(default.nearest_um),
        ..default
    };
    let result = bring(&desk, &objective, Some(options), &mut watcher);
    watcher.finish();
    let Some(result) = result? else {
        return Err(CliError::Internal("nothing was focused".into()));
    };
    match args.json {
        true => output::print(&json!({
            "schema": SCHEMA,
            "objective": objective.id,
            "z_um": result.z_um,
            "sharpness": result.sharpness,
            "contrast": result.contrast,
            "samples": result.samples,
        }))?,
        false => show_focus(&objective, &result),
    }
    Ok(true)
}

/// The residual of the last calibration that the watcher heard of.
fn residual_px(watcher: &Watcher) -> Option<f64> {
    let mut events = watcher.recorder.events().iter().rev();
    events.find_map(|e| match e.event {
        Event::Calibrated { residual_px, .. } => Some(residual_px),
        _ => None,
    })
}

pub(crate) fn calibrate(args: &CalibrateArgs) -> Result<bool, CliError> {
    let desk = Desk::open(&args.instrument)?;
    let mut wanted: Vec<Objective> = match args.objective.is_empty() {
        true => desk.scope.gate().objectives().to_vec(),
        false => {
            let of = |name: &String| {
                let id = scopeservo_scope::ObjectiveId(name.clone());
                Ok(desk.scope.objective(&id)?.clone())
            };
            args.objective
                .iter()
                .map(of)
                .collect::<Result<_, CliError>>()?
        }
    };
    wanted.sort_by(|a, b| a.magnification.total_cmp(&b.magnification));
    let mut answers = Vec::new();
    for objective in wanted {
        let mut watcher = Watcher::new(None);
        let made = calibrate_one(&desk, &objective, args.no_focus, &mut watcher);
        watcher.finish();
        let calibration = made?;
        let z = desk.scope.focus_heights().get(&objective.id).copied();
        let residual = residual_px(&watcher);
        let file = desk
            .store
            .keep_calibration(&desk.config.name, &calibration, z, residual)?;
        if args.json {
            answers.push(json!({
                "objective": objective.id,
                "file": file,
                "focus_z_um": z.map(Length::um),
                "residual_px": residual,
                "calibration": calibration_json(&calibration),
            }));
        } else {
            show_calibration(&calibration, residual);
            say!("  kept in {}", file.display());
        }
    }
    if args.json {
        output::print(&json!({"schema": SCHEMA, "calibrations": answers}))?;
    }
    Ok(true)
}

fn calibrate_one(
    desk: &Desk,
    objective: &Objective,
    no_focus: bool,
    watcher: &mut Watcher,
) -> Result<Calibration, CliError> {
    bring(
        desk,
        objective,
        (!no_focus).then(FocusOptions::default),
        watcher,
    )?;
    let mut calibrate = Calibrate::new(
        objective.clone(),
        CalibrateOptions::default(),
        VisionOptions::default(),
    );
    Ok(scopeservo_servo::run(&mut calibrate, &desk.scope, watcher)?)
}

fn show_calibration(calibration: &Calibration, residual_px: Option<f64>) {
    let sigma = calibration.covariance.map(|c| {
        // The relative standard deviation of the first column's length, to first order along x.
        let [[a, _], [b, _]] = calibration.stage_from_pixel.0;
        let length_sq = a * a + b * b;
        let gradient = [a / length_sq, 0.0, b / length_sq, 0.0];
        let mut variance = 0.0;
        for i in 0..4 {
            for j in 0..4 {
                variance += gradient[i] * c[i][j] * gradient[j];
            }
        }
        100.0 * variance.max(0.0).sqrt()
    });
    say!(
        "{}: {:.4} um per pixel{}{}",
        calibration.objective,
        calibration.um_per_px(),
        sigma.map_or(String::new(), |s| format!(" (+-{s:.2} %)")),
        residual_px.map_or(String::new(), |r| format!(", views fit to {r:.2} px"))
    );
    if let Some(r) = calibration.reading() {
        say!(
            "  kx {:.0}, ky {:.0} pixels per metre, camera turned {:.3} deg against the stage",
            r.kx_px_per_m,
            r.ky_px_per_m,
            r.phi_rad.to_degrees()
        );
    } else {
        say!("  the picture is mirrored against the stage");
    }
    match calibration.rotation_centre_m {
        Some(eta) => say!(
            "  the view lies {:.3}, {:.3} mm from the axis of rotation",
            eta[0] * 1e3,
            eta[1] * 1e3
        ),
        None => say!("  the stage does not turn"),
    }
}

/// Keeps the last frame, for its picture.
struct LastFrame<'a> {
    watcher: &'a mut Watcher,
    frame: Option<Frame>,
}

impl Sink for LastFrame<'_> {
    fn event(&mut self, event: Stamped) {
        self.watcher.event(event);
    }
    fn frame(&mut self, frame: &Frame, role: FrameRole) {
        self.frame = Some(frame.clone());
        self.watcher.frame(frame, role);
    }
}

pub(crate) fn save_target(args: &TargetSaveArgs) -> Result<bool, CliError> {
    let config = Config::read(&args.instrument.description.config)?;
    Store::new(config.resolve(&config.data_folder)).check_new_target(&args.name)?;
    let desk = Desk::open(&args.instrument)?;
    let objective = desk.objective(args.objective.as_deref())?;
    let mut watcher = Watcher::new(None);
    let mut sink = LastFrame {
        watcher: &mut watcher,
        frame: None,
    };
    let saved = (|| -> Result<(Target, StagePose), CliError> {
        let focus = args.focus.then(FocusOptions::default);
        bring(&desk, &objective, focus, &mut sink)?;
        let target = Target::save(&desk.scope, &VisionOptions::default(), &mut sink)?;
        Ok((target, desk.scope.gate().position()?))
    })();
    let frame = sink.frame.take();
    watcher.finish();
    let (target, stage) = saved?;
    let features = target.features.len();
    if features < MIN_FEATURES {
        return Err(CliError::Usage(format!(
            "this view has {features} features and could not be recognised: {MIN_FEATURES} are needed. Focus, or choose a place with \
             more tissue; nothing was saved"
        )));
    }
    let frame = frame.ok_or_else(|| CliError::Internal("the target has no picture".into()))?;
    let name = &args.name;
    let file = desk
        .store
        .keep_target(name, &desk.config.name, stage, target, &frame)?;
    match args.json {
        true => output::print(&json!({
            "schema": SCHEMA,
            "name": name,
            "file": file,
            "objective": objective.id,
            "features": features,
        }))?,
        false => {
            say!("saved '{name}' at {}: {features} features", objective.id);
            say!("  {} and its picture beside it", file.display());
            say!("  come back with: scopeservo reposition {name}");
        }
    }
    Ok(true)
}

/// Fewer, and a run would refuse the target.
const MIN_FEATURES: usize = 30;

pub(crate) fn list_targets(args: &TargetListArgs) -> Result<bool, CliError> {
    let config = Config::read(&args.description.config)?;
    let store = Store::new(config.resolve(&config.data_folder));
    let mut rows = Vec::new();
    for name in store.target_names()? {
        let kept = store.target(&name)?;
        match args.json {
            true => rows.push(json!({
                "name": name,
                "saved": kept.saved,
                "instrument": kept.instrument,
                "objective": kept.target.objective,
                "features": kept.target.features.len(),
            })),
            false => say!(
                "{name:24} {:8} {:5} features  {}  {}",
                kept.target.objective.0,
                kept.target.features.len(),
                kept.saved,
                kept.instrument
            ),
        }
    }
    if args.json {
        output::print(&json!({"schema": SCHEMA, "targets": rows}))?;
    } else if store.target_names()?.is_empty() {
        say!("no target is saved yet: scopeservo target save NAME");
    }
    Ok(true)
}

pub(crate) fn reposition(args: &RepositionArgs) -> Result<bool, CliError> {
    let started = Instant::now();
    check_servo(args.lambda, args.max_iterations)?;
    // What can be wrong without the instrument is found before it is touched.
    let config = Config::read(&args.instrument.description.config)?;
    let kept = Store::new(config.resolve(&config.data_folder)).target(&args.name)?;
    if kept.instrument != config.name {
        return Err(CliError::Usage(format!(
            "the target '{}' was saved on '{}', and this is '{}': its picture has another scale and other axes",
            args.name, kept.instrument, config.name
        )));
    }
    fs::create_dir_all(&args.out).map_err(|source| CliError::Write {
        path: args.out.clone(),
        source,
    })?;
    let desk = Desk::open(&args.instrument)?;
    let servo = ServoOptions {
        lambda: args.lambda,
        max_iterations: args.max_iterations,
        ..ServoOptions::default()
    };
    let options = RepositionOptions {
        servo: servo.clone(),
        ..RepositionOptions::default()
    };
    let info = desk.scope.camera().info();
    let size = [info.width, info.height];
    let known = match args.calibrate {
        true => Vec::new(),
        false => desk
            .store
            .calibrations()?
            .into_iter()
            // Of another instrument or camera, or another mode of it, it is of no use.
            .filter(|(_, kept)| {
                kept.calibration.image_size_px == size && kept.instrument == desk.config.name
            })
            .map(|(id, kept)| (id, kept.calibration))
            .collect(),
    };
    let mut run = Reposition::new(kept.target, options).with_calibrations(known);
    let mut watcher = Watcher::new(None);
    if let Some(picture) = desk.store.target_picture(&args.name) {
        watcher.frame(&picture, FrameRole::Target);
    }
    let before = desk.scope.counters();
    let outcome = scopeservo_servo::run(&mut run, &desk.scope, &mut watcher);
    watcher.finish();
    let outcome = outcome?;
    desk.scope.check_cancel()?;
    let counters = desk.scope.counters();
    let answer = json!({
        "schema": SCHEMA,
        "verdict": outcome.verdict,
        "reason": outcome.reason,
        "message": outcome.message,
        "target": args.name,
        "estimated_error_um": outcome.estimated_error_um,
        "estimated_error_deg": outcome.estimated_error_deg,
        "moves": counters.moves - before.moves,
        "frames": counters.frames - before.frames,
        "objective_changes": counters.objective_changes - before.objective_changes,
        "seconds": started.elapsed().as_secs_f64(),
        "magnifications": output::magnifications(&outcome),
    });
    let context = report::Context {
        title: format!("Back to {}", args.name),
        instrument: desk.config.name.clone(),
        command: output::command_line(),
        version: env!("CARGO_PKG_VERSION").into(),
        wall_time_s: Some(started.elapsed().as_secs_f64()),
        convergence: Some(report::Convergence {
            position_px: servo.position_px,
            angle_deg: servo.angle_deg,
        }),
        ..report::Context::default()
    };
    let path = args.out.join("report.html");
    write_json(&args.out.join("result.json"), &answer)?;
    report::write(&path, &report::html(&watcher.recorder, None, &context)).map_err(|source| {
        CliError::Write {
            path: path.clone(),
            source,
        }
    })?;
    match args.json {
        true => output::print(&answer)?,
        false => {
            show_outcome(&outcome);
            let z = desk.scope.gate().position()?.si(Axis::Z);
            say!(
                "  {} moves, {} pictures, {:.1} s{}",
                counters.moves - before.moves,
                counters.frames - before.frames,
                started.elapsed().as_secs_f64(),
                z.map_or(String::new(), |z| format!(", z = {:.1} um", z * 1e6))
            );
            say!("  report: {}", path.display());
        }
    }
    Ok(outcome.verdict == Verdict::Arrived)
}

fn show_outcome(outcome: &Outcome) {
    let verdict = output::word(outcome.verdict);
    say!("{verdict}: {}", outcome.message);
    for m in output::magnifications(outcome) {
        match (m.iterations, m.inliers, m.error_um, m.error_deg) {
            (Some(n), Some(inliers), Some(um), Some(deg)) => say!(
                "  {:>4}  {n:>2} iterations  {inliers:>4} inliers  {um:7.3} um  {deg:8.4} deg",
                m.objective
            ),
            _ => say!("  {:>4}  the target was not seen", m.objective),
        }
    }
}
