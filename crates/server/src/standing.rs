//! How things stand: looked at several times a second, told with its age.

use crate::app::App;
use crate::people::Caller;
use scopeservo_protocol::Place;
use scopeservo_scope::{Motion, ObjectiveId, StagePose};
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

/// What was seen of the instrument, and when.
#[derive(Debug, Clone)]
pub(crate) struct Standing {
    /// When the stage said where it is.
    pub(crate) at_time: Instant,
    pub(crate) at: Option<StagePose>,
    pub(crate) homed: bool,
    pub(crate) moving: bool,
    pub(crate) objective: Option<ObjectiveId>,
    pub(crate) exposure_ms: Option<f64>,
    pub(crate) light: Option<f64>,
    /// What the instrument does not answer.
    pub(crate) trouble: Option<String>,
    /// Seconds on the instrument's clock.
    pub(crate) time_s: f64,
}

impl Standing {
    /// Before anybody looked.
    pub(crate) fn unknown() -> Self {
        Self {
            at_time: Instant::now(),
            at: None,
            homed: false,
            moving: false,
            objective: None,
            exposure_ms: None,
            light: None,
            trouble: None,
            time_s: 0.0,
        }
    }

    /// A look at the instrument. What stands still is not asked where it is each time.
    fn look(app: &App, before: &Self) -> Self {
        let scope = &app.bench.scope;
        let gate = scope.gate();
        let mut trouble = None;
        let mut ask = |what: Result<(), scopeservo_scope::ScopeError>| {
            if let Err(error) = what {
                trouble.get_or_insert(error.to_string());
            }
        };
        let mut now = Self {
            time_s: scope.clock().now().seconds(),
            ..before.clone()
        };
        ask(gate
            .poll()
            .map(|motion| now.moving = motion == Motion::Moving));
        let is_due = now.moving || before.moving || before.at_time.elapsed() > AT_REST;
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
    pub(crate) fn told_to(&self, app: &App, caller: &Caller) -> Value {
        let session = app.console.session();
        let questions = session.questions().open();
        let jobs = app.desk.all();
        let recent = jobs.iter().rev().take(5).map(|entry| entry.summary());
        json!({
            "time_s": self.time_s,
            "at": self.at.as_ref().map(Place::from),
            "at_age_s": self.at_time.elapsed().as_secs_f64(),
            "homed": self.homed,
            "moving": self.moving,
            "trouble": self.trouble,
            "objective": self.objective,
            "exposure_ms": self.exposure_ms,
            "light": self.light,
            "owner": app.seat.owner(),
            "mine": app.seat.is_of(&caller.key),
            "asked_by": app.seat.asked_by(),
            "slide": crate::lock(&app.slide).clone(),
            "jobs": recent.collect::<Vec<_>>(),
            "questions": questions.iter().map(question).collect::<Vec<_>>(),
            "camera": app.live.camera(),
            "revision": app.revision.load(Ordering::SeqCst),
            "elsewhere_s": app.elsewhere_for().map(|left| left.as_secs_f64()),
            "demo": app.demo.as_ref().map(|demo| json!({
                "slide": if demo.is_moved.load(Ordering::SeqCst) { "moved" } else { "in" },
            })),
        })
    }
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
pub(crate) fn watch(app: &Arc<App>) {
    let mut before = Standing::unknown();
    while !app.ends.load(Ordering::SeqCst) {
        let now = Standing::look(app, &before);
        before = now.clone();
        app.standing.send_replace(Arc::new(now));
        let since = Instant::now();
        while since.elapsed() < OFTEN {
            app.desk.end_stale_jog();
            std::thread::sleep(HELD);
        }
    }
}
