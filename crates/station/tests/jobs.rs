//! Owners, stops, pauses, questions, journals: with jobs of a few lines.

mod common;

use common::{LONG, PLACE_UM, Walk, Watched, bench, drain, wait_for};
use scopeservo_scope::{
    CancelToken, Clock, Immersion, ImmersionChange, Instrument, Objective, ObjectiveId,
    VirtualClock,
};
use scopeservo_servo::{FocusOptions, Progress};
use scopeservo_station::jobs::{SaveTargetInput, SaveTargetJob};
use scopeservo_station::{
    Ended, JobError, JobInfo, JobState, Journal, JournalError, News, NoJournal, Parts, Pause,
    QuestionKind, Refusal, Session, StationEvent, UseCase, Work,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Twin};
use serde::Serialize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

fn at_step(wanted: u64) -> impl Fn(&JobInfo, u64, &str) -> bool + Send + 'static {
    move |_, step, _| step == wanted
}

#[test]
fn a_lease_that_expires_pauses_the_job_until_the_next_owner_resumes_it() {
    let bench = bench();
    let clock = Arc::new(VirtualClock::new());
    let (journal, hand) = Watched::new();
    let parts = Parts {
        journal,
        lease_clock: clock.clone(),
        ..Parts::default()
    };
    let session = Session::new(bench.scope.clone(), parts);
    let minute = Some(Duration::from_secs(60));
    let ada = session.take_lease("Ada", minute).unwrap();
    let mut ear = session.listen();
    hand.wait_at(at_step(2));
    let job = session.start(&ada, Walk::of(5)).unwrap();
    hand.reached();
    let refused = session.take_lease("Bob", minute);
    assert!(
        matches!(&refused, Err(Refusal::Held { owner, .. }) if owner == "Ada"),
        "{refused:?}"
    );
    clock.sleep(Duration::from_secs(61));
    hand.go();
    // The step under way ends, and no other begins.
    let why = wait_for(&mut ear, |e| match e {
        StationEvent::JobPaused { why, .. } => Some(*why),
        _ => None,
    });
    assert_eq!(why, Pause::LeaseLost);
    assert_eq!(job.state(), JobState::Paused { why });
    assert_eq!(bench.scope.counters().moves, 3);
    assert_eq!(session.owner(), None);
    assert!(matches!(
        session.start(&ada, Walk::of(1)).err(),
        Some(Refusal::LeaseLost { .. })
    ));
    assert!(job.resume(&ada).is_err());
    let bob = session.take_lease("Bob", minute).unwrap();
    job.resume(&bob).unwrap();
    assert_eq!(job.wait().unwrap(), 5);
}

#[test]
fn a_stop_needs_no_lease_and_the_next_job_runs_normally() {
    let bench = bench();
    let (journal, hand) = Watched::new();
    let session = bench.session(journal.clone());
    let ada = session.take_lease("Ada", None).unwrap();
    hand.wait_at(at_step(2));
    let first = session.start(&ada, Walk::of(1000)).unwrap();
    let second = session.start(&ada, Walk::of(1000)).unwrap();
    let third = session.start(&ada, Walk::of(4)).unwrap();
    hand.reached();
    assert_eq!(first.state(), JobState::Running);
    assert_eq!(second.state(), JobState::Queued);
    // One that waits, and the one under way; neither takes the third with it.
    second.stop().unwrap();
    assert!(matches!(second.wait(), Err(JobError::Stopped { at: None })));
    let before = bench.scope.counters().moves;
    first.stop().unwrap();
    hand.go();
    let ended = first.wait();
    assert!(
        matches!(ended, Err(JobError::Stopped { at: Some(_) })),
        "{ended:?}"
    );
    assert_eq!(third.wait().unwrap(), 4);
    assert_eq!(bench.scope.counters().moves, before + 4);
    // A stop of everything takes those that wait as well, and a stop of nothing is harmless.
    hand.wait_at(at_step(1));
    let (fourth, fifth) = (
        session.start(&ada, Walk::of(9)).unwrap(),
        session.start(&ada, Walk::of(9)).unwrap(),
    );
    hand.reached();
    session.stop().unwrap();
    hand.go();
    assert!(fourth.wait().is_err() && fifth.wait().is_err());
    session.stop().unwrap();
    assert_eq!(session.start(&ada, Walk::of(2)).unwrap().wait().unwrap(), 2);
    // The instrument's own token still ends everything.
    bench.cancel.cancel();
    assert!(matches!(
        session.start(&ada, Walk::of(2)).unwrap().wait(),
        Err(JobError::Stopped { .. })
    ));
}

#[test]
fn a_job_pauses_between_steps_and_goes_on() {
    let bench = bench();
    let (journal, hand) = Watched::new();
    let session = bench.session(journal.clone());
    let ada = session.take_lease("Ada", None).unwrap();
    let mut ear = session.listen();
    hand.wait_at(at_step(1));
    let job = session.start(&ada, Walk::of(3)).unwrap();
    hand.reached();
    job.pause();
    hand.go();
    let why = wait_for(&mut ear, |e| match e {
        StationEvent::JobPaused { why, .. } => Some(*why),
        _ => None,
    });
    assert_eq!(why, Pause::Asked);
    assert_eq!(bench.scope.counters().moves, 2);
    assert!(!job.wait_timeout(Duration::ZERO));
    job.resume(&ada).unwrap();
    assert_eq!(job.wait().unwrap(), 3);
    assert_eq!(journal.ended.lock().unwrap()[0].1, Ended::Answered);
    // Commands to the gate were told with the job that gave them.
    let bench_moves = bench.scope.counters().moves;
    let (all, missed) = drain(&mut session.bus().listen_from(0));
    assert_eq!(missed, 0);
    let of_gate = all.iter().filter(|r| matches!(r.news, News::Gate(_)));
    // Asked, begun, arrived.
    assert_eq!(of_gate.clone().count() as u64, 3 * bench_moves);
    assert!(of_gate.clone().all(|r| r.job.is_some()));
}

/// Asks, and answers what was said.
#[derive(Serialize)]
struct Asks;

impl UseCase for Asks {
    type Output = bool;

    fn kind(&self) -> &'static str {
        "asks"
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<bool>, JobError> {
        let text = "is 40x in?".into();
        work.ask(QuestionKind::Confirm { text }).map(Progress::Done)
    }
}

#[test]
fn a_question_is_answered_from_another_thread_or_cancelled_by_a_stop() {
    let bench = bench();
    let session = bench.session(Arc::new(NoJournal));
    let ada = session.take_lease("Ada", None).unwrap();
    let mut ear = session.listen();
    let asked = |e: &StationEvent| match e {
        StationEvent::Asked { question } => Some(question.clone()),
        _ => None,
    };
    for yes in [true, false] {
        let job = session.start(&ada, Asks).unwrap();
        let question = wait_for(&mut ear, asked);
        assert_eq!(question.job, Some(job.id()));
        assert_eq!(job.state(), JobState::Asking);
        assert_eq!(session.questions().open(), std::slice::from_ref(&question));
        std::thread::scope(|s| s.spawn(|| session.answer(question.id, yes)).join().unwrap())
            .unwrap();
        assert_eq!(job.wait().unwrap(), yes);
        // The first answer counts.
        assert!(session.answer(question.id, !yes).is_err());
    }
    let job = session.start(&ada, Asks).unwrap();
    let question = wait_for(&mut ear, asked);
    session.stop().unwrap();
    assert!(matches!(job.wait(), Err(JobError::Stopped { .. })));
    let late = session.answer(question.id, true);
    assert_eq!(late, Err(Refusal::NoSuchQuestion { id: question.id }));
    wait_for(&mut ear, |e| {
        let cancelled = StationEvent::QuestionCancelled { id: question.id };
        (*e == cancelled).then_some(())
    });
}

#[test]
fn a_nosepiece_that_is_turned_by_hand_asks_over_the_station() {
    let questions = Parts::default().questions;
    let ask = questions.asker();
    let objective = Objective {
        id: ObjectiveId("40x".into()),
        magnification: 400.0,
        numerical_aperture: 0.65,
        nominal_um_per_px: 0.2,
        immersion: Immersion::Air,
    };
    let wanted = AtomicBool::new(true);
    std::thread::scope(|s| {
        let asked = s.spawn(|| ask(&objective, &|| wanted.load(Ordering::SeqCst)));
        let question = loop {
            if let Some(question) = questions.open().pop() {
                break question;
            }
            std::thread::yield_now();
        };
        let kind = QuestionKind::TurnNosepiece {
            objective: ObjectiveId("40x".into()),
        };
        assert_eq!(question.kind, kind);
        questions.answer(question.id, true).unwrap();
        assert!(asked.join().unwrap());
        // Stopped by the nosepiece: nobody waits for the answer any more.
        wanted.store(false, Ordering::SeqCst);
        let asked = s.spawn(|| ask(&objective, &|| wanted.load(Ordering::SeqCst)));
        assert!(!asked.join().unwrap());
        assert!(questions.open().is_empty());
    });
}

#[test]
fn another_medium_is_asked_about_over_the_station() {
    let questions = Parts::default().questions;
    let ask = questions.immersion_asker();
    let change = ImmersionChange {
        objective: ObjectiveId("100x".into()),
        to: Immersion::Oil,
        from: [Immersion::Air].into(),
    };
    for yes in [true, false] {
        std::thread::scope(|s| {
            let asked = s.spawn(|| ask(&change, &|| true));
            let question = loop {
                if let Some(question) = questions.open().pop() {
                    break question;
                }
                std::thread::yield_now();
            };
            let kind = QuestionKind::ChangeImmersion {
                change: change.clone(),
            };
            assert_eq!(question.kind, kind);
            let told = serde_json::to_value(&question).unwrap();
            assert_eq!(told["change"]["to"], "oil", "{told}");
            questions.answer(question.id, yes).unwrap();
            assert_eq!(asked.join().unwrap(), yes);
        });
    }
}

#[derive(Serialize)]
struct Panics {
    #[serde(skip)]
    left: Arc<AtomicBool>,
}

impl UseCase for Panics {
    type Output = ();

    fn kind(&self) -> &'static str {
        "panics"
    }

    fn step(&mut self, _: &mut Work<'_>) -> Result<Progress<()>, JobError> {
        panic!("two is three")
    }

    fn leave(&mut self, _: &Instrument) {
        self.left.store(true, Ordering::SeqCst);
    }
}

#[test]
fn a_job_that_panics_has_ended_with_an_error_and_the_session_lives_on() {
    let bench = bench();
    let session = bench.session(Arc::new(NoJournal));
    let ada = session.take_lease("Ada", None).unwrap();
    let left = Arc::new(AtomicBool::new(false));
    let panics = Panics { left: left.clone() };
    let ended = session.start(&ada, panics).unwrap().wait();
    assert!(
        left.load(Ordering::SeqCst),
        "the camera is left as it was found"
    );
    assert!(
        matches!(&ended, Err(JobError::Mistake { what }) if what == "two is three"),
        "{ended:?}"
    );
    assert!(session.jobs().is_empty());
    assert_eq!(session.start(&ada, Walk::of(2)).unwrap().wait().unwrap(), 2);
}

/// A journal whose disk is full from some step on; tells how many moves were made before each step.
struct Full {
    from: u64,
    scope: Arc<scopeservo_scope::Instrument>,
    moves: Mutex<Vec<u64>>,
}

impl Journal for Full {
    fn before_step(
        &self,
        _: &JobInfo,
        step: u64,
        state: &dyn Fn() -> Result<Vec<u8>, JournalError>,
    ) -> Result<(), JournalError> {
        let moves = self.scope.counters().moves;
        let text = String::from_utf8(state()?).unwrap();
        assert_eq!(text, format!("{{\"moves\":5,\"done\":{step}}}"));
        self.moves.lock().unwrap().push(moves);
        match step < self.from {
            true => Ok(()),
            false => Err(JournalError("the disk is full".into())),
        }
    }
    fn ended(&self, _: &JobInfo, _: &Ended) -> Result<(), JournalError> {
        Err(JournalError("the disk is full".into()))
    }
}

#[test]
fn the_journal_is_told_before_each_step_and_one_that_fails_ends_the_job_before_anything_moves() {
    for (from, moves) in [(0, 0), (3, 3), (99, 5)] {
        let bench = bench();
        let journal = Arc::new(Full {
            from,
            scope: bench.scope.clone(),
            moves: Mutex::default(),
        });
        let session = bench.session(journal.clone());
        let ada = session.take_lease("Ada", None).unwrap();
        let mut ear = session.listen();
        let job = session.start(&ada, Walk::of(5)).unwrap();
        assert!(job.wait_timeout(LONG));
        let ended = job.wait();
        match from {
            99 => assert_eq!(ended.unwrap(), 5),
            _ => assert!(matches!(&ended, Err(JobError::Journal(_))), "{ended:?}"),
        }
        assert_eq!(bench.scope.counters().moves, moves);
        let told = journal.moves.lock().unwrap();
        assert_eq!(*told, (0..=moves).collect::<Vec<u64>>());
        // What only concerns the end is a warning.
        wait_for(&mut ear, |e| {
            matches!(e, StationEvent::NotKept { .. }).then_some(())
        });
    }
}

#[test]
fn a_stop_of_one_job_never_reaches_the_next_whenever_it_comes() {
    let bench = bench();
    let session = bench.session(Arc::new(NoJournal));
    let ada = session.take_lease("Ada", None).unwrap();
    for delay in 0..40 {
        let stopped = session.start(&ada, Walk::of(10)).unwrap();
        let next = session.start(&ada, Walk::of(10)).unwrap();
        let handle = stopped.handle().clone();
        std::thread::scope(|s| {
            // From three threads, early in the job, late, and after its end.
            for _ in 0..3 {
                s.spawn(|| {
                    let started = || bench.scope.counters().moves % 20;
                    while started() < delay % 12 && !handle.wait_timeout(Duration::ZERO) {
                        std::thread::yield_now();
                    }
                    handle.stop().unwrap();
                });
            }
        });
        match stopped.wait() {
            Ok(moves) => assert_eq!(moves, 10),
            Err(error) => assert!(matches!(error, JobError::Stopped { .. }), "{error}"),
        }
        assert_eq!(next.wait().unwrap(), 10, "delay {delay}");
    }
}

/// Between two steps, while a job is paused or its program is killed, anybody may turn the nosepiece.
#[test]
fn a_view_is_saved_with_the_objective_that_was_brought_whichever_is_turned_in_meanwhile() {
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(Config::realistic(), Arc::new(Tissue::new(7)), 5, clock).unwrap();
    let scope = Instrument::new(twin.devices(), twin.rules(), CancelToken::new()).unwrap();
    let scope = Arc::new(scope);
    twin.centre_specimen(PLACE_UM, 0.0);
    let (journal, hand) = Watched::new();
    let parts = Parts {
        journal,
        ..Parts::default()
    };
    let session = Session::new(scope.clone(), parts);
    let ada = session.take_lease("Ada", None).unwrap();
    let [lowest, wanted] = ["10x", "40x"].map(|id| ObjectiveId(id.into()));
    hand.wait_at(|_, _, state| state.contains("\"state\":{\"save\":"));
    let job = SaveTargetJob::new(SaveTargetInput {
        objective: Some(wanted.clone()),
        focus: Some(FocusOptions::default()),
        still: true,
        ..SaveTargetInput::default()
    });
    let job = session.start(&ada, job).unwrap();
    hand.reached();
    scope.select_objective(&lowest).unwrap();
    hand.go();
    let saved = job.wait().unwrap();
    assert_eq!(saved.target.objective, wanted);
    assert_eq!(scope.gate().current_objective(), Ok(Some(wanted)));
}
