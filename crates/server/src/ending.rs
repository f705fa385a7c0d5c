//! A job followed to its end: its record, its page, and what is to be kept of it.

use crate::app::App;
use crate::asked::Done;
use crate::desk::{End, Entry, was_stopped};
use crate::error::ApiError;
use crate::look;
use scopeservo_library::{NewTarget, Targets as _};
use scopeservo_report::{self as report, Recorder, Work, WorkEnd, work_html};
use scopeservo_servo::{FrameRole, Sink as _, Stamped, Target};
use scopeservo_station::jobs::{Answer, RepositionOutput, SaveTargetOutput};
use scopeservo_station::{Job, JobError, JobState, News, StationEvent};
use scopeservo_workbench::{RunRecord, Told, label_of};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How often it is looked whether a job has ended that nobody follows any more.
const ENDS: Duration = Duration::from_millis(20);

/// A job that has begun.
pub(crate) struct Task {
    pub(crate) entry: Arc<Entry>,
    pub(crate) record: Option<RunRecord>,
    pub(crate) inputs: Option<Value>,
    /// Whether its page shows the views of a calibration.
    pub(crate) keeps_views: bool,
    /// Whether nothing that it was to look at is damaged.
    pub(crate) is_whole: bool,
    pub(crate) warnings: Vec<String>,
}

/// Follows it, keeps what came of it, and tells the desk: whatever happens meanwhile, the desk is free afterwards.
pub(crate) fn follow(app: &App, task: Task, job: Job<Done>) {
    let entry = task.entry.clone();
    in_any_case(app, &entry, || followed(app, task, job));
}

/// Does what ends a job. Where that is broken off, by a mistake of the program, the job is told as ended with a fault.
fn in_any_case(app: &App, entry: &Entry, work: impl FnOnce()) {
    // What the work left behind locks is whole, and what it had of its own is gone.
    let _ = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
    if entry.is_over() {
        return;
    }
    // Nobody else begins anything beside it while it moves.
    let _ = entry.handle.stop();
    while !matches!(entry.handle.state(), JobState::Ended(_)) {
        std::thread::sleep(ENDS);
    }
    app.learn_left();
    app.has_changed();
    let message = "the program made a mistake while this job ended, told on its terminal: what came of it is not kept. The instrument stands";
    let end = End {
        answer: None,
        error: Some(ApiError::fault(message)),
        run: None,
    };
    entry.finish(end);
}

fn followed(app: &App, mut task: Task, job: Job<Done>) {
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
    let seen = (answer["verdict"] == "arrived").then(|| recorder.last_seen());
    let run = task.record.map(|mut record| {
        if let Some(seen) = seen.flatten() {
            // Without a picture it has arrived all the same.
            let _ = record.arrived(&seen);
        }
        let run = record.id().map(str::to_owned);
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
    app.learn_left();
    app.has_changed();
    let end = End {
        answer: (!answer.is_null()).then_some(answer),
        error,
        run: run.flatten(),
    };
    look::after(app, || task.entry.finish(end));
}

/// The answer as programs read it, and what is an error.
fn keep(
    app: &App,
    task: &Task,
    came: Result<Done, JobError>,
    seconds: f64,
) -> (Value, Option<ApiError>) {
    match came {
        // Who lets go of a jog has what was wanted.
        Err(JobError::Stopped { .. }) if task.entry.kind == "jog" => (Value::Null, None),
        Err(error) => (Value::Null, Some(error.into())),
        Ok(Done::Nothing) => (json!({"seconds": seconds}), None),
        Ok(Done::WasKept) => was_kept(app, task),
        Ok(Done::Answer(answer)) => match *answer {
            Answer::SaveTarget(saved) => save(app, task, &saved),
            Answer::Check(output) => {
                let mut told = json!(output);
                told["ok"] = json!(output.all_good() && task.is_whole);
                (told, None)
            }
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
    let label = task.inputs.as_ref().map(label_of).unwrap_or_default();
    let kept = library.keep_target(NewTarget {
        name,
        instrument: &app.bench.config.name,
        stage: *stage,
        target: target.clone(),
        frame,
        label: &label,
    });
    match kept {
        Err(error) => (Value::Null, Some(error.into())),
        Ok(_) => (saved_as(name, target), None),
    }
}

fn saved_as(name: &str, target: &Target) -> Value {
    json!({
        "name": name,
        "objective": target.objective,
        "features": target.features.len(),
        "moved_features": target.moved,
        "quality": target.quality,
    })
}

/// A killed program had kept it: nothing is left to do, and nothing waits any more.
fn was_kept(app: &App, task: &Task) -> (Value, Option<ApiError>) {
    let name = task.entry.about.as_deref().unwrap_or_default();
    let kept = app.bench.library.target(name);
    match kept.and_then(|kept| app.bench.end_left().map(|()| kept)) {
        Err(error) => (Value::Null, Some(error.into())),
        Ok(kept) => {
            let mut answer = saved_as(name, &kept.target);
            answer["was_kept"] = json!(true);
            answer["message"] = json!(format!("'{name}' was saved before the program ended"));
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
    came: &Result<Done, JobError>,
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asked::Case;
    use crate::hand::Hand;
    use crate::serve::{Before, Settings, app};
    use crate::{lock, names::Names};
    use scopeservo_protocol::Place;
    use scopeservo_scope::CancelToken;
    use scopeservo_setup::{Config, Consent};
    use scopeservo_workbench::Workbench;
    use std::sync::Mutex;

    const TWIN: &str = "name = \"t\"
[drivers.twin.twin]
seed = 3
objectives = [\"10x\", \"40x\"]
[devices]
stage = \"twin\"
camera = \"twin\"
nosepiece = \"twin\"
light = \"twin\"
[limits]
x_um = [-17000, 17000]
y_um = [-16000, 16000]
z_um = [-3000, 500]
[objective_change]
retract_z_um = -2000
margin_um = 50
";

    #[test]
    fn a_mistake_while_a_job_ends_leaves_the_desk_free_and_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let config = Config::parse(TWIN, &dir.path().join("scopeservo.toml")).unwrap();
        let consent = Consent {
            home: false,
            ask: std::sync::Arc::new(|_, _| false),
            ask_immersion: std::sync::Arc::new(|_, _| false),
        };
        let bench = Workbench::open(config, &consent, CancelToken::new(), |e| panic!("{e}"));
        let settings = Settings {
            listen: "127.0.0.1:0".parse().unwrap(),
            names: Vec::new(),
            tls: None,
            proxies: Vec::new(),
            limits: Default::default(),
            demo: true,
            folder: dir.path().into(),
        };
        let names = Names::of(&[7070], &[], false);
        let app = app(bench.unwrap(), Before::default(), &settings, names).unwrap();
        // Three ways: while it moves, after it ended, and with a lock that is held.
        for way in 0..3 {
            let lease = app.console.session().take_lease("anna", None).unwrap();
            let (entry, job) = app
                .desk
                .put(|| {
                    let by = Place {
                        x_um: Some(3.0),
                        ..Place::default()
                    };
                    let job = app
                        .console
                        .session()
                        .start(&lease, Case::Hand(Hand::Shift(by)))?;
                    let entry = Arc::new(Entry {
                        kind: "move",
                        owner: "anna".into(),
                        about: None,
                        handle: job.handle().clone(),
                        end: Mutex::default(),
                    });
                    Ok((entry, None, job))
                })
                .unwrap();
            assert_eq!(app.desk.is_free().unwrap_err().code, "busy");
            in_any_case(&app, &entry, || match way {
                0 => panic!("at once"),
                1 => {
                    app.console.follow(job, |_| {}).unwrap();
                    panic!("after its end");
                }
                _ => {
                    let _slide = lock(&app.slide);
                    let _end = lock(&entry.end);
                    panic!("in the middle");
                }
            });
            app.desk.is_free().unwrap();
            let told = entry.whole();
            assert_eq!(told["state"]["state"], "ended", "{told}");
            assert_eq!(told["error"]["code"], "internal", "{told}");
            assert_eq!(told["error"]["kind"], "fault", "{told}");
            assert!(lock(&app.slide).is_none());
            app.console.session().give_back(&lease).unwrap();
        }
    }
}
