//! What may be asked of the desk: from the body of a request to a job, with what is known of the instrument.

use crate::error::ApiError;
use crate::hand::Hand;
use crate::jog::{Hold, Jog, Map};
use scopeservo_library::{Label, LibraryError, Targets as _, check_slide};
use scopeservo_protocol::Place;
use scopeservo_scope::{Instrument, ObjectiveId};
use scopeservo_servo::Progress;
use scopeservo_servo::{CalibrateOptions, Calibration, FocusOptions, ServoOptions, Target};
use scopeservo_station::jobs::{Answer, AnyJob, DoctorInput, RepositionInput, Request};
use scopeservo_station::{JobError, UseCase, Work};
use scopeservo_workbench::{Asked, Usual, Workbench, contradiction, what};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// The body of `POST /jobs`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "job", rename_all = "snake_case", deny_unknown_fields)]
pub(crate) enum JobRequest {
    Move {
        #[serde(default)]
        to: Option<Place>,
        #[serde(default)]
        by: Option<Place>,
    },
    Centre {
        x: f64,
        y: f64,
    },
    Objective {
        objective: String,
    },
    Home {},
    Focus {
        #[serde(default)]
        objective: Option<String>,
        #[serde(default)]
        range_um: Option<f64>,
    },
    Calibrate {
        #[serde(default)]
        objectives: Vec<String>,
    },
    Check {},
    Doctor {
        #[serde(default)]
        allow_motion: bool,
    },
    SaveTarget {
        name: String,
        #[serde(default)]
        objective: Option<String>,
        #[serde(default)]
        focus: bool,
        #[serde(default)]
        note: String,
        /// Another than what was said to lie on the stage.
        #[serde(default)]
        slide: Option<String>,
    },
    Reposition {
        target: String,
    },
    Resume {},
}

/// A job of any kind that the desk does.
#[derive(Serialize)]
#[serde(untagged)]
pub(crate) enum Case {
    Any(Box<AnyJob>),
    Hand(Hand),
    Jog(Jog),
    /// Saving a view, by a program that was killed after it was kept and before it said so.
    WasKept,
}

/// What came of a case.
#[derive(Debug)]
pub(crate) enum Done {
    /// Of a step by hand, nothing more.
    Nothing,
    Answer(Box<Answer>),
    WasKept,
}

impl UseCase for Case {
    type Output = Done;

    fn kind(&self) -> &'static str {
        match self {
            Self::Any(job) => job.kind(),
            Self::Hand(hand) => hand.kind(),
            Self::Jog(jog) => jog.kind(),
            Self::WasKept => "save_target",
        }
    }

    fn can_go_on(&self) -> bool {
        match self {
            Self::Any(job) => job.can_go_on(),
            Self::Hand(hand) => hand.can_go_on(),
            Self::Jog(jog) => jog.can_go_on(),
            Self::WasKept => false,
        }
    }

    fn leave(&mut self, scope: &Instrument) {
        if let Self::Any(job) = self {
            job.leave(scope);
        }
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<Self::Output>, JobError> {
        let done = |progress| match progress {
            Progress::Done(()) => Progress::Done(Done::Nothing),
            Progress::Continue => Progress::Continue,
        };
        Ok(match self {
            Self::Hand(hand) => done(hand.step(work)?),
            Self::Jog(jog) => done(jog.step(work)?),
            Self::WasKept => Progress::Done(Done::WasKept),
            Self::Any(job) => match job.step(work)? {
                Progress::Continue => Progress::Continue,
                Progress::Done(answer) => Progress::Done(Done::Answer(Box::new(answer))),
            },
        })
    }
}

/// A job and all that the desk must know of it.
pub(crate) struct Wish {
    pub(crate) case: Case,
    /// What it is about, for people: the name of a target.
    pub(crate) about: Option<String>,
    /// As its record has it; of single steps there is none.
    pub(crate) asked: Option<Asked>,
    /// Calibrations that are damaged, and are left out of it.
    pub(crate) damaged: Vec<String>,
}

impl Wish {
    fn by_hand(hand: Hand) -> Self {
        Self {
            case: Case::Hand(hand),
            about: None,
            asked: None,
            damaged: Vec::new(),
        }
    }

    /// Held to move.
    pub(crate) fn jog(bench: &Workbench, hold: Hold) -> Self {
        let map = match in_view(bench) {
            Ok(calibration) => Map::Calibrated(Box::new(calibration)),
            Err(_) => Map::ByAxes(nominal_um_per_px(bench)),
        };
        Self {
            case: Case::Jog(Jog::new(hold, map)),
            about: None,
            asked: None,
            damaged: Vec::new(),
        }
    }

    fn job(request: Request, about: Option<String>, inputs: Value) -> Result<Self, ApiError> {
        let no_target = |_: &str| Err(ApiError::fault("the request names no target"));
        Ok(Self {
            case: Case::Any(Box::new(AnyJob::new(request, no_target)?)),
            about,
            asked: Some(Asked {
                inputs,
                ..Asked::default()
            }),
            damaged: Vec::new(),
        })
    }

    /// What the request asks for.
    pub(crate) fn of(bench: &Workbench, request: JobRequest) -> Result<Self, ApiError> {
        match request {
            JobRequest::Move { to, by } => go(to, by),
            JobRequest::Centre { x, y } => centre(bench, [x, y]),
            JobRequest::Objective { objective } => {
                let id = ObjectiveId(objective);
                bench.scope.objective(&id)?;
                Ok(Self::by_hand(Hand::Objective(id)))
            }
            JobRequest::Home {} => Ok(Self::by_hand(Hand::Home)),
            JobRequest::Focus {
                objective,
                range_um,
            } => {
                let objective = named(bench, objective)?;
                let input = usual(bench).focus(objective, None, focusing(range_um)?);
                let inputs = json!(input);
                Self::job(Request::Focus(input), None, inputs)
            }
            JobRequest::Calibrate { objectives } => calibrate(bench, objectives),
            JobRequest::Check {} => {
                let mut damaged = Vec::new();
                let known = bench.known_calibrations(|unread| match unread {
                    LibraryError::NobodysCalibration { .. } => {}
                    unread => damaged.push(unread.to_string()),
                });
                if known.is_empty() {
                    let message = "no objective is calibrated: calibrate first";
                    return Err(ApiError::conflict("no_calibration", message));
                }
                let input = usual(bench).check(known, Some(FocusOptions::default()));
                let inputs = json!(input);
                let wish = Self::job(Request::Check(input), None, inputs)?;
                Ok(Self { damaged, ..wish })
            }
            JobRequest::Doctor { allow_motion } => {
                let input = DoctorInput { allow_motion };
                Self::job(Request::Doctor(input), None, json!(input))
            }
            JobRequest::SaveTarget {
                name,
                objective,
                focus,
                note,
                slide,
            } => {
                let label = Label { slide, note };
                save(bench, name, named(bench, objective)?, focus, &label)
            }
            JobRequest::Reposition { target } => reposition(bench, target),
            JobRequest::Resume {} => resume(bench),
        }
    }
}

fn is_finite(place: &Place) -> bool {
    let all = [
        place.x_um,
        place.y_um,
        place.z_um,
        place.rx_deg,
        place.ry_deg,
        place.rz_deg,
    ];
    all.iter().flatten().all(|v| v.is_finite()) && all.iter().any(Option::is_some)
}

fn go(to: Option<Place>, by: Option<Place>) -> Result<Wish, ApiError> {
    let hand = match (to, by) {
        (Some(to), None) if is_finite(&to) => Hand::Go(to),
        (None, Some(by)) if is_finite(&by) => Hand::Shift(by),
        _ => {
            let message = "a move goes `to` a place or `by` so much: give one of them, with an axis in it, like {\"job\":\"move\",\"by\":{\"x_um\":10}}";
            return Err(ApiError::input(message));
        }
    };
    Ok(Wish::by_hand(hand))
}

/// The calibration of the objective that is in, where this camera made one.
pub(crate) fn in_view(bench: &Workbench) -> Result<Calibration, ApiError> {
    let id = bench.scope.gate().current_objective()?;
    let uncalibrated = || {
        let which = id
            .as_ref()
            .map_or("the objective".into(), |id| id.to_string());
        let message = format!(
            "{which} is not calibrated, so nobody knows where in the view that is: calibrate it first"
        );
        ApiError::conflict("no_calibration", message)
    };
    let known = bench.known_calibrations(|_| {});
    let own = known
        .into_iter()
        .find(|c| Some(&c.objective) == id.as_ref());
    own.ok_or_else(uncalibrated)
}

fn nominal_um_per_px(bench: &Workbench) -> f64 {
    let gate = bench.scope.gate();
    let id = gate.current_objective().ok().flatten();
    let objective = id.and_then(|id| gate.objective(&id).ok());
    objective.map_or(1.0, |o| o.nominal_um_per_px)
}

fn centre(bench: &Workbench, share: [f64; 2]) -> Result<Wish, ApiError> {
    if !share.iter().all(|v| (0.0..=1.0).contains(v)) {
        let message = "x and y are shares of the view's width and height, from 0 to 1";
        return Err(ApiError::input(message));
    }
    let calibration = in_view(bench)?;
    let info = bench.scope.camera().info();
    let size = [info.width, info.height];
    let pixels = [0, 1].map(|k| (share[k] - 0.5) * (size[k] as f64 - 1.0));
    Ok(Wish::by_hand(Hand::Centre(pixels, Box::new(calibration))))
}

/// What the description says of every job.
fn usual(bench: &Workbench) -> Usual<'_> {
    Usual::of(&bench.config)
}

fn focusing(range_um: Option<f64>) -> Result<FocusOptions, ApiError> {
    let plain = FocusOptions::default();
    match range_um {
        None => Ok(plain),
        Some(um) if (1.0..=1e4).contains(&um) => Ok(FocusOptions {
            half_range_um: um,
            nearest_um: plain.nearest_um.min(um),
            ..plain
        }),
        Some(_) => Err(ApiError::input("range_um is from 1 to 10000")),
    }
}

fn calibrate(bench: &Workbench, objectives: Vec<String>) -> Result<Wish, ApiError> {
    let objectives: Vec<_> = objectives.into_iter().map(ObjectiveId).collect();
    for named in &objectives {
        bench.scope.objective(named)?;
    }
    let focus = Some(FocusOptions::default());
    let input = usual(bench).calibrate(objectives, focus, CalibrateOptions::default(), 0);
    let inputs = json!(input);
    Wish::job(Request::Calibrate(input), None, inputs)
}

/// An objective that there is.
fn named(bench: &Workbench, objective: Option<String>) -> Result<Option<ObjectiveId>, ApiError> {
    let id = objective.map(ObjectiveId);
    if let Some(id) = &id {
        bench.scope.objective(id)?;
    }
    Ok(id)
}

fn save(
    bench: &Workbench,
    name: String,
    objective: Option<ObjectiveId>,
    focus: bool,
    label: &Label,
) -> Result<Wish, ApiError> {
    bench.library.check_new_target(&name)?;
    label.slide.as_deref().map_or(Ok(()), check_slide)?;
    let known = bench.known_calibrations(|_| {});
    let input = usual(bench).save(objective, (FocusOptions::default(), focus), false, known);
    let inputs = json!({"name": name, "slide": label.slide, "note": label.note, "input": input});
    Wish::job(Request::SaveTarget(input), Some(name), inputs)
}

fn reposition(bench: &Workbench, name: String) -> Result<Wish, ApiError> {
    let kept = bench.library.target(&name)?;
    let foreign_um_per_px = match (&kept.target.taken, kept.instrument == bench.config.name) {
        (_, true) => None,
        (Some(taken), false) => Some(taken.um_per_px),
        (None, false) => {
            let message = format!(
                "the target '{name}' was saved on '{}', and an earlier version did not keep its scale. Save it anew here",
                kept.instrument
            );
            return Err(ApiError::conflict("foreign_target", message));
        }
    };
    let known = bench.known_calibrations(|_| {});
    let input = RepositionInput {
        target_id: kept.id.clone(),
        options: usual(bench).reposition(ServoOptions::default(), FocusOptions::default()),
        foreign_um_per_px: foreign_um_per_px.or_else(|| bench.other_mode_um_per_px(&kept, &known)),
        known,
        switchings: bench.switchings.clone(),
        parcentric: bench.parcentric.clone(),
    };
    let asked = Asked {
        inputs: json!({"name": name, "options": input.options}),
        target: Some([name.clone(), kept.id]),
        ..Asked::default()
    };
    let target = kept.target;
    let job = AnyJob::new::<ApiError>(Request::Reposition(input), |_| Ok(target))?;
    Ok(Wish {
        case: Case::Any(Box::new(job)),
        about: Some(name),
        asked: Some(asked),
        damaged: Vec::new(),
    })
}

/// What a killed program left.
fn resume(bench: &Workbench) -> Result<Wish, ApiError> {
    let Some(left) = bench.left()? else {
        let message = "no job was under way when a program ended: there is nothing to go on with";
        return Err(ApiError::conflict("nothing_left", message));
    };
    let cannot = |why: String| {
        let message = format!("{} cannot go on: {why}", what(&left));
        ApiError::conflict("unfinished", message)
    };
    let Some(step) = &left.step else {
        return Err(cannot("it had not begun. Abandon it".into()));
    };
    let stored = AnyJob::stored(&left.head.job, step.state.to_string().as_bytes());
    let mut job = stored.map_err(|e| cannot(e.to_string()))?;
    let name = left.head.inputs["name"].as_str().map(str::to_owned);
    if let (AnyJob::SaveTarget(job), Some(name)) = (&job, &name)
        && let Ok(kept) = bench.library.target(name)
    {
        if !bench.was_kept_by(&kept, job) {
            return Err(cannot(format!(
                "another target is called '{name}' now. Rename that one first, or abandon it"
            )));
        }
        return Ok(Wish {
            case: Case::WasKept,
            about: Some(name.clone()),
            asked: None,
            damaged: Vec::new(),
        });
    }
    // What was kept needs nothing more, wherever the stage stands.
    if let Some(why) = contradiction(&left, &bench.scope) {
        return Err(cannot(why));
    }
    if let Some(id) = job.target_id() {
        let target = kept_target(bench, name.as_deref().unwrap_or_default(), id);
        job = job.with_target(target.map_err(cannot)?);
    }
    Ok(Wish {
        case: Case::Any(Box::new(job)),
        about: name,
        asked: Some(Asked {
            inputs: left.head.inputs.clone(),
            target: left.head.target.clone(),
            resumed: true,
        }),
        damaged: Vec::new(),
    })
}

fn kept_target(bench: &Workbench, name: &str, id: &str) -> Result<Target, String> {
    let kept = bench.library.target(name).map_err(|e| e.to_string())?;
    match kept.id == id {
        true => Ok(kept.target),
        false => Err("its target is not the one that it was begun with".into()),
    }
}
