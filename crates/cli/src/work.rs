//! `focus`, `calibrate`, `target` and `reposition` on the user's instrument.

use crate::answer::Answer;
use crate::args::{CalibrateArgs, ConfigArgs, FocusArgs, RepositionArgs, TargetSaveArgs};
use crate::demo::check_servo;
use crate::desk::Desk;
use crate::error::{CliError, Code};
use crate::output::{self, calibration as calibration_json};
use crate::progress::Watcher;
use crate::views::{keep_report, try_out};
use scopeservo_library::{Calibrations as _, Cameras as _, Folder, KeptTarget, Targets as _};
use scopeservo_report as report;
use scopeservo_scope::{Axis, Frame, Length, Objective, ObjectiveId, StagePose};
use scopeservo_servo::{
    Bring, Calibrate, CalibrateOptions, Calibration, Event, FocusOptions, FocusResult, FrameRole,
    Outcome, Reposition, RepositionOptions, SaveOptions, SaveTarget, ServoOptions, Sink, Stamped,
    Target, Verdict, VisionOptions,
};
use scopeservo_setup::Config;
use serde_json::json;
use std::path::Path;
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

fn show_focus(answer: &Answer, objective: &Objective, result: &FocusResult) {
    match result.z_um {
        Some(z) => say!(
            answer,
            "{} is in focus at z = {z:.2} um (sharpness {:.4}, {:.1} times the least seen, {} pictures)",
            objective.id,
            result.sharpness,
            result.contrast,
            result.samples
        ),
        None => say!(
            answer,
            "{}: this stage has no z axis; focus by hand",
            objective.id
        ),
    }
}

pub(crate) fn focus(args: &FocusArgs, answer: &Answer) -> Result<bool, CliError> {
    let range_um = args.range_um.unwrap_or(40.0);
    if !(range_um > 0.0 && range_um <= 2000.0) {
        return Err(CliError::Usage(
            "--range-um must be above 0 and at most 2000".into(),
        ));
    }
    if args.near_z_um.is_some_and(|z| !z.is_finite()) {
        return Err(CliError::Usage("--near-z-um must be a number".into()));
    }
    let desk = Desk::open(&args.instrument, answer)?;
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
    answer.put(json!({
        "objective": objective.id,
        "z_um": result.z_um,
        "sharpness": result.sharpness,
        "contrast": result.contrast,
        "samples": result.samples,
    }));
    show_focus(answer, &objective, &result);
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

pub(crate) fn calibrate(args: &CalibrateArgs, answer: &Answer) -> Result<bool, CliError> {
    // Before anything moves, and before it is opened.
    library_of(&args.instrument.description)?.try_calibrations(&[])?;
    let desk = Desk::open(&args.instrument, answer)?;
    let mut wanted: Vec<Objective> = match args.objective.is_empty() {
        true => desk.scope.gate().objectives().to_vec(),
        false => {
            let of = |name: &String| {
                let id = ObjectiveId(name.clone());
                Ok(desk.scope.objective(&id)?.clone())
            };
            args.objective
                .iter()
                .map(of)
                .collect::<Result<_, CliError>>()?
        }
    };
    wanted.sort_by(|a, b| a.magnification.total_cmp(&b.magnification));
    desk.library.try_calibrations(&wanted)?;
    answer.put(json!({"calibrations": []}));
    for objective in wanted {
        let mut watcher = Watcher::new(None);
        let made = calibrate_one(&desk, &objective, args.no_focus, &mut watcher);
        watcher.finish();
        let calibration = made?;
        let z = desk.scope.focus_heights().get(&objective.id).copied();
        let residual = residual_px(&watcher);
        show_calibration(answer, &calibration, residual);
        let library = &desk.library;
        let file = library.keep_calibration(&desk.config.name, &calibration, z, residual);
        let file = answer.or_warn(file);
        if let Some(file) = &file {
            say!(answer, "  kept in {}", file.display());
        }
        let entry = json!({
            "objective": objective.id,
            "file": file.as_deref().map(Path::to_string_lossy),
            "focus_z_um": z.map(Length::um),
            "residual_px": residual,
            "calibration": calibration_json(&calibration),
        });
        answer.push("calibrations", entry);
    }
    Ok(true)
}

/// Where the instrument's calibrations and targets are kept.
pub(crate) fn library_of(description: &ConfigArgs) -> Result<Folder, CliError> {
    let config = Config::read(&description.config)?;
    Ok(Folder::new(config.resolve(&config.data_folder)))
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

fn show_calibration(answer: &Answer, calibration: &Calibration, residual_px: Option<f64>) {
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
        answer,
        "{}: {:.4} um per pixel{}{}",
        calibration.objective,
        calibration.um_per_px(),
        sigma.map_or(String::new(), |s| format!(" (+-{s:.2} %)")),
        residual_px.map_or(String::new(), |r| format!(", views fit to {r:.2} px"))
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
        say!(answer, "  the picture is mirrored against the stage");
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
        if role == FrameRole::Target {
            self.frame = Some(frame.clone());
        }
        self.watcher.frame(frame, role);
    }
}

pub(crate) fn save_target(args: &TargetSaveArgs, answer: &Answer) -> Result<bool, CliError> {
    library_of(&args.instrument.description)?.check_new_target(&args.name)?;
    let desk = Desk::open(&args.instrument, answer)?;
    let objective = desk.objective(args.objective.as_deref())?;
    let mut watcher = Watcher::new(None);
    let mut sink = LastFrame {
        watcher: &mut watcher,
        frame: None,
    };
    let before = desk.scope.flat_field();
    let saved = (|| -> Result<(Target, StagePose), CliError> {
        let focus = args.focus.then(FocusOptions::default);
        bring(&desk, &objective, focus, &mut sink)?;
        let stage = desk.scope.gate().position()?;
        // A pixel's size as it was measured, else as it is engraved.
        let known = desk.library.calibration(&objective).ok().flatten();
        let mut save = SaveTarget::new(SaveOptions {
            still: args.still || desk.config.target.still,
            calibration: known.map(|kept| kept.calibration),
            ..SaveOptions::default()
        });
        let target = scopeservo_servo::run(&mut save, &desk.scope, &mut sink)?;
        Ok((target, stage))
    })();
    let frame = sink.frame.take();
    watcher.finish();
    let seen = desk.scope.flat_field();
    let shadows = seen.filter(|now| Some(now) != before.as_ref());
    if let Some(shadows) = &shadows {
        answer.or_warn(desk.library.keep_shadows(&desk.config.name, shadows));
    }
    let (target, stage) = saved?;
    let (features, moved) = (target.features.len(), target.moved);
    let frame = frame.ok_or_else(|| CliError::Internal("the target has no picture".into()))?;
    let name = &args.name;
    answer.put(json!({
        "name": name,
        "objective": objective.id,
        "features": features,
        "moved_features": moved,
        "shadows": desk.scope.flat_field().map_or(0, |seen| seen.shadows()),
    }));
    let file = desk
        .library
        .keep_target(name, &desk.config.name, stage, target, &frame)?;
    answer.put(json!({"file": file.to_string_lossy()}));
    match moved {
        Some(moved) => say!(
            answer,
            "saved '{name}' at {}: {features} features, {moved} of them seen to move with the stage",
            objective.id
        ),
        None => say!(
            answer,
            "saved '{name}' at {}: {features} features. Nothing was moved, so nobody knows which of them are on the camera: the run must \
             prove it, by a step aside where its own moves do not",
            objective.id
        ),
    }
    if let Some(shadows) = shadows {
        say!(
            answer,
            "  {} shadows lie on the camera: they are divided out of what it shows from now on. Better still, clean it",
            shadows.shadows()
        );
    }
    say!(answer, "  {} and its picture beside it", file.display());
    say!(answer, "  come back with: scopeservo reposition {name}");
    Ok(true)
}

pub(crate) fn reposition(args: &RepositionArgs, answer: &Answer) -> Result<bool, CliError> {
    let started = Instant::now();
    check_servo(args.lambda, args.max_iterations)?;
    // What can be wrong without the instrument is found before it is touched.
    let config = Config::read(&args.instrument.description.config)?;
    let kept = Folder::new(config.resolve(&config.data_folder)).target(&args.name)?;
    let foreign_um_per_px = match kept.instrument == config.name {
        true => None,
        false => Some(foreign_scale(&args.name, &kept, &config, answer)?),
    };
    try_out(&args.out)?;
    let desk = Desk::open(&args.instrument, answer)?;
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
        false => known_calibrations(&desk, size, answer),
    };
    let mut run = Reposition::new(kept.target, options).with_calibrations(known);
    if let Some(um_per_px) = foreign_um_per_px {
        run = run.with_foreign_scale(um_per_px);
    }
    let mut watcher = Watcher::new(None);
    if let Some(picture) = desk.library.target_picture(&args.name) {
        watcher.frame(&picture, FrameRole::Target);
    }
    let before = desk.scope.counters();
    let outcome = scopeservo_servo::run(&mut run, &desk.scope, &mut watcher);
    watcher.finish();
    let outcome = outcome?;
    desk.scope.check_cancel()?;
    let counters = desk.scope.counters();
    let seconds = started.elapsed().as_secs_f64();
    answer.put(json!({
        "verdict": outcome.verdict,
        "reason": outcome.reason,
        "message": outcome.message,
        "target": args.name,
        "estimated_error_um": outcome.estimated_error_um,
        "estimated_error_deg": outcome.estimated_error_deg,
        "unique_within_um": outcome.unique_within_um,
        "moves": counters.moves - before.moves,
        "frames": counters.frames - before.frames,
        "objective_changes": counters.objective_changes - before.objective_changes,
        "seconds": seconds,
        "magnifications": output::magnifications(&outcome),
    }));
    show_outcome(answer, &outcome);
    // The verdict stands, whether or not the stage still answers.
    let z = desk.scope.gate().position().ok();
    let z = z.and_then(|at| at.si(Axis::Z));
    say!(
        answer,
        "  {} moves, {} pictures, {seconds:.1} s{}",
        counters.moves - before.moves,
        counters.frames - before.frames,
        z.map_or(String::new(), |z| format!(", z = {:.1} um", z * 1e6))
    );
    let context = report::Context {
        title: format!("Back to {}", args.name),
        instrument: desk.config.name.clone(),
        command: output::command_line(),
        version: env!("CARGO_PKG_VERSION").into(),
        wall_time_s: Some(seconds),
        convergence: Some(report::Convergence {
            position_px: servo.position_px,
            angle_deg: servo.angle_deg,
        }),
        ..report::Context::default()
    };
    let page = report::html(&watcher.recorder, None, &context);
    keep_report(&args.out, &page, answer);
    Ok(outcome.verdict == Verdict::Arrived)
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
            "the target '{name}' was saved on '{}', and this is '{}': its picture has another scale and other axes, and an earlier version \
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

/// The calibrations that this instrument and camera made. One that is damaged is measured again on the way.
fn known_calibrations(
    desk: &Desk,
    size_px: [usize; 2],
    answer: &Answer,
) -> Vec<(ObjectiveId, Calibration)> {
    let objectives = desk.scope.gate().objectives().iter();
    let kept = objectives.filter_map(|o| answer.or_warn(desk.library.calibration(o)).flatten());
    // Of another instrument or camera, or another mode of it, it is of no use.
    kept.filter(|k| k.calibration.image_size_px == size_px && k.instrument == desk.config.name)
        .map(|k| (k.calibration.objective.clone(), k.calibration))
        .collect()
}

fn show_outcome(answer: &Answer, outcome: &Outcome) {
    let verdict = output::word(outcome.verdict);
    say!(answer, "{verdict}: {}", outcome.message);
    for m in output::magnifications(outcome) {
        match (m.iterations, m.inliers, m.error_um, m.error_deg) {
            (Some(n), Some(inliers), Some(um), Some(deg)) => say!(
                answer,
                "  {:>4}  {n:>2} iterations  {inliers:>4} inliers  {um:7.3} um  {deg:8.4} deg",
                m.objective
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
