//! A look at how things stand, several times a second, and how that is told.

use crate::app::App;
use crate::people::Caller;
use crate::standing::Standing;
use scopeservo_protocol::Place;
use scopeservo_scope::Motion;
use scopeservo_station::{Question, QuestionKind};
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// How often it is looked.
const OFTEN: Duration = Duration::from_millis(125);
/// How often it is looked whether somebody holds still what is held to move.
const HELD: Duration = Duration::from_millis(25);
/// What stands is asked again so often: an answer may take a controller tens of milliseconds.
const AT_REST: Duration = Duration::from_secs(1);

/// A look at the instrument. What stands still is not asked where it is each time, but when it `is_due`.
fn look(app: &App, before: &Standing, is_due: bool) -> Standing {
    let scope = &app.bench.scope;
    let gate = scope.gate();
    let mut trouble = None;
    let mut ask = |what: Result<(), scopeservo_scope::ScopeError>| {
        if let Err(error) = what {
            trouble.get_or_insert(error.to_string());
        }
    };
    let mut now = Standing {
        number: before.number + 1,
        time_s: scope.clock().now().seconds(),
        ..before.clone()
    };
    ask(gate
        .poll()
        .map(|motion| now.moving = motion == Motion::Moving));
    let is_due = is_due || now.moving || before.moving || before.at_time.elapsed() > AT_REST;
    if is_due || before.at.is_none() {
        let at = gate.position();
        ask(at.map(|at| {
            now.at = Some(at);
            now.at_time = Instant::now();
        }));
        ask(gate.is_homed().map(|homed| now.homed = homed));
        ask(gate.current_objective().map(|id| now.objective = id));
        ask(scope
            .camera()
            .exposure()
            .map(|e| now.exposure_ms = Some(e.as_secs_f64() * 1e3)));
        if let Some(light) = scope.light() {
            ask(light.level().map(|level| now.light = Some(level)));
        }
    } else if let Some(at) = gate.last_reported() {
        now.at = Some(at);
    }
    now.trouble = trouble;
    now
}

/// As whoever asks is told.
pub(crate) fn told(app: &App, caller: &Caller) -> Value {
    let session = app.console.session();
    let questions = session.questions().open();
    let jobs = app.desk.all();
    let recent: Vec<_> = jobs.iter().rev().take(5).map(|e| e.summary()).collect();
    // After the jobs: a place from before the end of one does not stand beside its end.
    let standing = app.standing.borrow().clone();
    json!({
        "time_s": standing.time_s,
        "at": standing.at.as_ref().map(Place::from),
        "at_age_s": standing.at_time.elapsed().as_secs_f64(),
        "homed": standing.homed,
        "moving": standing.moving,
        "trouble": standing.trouble,
        "objective": standing.objective,
        "exposure_ms": standing.exposure_ms,
        "light": standing.light,
        "owner": app.seat.owner(),
        "mine": app.seat.is_of(&caller.key),
        "asked_by": app.seat.asked_by(),
        "there": app.who_is_there(),
        "may_not_start": app.bars(caller).err(),
        "slide": crate::lock(&app.slide).clone(),
        "jobs": recent,
        "questions": questions.iter().map(question).collect::<Vec<_>>(),
        "camera": app.live.camera(),
        "revision": app.revision.load(Ordering::SeqCst),
        "elsewhere_s": app.elsewhere_for().map(|left| left.as_secs_f64()),
        "demo": app.demo.as_ref().map(|demo| json!({
            "picture": *crate::lock(&demo.picture),
            "slide": if demo.is_moved.load(Ordering::SeqCst) { "moved" } else { "in" },
        })),
    })
}

/// A question with words for it.
fn question(question: &Question) -> Value {
    let text = match &question.kind {
        QuestionKind::TurnNosepiece { objective } => {
            format!("Turn the nosepiece to {objective}, then say yes.")
        }
        QuestionKind::ChangeImmersion { change } => format!(
            "{} works in {}, and on the specimen there is {}. Nothing moves before you agree: make the specimen and the objective ready, then say yes.",
            change.objective,
            change.to,
            change.from_words()
        ),
        QuestionKind::Confirm { text } => text.clone(),
    };
    let mut told = json!(question);
    told["text"] = json!(text);
    told
}

/// Looks until the server ends.
pub(crate) fn keep_looking(app: &Arc<App>) {
    while !app.ends.load(Ordering::SeqCst) {
        let before = app.standing.borrow().clone();
        let now = look(app, &before, false);
        // A look that began before a job ended says nothing of where the job left the instrument.
        app.standing.send_if_modified(|newest| {
            let is_next = newest.number == before.number;
            if is_next {
                *newest = Arc::new(now);
            }
            is_next
        });
        std::thread::sleep(OFTEN);
    }
}

/// Looks at where a job left the instrument, and then says that the job has ended: who reads that it has reads no place from before.
pub(crate) fn after(app: &App, has_ended: impl FnOnce()) {
    let before = app.standing.borrow().clone();
    let now = look(app, &before, true);
    app.standing.send_modify(|newest| {
        let number = newest.number + 1;
        *newest = Arc::new(Standing { number, ..now });
    });
    has_ended();
    // All who watch hear of it now.
    app.standing.send_modify(|_| {});
}

/// Ends what nobody holds any more, until the server ends: on a thread of its own, as a look waits for devices.
pub(crate) fn keep_ending(app: &Arc<App>) {
    while !app.ends.load(Ordering::SeqCst) {
        app.desk.end_stale_jog();
        std::thread::sleep(HELD);
    }
}
