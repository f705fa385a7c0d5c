//! The journal of the job under way, in the library; and what is told of one that was killed.

use scopeservo_library::{
    CalibrationSets as _, Calibrations as _, Cameras as _, Database, Journal as _, JournalHead,
    JournalStep, Journalled, LibraryError, Nosepieces as _, utc,
};
use scopeservo_scope::{Axis, Instrument, Length, StagePose};
use scopeservo_station::{Ended, JobInfo, Journal, JournalError, Kept, MadeCalibration};
use serde_json::Value;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::SystemTime;

/// What a job is asked, as its record and its journal have it.
#[derive(Debug, Clone, Default)]
pub struct Asked {
    /// What it is asked to do.
    pub inputs: Value,
    /// Name and id of the target that it refers to.
    pub target: Option<[String; 2]>,
    /// It goes on: what is kept of it stays until its next step replaces it.
    pub resumed: bool,
}

/// A calibration that a job made, and where it is kept.
#[derive(Debug, Clone)]
pub struct Made {
    /// The calibration.
    pub calibration: MadeCalibration,
    /// Where it is kept, if it could be.
    pub file: Option<PathBuf>,
}

/// Keeps what a station's jobs are at in a library.
pub struct FileJournal {
    library: Arc<Database>,
    instrument: String,
    scope: Weak<Instrument>,
    at_work: Mutex<AtWork>,
}

#[derive(Default)]
struct AtWork {
    /// Of the job that comes, until its first step.
    head: Option<JournalHead>,
    /// Whether a job has a journal now.
    begun: bool,
    /// Why it has none: it goes on all the same, and cannot be resumed.
    lost: Option<String>,
    made: Vec<Made>,
}

impl FileJournal {
    /// The journal of an instrument of that name.
    pub fn new(library: &Arc<Database>, instrument: &str, scope: &Arc<Instrument>) -> Self {
        Self {
            library: library.clone(),
            instrument: instrument.into(),
            scope: Arc::downgrade(scope),
            at_work: Mutex::default(),
        }
    }

    fn at_work(&self) -> MutexGuard<'_, AtWork> {
        self.at_work.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The job that is started next.
    pub fn comes(&self, job: &str, asked: Asked) {
        let head = (!asked.resumed).then(|| JournalHead {
            job: job.into(),
            began: utc(SystemTime::now()),
            inputs: asked.inputs,
            target: asked.target,
        });
        *self.at_work() = AtWork {
            head,
            ..AtWork::default()
        };
    }

    /// The job's answer is kept, or there is none: it will not go on.
    pub fn close(&self) -> Result<(), LibraryError> {
        self.library.end_journal(&self.instrument)
    }

    /// What the job made so far.
    pub fn made(&self) -> Vec<Made> {
        self.at_work().made.clone()
    }

    /// Why the job had no journal, when it had none.
    pub fn lost(&self) -> Option<String> {
        self.at_work().lost.take()
    }

    /// Where things stand, before a step.
    fn keep(
        &self,
        scope: &Instrument,
        step: u64,
        state: &dyn Fn() -> Result<Vec<u8>, JournalError>,
    ) -> Result<(), JournalError> {
        if let Some(head) = self.at_work().head.take() {
            let begun = self.library.begin_journal(&self.instrument, &head);
            begun.map_err(failed)?;
        }
        let gate = scope.gate();
        let step = JournalStep {
            step,
            // What cannot be asked now cannot be compared later: then the job itself meets the fault.
            stage: gate.position().unwrap_or_default(),
            homed: gate.is_homed().unwrap_or(false),
            objective: gate.current_objective().ok().flatten(),
            state: serde_json::from_slice(&state()?).map_err(failed)?,
        };
        let kept = self.library.journal_step(&self.instrument, &step);
        kept.map(drop).map_err(failed)
    }

    /// The stage is about to be sent there.
    pub fn goes(&self, to: &StagePose) {
        if self.at_work().begun {
            // The step that moves was kept; a goal that is missing makes a resume refuse, and no more.
            let _ = self.library.journal_goal(&self.instrument, to);
        }
    }
}

fn failed(error: impl ToString) -> JournalError {
    JournalError(error.to_string())
}

impl Journal for FileJournal {
    fn before_step(
        &self,
        _: &JobInfo,
        step: u64,
        state: &dyn Fn() -> Result<Vec<u8>, JournalError>,
    ) -> Result<(), JournalError> {
        let Some(scope) = self.scope.upgrade() else {
            return Ok(());
        };
        if self.at_work().lost.is_some() {
            return Ok(());
        }
        let kept = self.keep(&scope, step, state);
        let mut at_work = self.at_work();
        at_work.begun = kept.is_ok();
        if let Err(JournalError(why)) = kept {
            // A state that is older than the stage's place is worse than none. The job itself loses nothing.
            let _ = self.library.end_journal(&self.instrument);
            at_work.lost = Some(format!("{why}. If it is killed, this job cannot go on"));
        }
        Ok(())
    }

    fn kept(&self, _: &JobInfo, kept: &Kept) -> Result<(), JournalError> {
        match kept {
            Kept::Calibration(made) => {
                let z = made.focus_z_um.map(Length::from_um);
                let file = self.library.keep_calibration(
                    &self.instrument,
                    &made.calibration,
                    z,
                    made.residual_px,
                );
                let (file, lost) = match file {
                    Ok(file) => (Some(file), None),
                    Err(error) => (None, Some(error)),
                };
                let calibration = (**made).clone();
                self.at_work().made.push(Made { calibration, file });
                lost.map_or(Ok(()), |error| Err(failed(error)))
            }
            Kept::Set(set) => {
                let kept = self.library.keep_calibration_set(&self.instrument, set);
                kept.map(drop).map_err(failed)
            }
            Kept::Switching(report) => {
                let kept = self.library.keep_switching(&self.instrument, report);
                kept.map(drop).map_err(failed)
            }
            Kept::Shadows(seen) => {
                let kept = self.library.keep_shadows(&self.instrument, seen);
                kept.map(drop).map_err(failed)
            }
        }
    }

    /// An answer is nothing yet that outlives the program: what it was made of stays until [`FileJournal::close`].
    fn ended(&self, _: &JobInfo, how: &Ended) -> Result<(), JournalError> {
        self.at_work().begun = false;
        match how {
            Ended::Answered => Ok(()),
            Ended::Stopped { .. } | Ended::Failed { .. } => self.close().map_err(failed),
        }
    }
}

/// What was under way, for people.
pub fn what(left: &Journalled) -> String {
    let job = left.head.job.replace('_', " ");
    let of = match &left.head.target {
        Some([name, _]) => format!("{job} of {name}"),
        None => match left.head.inputs.get("name").and_then(Value::as_str) {
            Some(name) => format!("{job} {name}"),
            None => job,
        },
    };
    let objective = left.step.as_ref().and_then(|s| s.objective.as_ref());
    let at = objective.map_or(String::new(), |id| format!(" with {id}"));
    format!("{of}{at}, begun {},", left.head.began)
}

/// Where things stand: what was under way, where the stage should be and where it says it is.
pub fn standing(left: &Journalled, scope: &Instrument) -> String {
    let should = match &left.step {
        None => "nothing had moved for it".to_owned(),
        Some(step) => match left.goals.last() {
            None => format!("the stage should stand at {}", short(&step.stage)),
            Some(last) => format!(
                "the stage was sent from {} to {}",
                short(&step.stage),
                short(last)
            ),
        },
    };
    let says = match scope.gate().position() {
        Ok(at) => format!("it says {}", short(&at)),
        Err(error) => format!("it does not say where it is: {error}"),
    };
    format!(
        "{} was under way when the program ended; {should}; {says}",
        what(left)
    )
}

/// A place in few words: tilts are left out where there are none.
fn short(pose: &StagePose) -> String {
    let axes = Axis::ALL.iter().filter_map(|axis| {
        let si = pose.si(*axis)?;
        let tilt = matches!(axis, Axis::Rx | Axis::Ry);
        (!tilt || si.abs() > 1e-9).then(|| {
            let name = format!("{axis:?}").to_lowercase();
            format!("{name} = {}", shown(*axis, si))
        })
    });
    axes.collect::<Vec<_>>().join(", ")
}

/// Why the job cannot go on from where the stage is now; `None` when it can.
pub fn contradiction(left: &Journalled, scope: &Instrument) -> Option<String> {
    let step = left.step.as_ref()?;
    let gate = scope.gate();
    let now = match gate.position() {
        Ok(now) => now,
        Err(error) => return Some(error.to_string()),
    };
    if step.homed && !gate.is_homed().unwrap_or(false) {
        return Some(
            "the stage has lost its reference, so places of then and now are not the same".into(),
        );
    }
    for info in &gate.info().axes {
        let axis = info.axis;
        let (Some(then), Some(now)) = (step.stage.si(axis), now.si(axis)) else {
            continue;
        };
        let places = || left.goals.iter().filter_map(|g| g.si(axis)).chain([then]);
        let least = places().fold(f64::INFINITY, f64::min) - info.tolerance();
        let most = places().fold(f64::NEG_INFINITY, f64::max) + info.tolerance();
        if !(least..=most).contains(&now) {
            return Some(format!(
                "somebody moved the stage: {axis} should be between {} and {}, and is at {}",
                shown(axis, least),
                shown(axis, most),
                shown(axis, now)
            ));
        }
    }
    None
}

fn shown(axis: Axis, si: f64) -> String {
    let unit = axis.display_unit();
    match unit {
        "deg" => format!("{:.3} {unit}", si.to_degrees()),
        _ => format!("{:.1} {unit}", si * 1e6),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::{CancelToken, Clock, VirtualClock};
    use scopeservo_servo::Progress;
    use scopeservo_station::{JobError, News, Parts, Session, StationEvent, UseCase, Work};
    use scopeservo_twin::specimen::Tissue;
    use scopeservo_twin::{Config, Twin};
    use serde::Serialize;

    /// Moves once, and answers or fails.
    #[derive(Serialize)]
    struct Once {
        done: bool,
        fails: bool,
    }

    impl UseCase for Once {
        type Output = ();

        fn kind(&self) -> &'static str {
            "once"
        }

        fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<()>, JobError> {
            if self.done {
                return Ok(Progress::Done(()));
            }
            work.scope()
                .move_to(&StagePose::default().with_si(Axis::X, 1e-5))?;
            self.done = true;
            match self.fails {
                true => Err(JobError::Mistake { what: "it".into() }),
                false => Ok(Progress::Continue),
            }
        }
    }

    /// The worst moment to be killed at: the job has its answer, and nobody else has.
    #[test]
    fn a_job_is_in_the_journal_until_its_answer_is_kept() {
        let dir = tempfile::tempdir().unwrap();
        let library = Arc::new(Database::new(dir.path().into()));
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let twin = Twin::new(Config::noiseless(), Arc::new(Tissue::new(1)), 1, clock).unwrap();
        let scope = Instrument::new(twin.devices(), twin.rules(), CancelToken::new()).unwrap();
        let scope = Arc::new(scope);
        let journal = Arc::new(FileJournal::new(&library, "lab", &scope));
        let parts = Parts {
            journal: journal.clone(),
            ..Parts::default()
        };
        // What a program that is killed at the event of the end would leave.
        let (left, folder) = (Arc::new(Mutex::new(None)), library.clone());
        let at_end = left.clone();
        parts.bus.keep(Arc::new(move |record| {
            if let News::Station(StationEvent::JobEnded { .. }) = &record.news {
                *at_end.lock().unwrap() = folder.journal("lab").unwrap();
            }
        }));
        let session = Session::new(scope.clone(), parts);
        let lease = session.take_lease("test", None).unwrap();
        for fails in [false, true] {
            journal.comes("once", Asked::default());
            let job = Once { done: false, fails };
            let ended = session.start(&lease, job).unwrap().wait();
            assert_eq!(ended.is_err(), fails);
            let left: Option<Journalled> = left.lock().unwrap().take();
            assert_eq!(left.is_some(), !fails);
            if let Some(left) = left {
                // It goes on with its last step.
                assert_eq!(left.step.as_ref().unwrap().state["done"], true);
                assert_eq!(contradiction(&left, &scope), None);
            }
            journal.close().unwrap();
            assert_eq!(library.journal("lab").unwrap(), None);
        }
    }
}
