//! A job followed to its end: its record, its page, and what is to be kept of it.

use crate::app::App;
use crate::asked::Case;
use crate::desk::{End, Entry, was_stopped};
use crate::error::ApiError;
use scopeservo_library::Targets as _;
use scopeservo_report::{self as report, Recorder, Work, WorkEnd, work_html};
use scopeservo_servo::{FrameRole, Sink as _, Stamped};
use scopeservo_station::jobs::{Answer, RepositionOutput, SaveTargetOutput};
use scopeservo_station::{Job, JobError, News, StationEvent, UseCase};
use scopeservo_workbench::{RunRecord, Told};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Instant;

/// A job that has begun.
pub(crate) struct Task {
    pub(crate) entry: Arc<Entry>,
    pub(crate) record: Option<RunRecord>,
    pub(crate) inputs: Option<Value>,
    /// Whether its page shows the views of a calibration.
    pub(crate) keeps_views: bool,
    pub(crate) warnings: Vec<String>,
}

/// Follows it, keeps what came of it, and tells the desk.
pub(crate) fn follow(app: &App, mut task: Task, job: Job<<Case as UseCase>::Output>) {
    let mut recorder = Recorder::new();
    if task.keeps_views {
        recorder.keep_calibration_views();
    }
    if let (Some(name), "reposition") = (&task.entry.about, task.entry.kind)
        && let Some(picture) = app.bench.library.target_picture(name)
    {
        recorder.frame(&picture, FrameRole::Target);
    }
    let began = Instant::now();
    let came = app.console.follow(job, |told| match told {
        Told::Frame(frame, role) => recorder.frame(&frame, role),
        Told::Event(news) => {
            if let Some(record) = &mut task.record {
                record.event(&news);
            }
            match &news.news {
                News::Procedure(event) => recorder.event(Stamped {
                    time_s: news.time_s,
                    event: (**event).clone(),
                }),
                News::Station(StationEvent::NotKept { why, .. }) => {
                    task.warnings.push(why.clone());
                }
                _ => {}
            }
        }
    });
    let seconds = began.elapsed().as_secs_f64();
    task.warnings.extend(app.bench.journal.lost());
    let page = page(app, &task, &recorder, &came, seconds);
    let (mut answer, error) = keep(app, &task, came, seconds);
    if let (Value::Object(answer), false) = (&mut answer, task.warnings.is_empty()) {
        answer.insert("warnings".into(), json!(task.warnings));
    }
    let run = task.record.map(|record| {
        let place = record.place().and_then(|p| p.file_name());
        let run = place.map(|name| name.to_string_lossy().into_owned());
        let told = match &error {
            None => answer.clone(),
            Some(error) => json!({"error": error}),
        };
        // What cannot be kept now was told of as it happened, or is told by the library's check.
        let _ = record.end(page.as_deref(), &told);
        run
    });
    if matches!(task.entry.kind, "calibrate" | "reposition") {
        app.learn_calibrated();
    }
    app.has_changed();
    task.entry.finish(End {
        answer: (!answer.is_null()).then_some(answer),
        error,
        run: run.flatten(),
    });
}

/// The answer as programs read it, and what is an error.
fn keep(
    app: &App,
    task: &Task,
    came: Result<<Case as UseCase>::Output, JobError>,
    seconds: f64,
) -> (Value, Option<ApiError>) {
    match came {
        // Who lets go of a jog has what was wanted.
        Err(JobError::Stopped { .. }) if task.entry.kind == "jog" => (Value::Null, None),
        Err(error) => (Value::Null, Some(error.into())),
        Ok(None) => (json!({"seconds": seconds}), None),
        Ok(Some(answer)) => match *answer {
            Answer::SaveTarget(saved) => save(app, task, &saved),
            Answer::Reposition(output) => (reposition(&output, seconds), None),
            other => {
                let told = serde_json::to_value(&other).unwrap_or_default();
                (told["output"].clone(), None)
            }
        },
    }
}

fn save(app: &App, task: &Task, saved: &SaveTargetOutput) -> (Value, Option<ApiError>) {
    let name = task.entry.about.as_deref().unwrap_or_default();
    let SaveTargetOutput {
        target,
        stage,
        frame,
    } = saved;
    let Some(frame) = frame else {
        let error = ApiError::fault("the target has no image");
        return (Value::Null, Some(error));
    };
    let library = &app.bench.library;
    let kept = library.keep_target(name, &app.bench.config.name, *stage, target.clone(), frame);
    match kept {
        Err(error) => (Value::Null, Some(error.into())),
        Ok(_) => {
            let answer = json!({
                "name": name,
                "objective": target.objective,
                "features": target.features.len(),
                "moved_features": target.moved,
                "quality": target.quality,
            });
            (answer, None)
        }
    }
}

fn reposition(output: &RepositionOutput, seconds: f64) -> Value {
    let RepositionOutput {
        outcome, counters, ..
    } = output;
    let mut answer = serde_json::to_value(outcome).unwrap_or_default();
    answer["moves"] = json!(counters.moves);
    answer["frames"] = json!(counters.frames);
    answer["objective_changes"] = json!(counters.objective_changes);
    answer["seconds"] = json!(seconds);
    answer
}

/// The page of a run, where there is one to show.
fn page(
    app: &App,
    task: &Task,
    recorder: &Recorder,
    came: &Result<<Case as UseCase>::Output, JobError>,
    seconds: f64,
) -> Option<String> {
    let bench = &app.bench;
    let asked = format!(
        "{} by {}",
        task.entry.kind.replace('_', " "),
        task.entry.owner
    );
    let context = report::Context {
        wall_time_s: Some(seconds),
        ..bench.page_context(asked)
    };
    let name = task.entry.about.as_deref().unwrap_or_default();
    let work = match task.entry.kind {
        "reposition" => {
            came.as_ref().ok()?;
            let servo = task.inputs.as_ref().map(|i| i["options"]["servo"].clone());
            let servo: scopeservo_servo::ServoOptions = servo
                .and_then(|servo| serde_json::from_value(servo).ok())
                .unwrap_or_default();
            let target = bench.library.target(name).map_or_else(
                |_| name.into(),
                |kept| format!("{name}, saved {} on {}", kept.saved, kept.instrument),
            );
            let context = report::Context {
                title: format!("Back to {name}"),
                target,
                convergence: Some(report::Convergence {
                    position_px: servo.position_px,
                    angle_deg: servo.angle_deg,
                }),
                ..context
            };
            return Some(report::html(recorder, None, &context));
        }
        "calibrate" => Work::Calibration,
        "focus" => Work::Focus,
        _ => return None,
    };
    let failed = came.as_ref().err().map(|error| report::Failure {
        message: error.to_string(),
        stopped: was_stopped(&task.entry),
    });
    let end = WorkEnd {
        work,
        failed,
        before: Vec::new(),
    };
    let title = format!("{} of {}", task.entry.kind, bench.config.name);
    let context = report::Context { title, ..context };
    Some(work_html(recorder, &end, &context))
}
