//! A front end of a few lines, in a file of its own: it starts a job, shows what is told as lines, answers what is asked, and says how it ended.

use scopeservo_scope::{
    CancelToken, Clock, Devices, GateEvent, Instrument, Motion, Nosepiece, Objective, ObjectiveId,
    ScopeError, VirtualClock,
};
use scopeservo_servo::{Event, FocusOptions, RepositionOptions, ServoOptions, Verdict};
use scopeservo_station::jobs::{
    Answer, AnyJob, RepositionInput, RepositionJob, Request, SaveTargetInput,
};
use scopeservo_station::{
    Ask, Heard, JobError, Lease, News, Parts, QuestionKind, Session, StationEvent,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Twin};
use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Duration;

/// Who sits at it: a page that grows, and somebody at the microscope.
struct FrontEnd<'a> {
    session: &'a Session,
    lease: &'a Lease,
    page: String,
}

impl FrontEnd<'_> {
    /// Runs a job to its end.
    fn run(&mut self, job: AnyJob) -> Result<Answer, JobError> {
        let mut ear = self.session.listen();
        let job = self.session.start(self.lease, job).unwrap();
        loop {
            let record = match ear.wait(Duration::from_secs(60)) {
                Some(Heard::Event(record)) => record,
                Some(Heard::Missed { events }) => {
                    self.line(format_args!("({events} events were too fast)"));
                    continue;
                }
                None => continue,
            };
            match &record.news {
                News::Procedure(event) => self.show(event),
                News::Gate(GateEvent::ChangeBegan { to }) => self.line(format_args!("to {to}")),
                News::Gate(_) => {}
                News::Station(StationEvent::Asked { question }) => {
                    if let QuestionKind::TurnNosepiece { objective } = &question.kind {
                        self.line(format_args!("please turn the nosepiece to {objective}"));
                    }
                    self.session.answer(question.id, true).unwrap();
                }
                News::Station(StationEvent::JobEnded { id, .. }) if *id == job.id() => break,
                News::Station(_) => {}
            }
        }
        job.wait()
    }

    fn show(&mut self, event: &Event) {
        match event {
            Event::PhaseStarted { phase, objective } => {
                self.line(format_args!("{phase:?} with {objective}"));
            }
            Event::Iteration {
                iteration, error, ..
            } => self.line(format_args!("{iteration}: {:.2} um", error.distance_um())),
            Event::Finished { outcome } => self.line(format_args!("{}", outcome.message)),
            _ => {}
        }
    }

    fn line(&mut self, words: std::fmt::Arguments<'_>) {
        writeln!(self.page, "{words}").unwrap();
    }
}

/// The simulated nosepiece, turned when somebody says that it may be.
struct ByHand(Box<dyn Nosepiece>, Ask);

impl Nosepiece for ByHand {
    fn objectives(&self) -> &[Objective] {
        self.0.objectives()
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        self.0.current()
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        let objective = self.objectives().iter().find(|o| o.id == *to);
        assert!((self.1)(objective.unwrap(), &|| true), "nobody turned it");
        self.0.start_change(to)
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        self.0.poll()
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.0.stop()
    }
}

#[test]
fn a_front_end_is_one_file() {
    let mut config = Config::realistic();
    config.optics.remove(1);
    let best = config.optics[1].id.clone();
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(config, Arc::new(Tissue::new(7)), 5, clock).unwrap();
    let parts = Parts::default();
    let devices = Devices {
        nosepiece: Some(Box::new(ByHand(twin.nosepiece(), parts.questions.asker()))),
        ..twin.devices()
    };
    let scope = Instrument::new(devices, twin.rules(), CancelToken::new()).unwrap();
    twin.centre_specimen([300.0, 100.0], 0.0);
    let session = Session::new(Arc::new(scope), parts);
    let lease = session.take_lease("front end", None).unwrap();
    let mut front_end = FrontEnd {
        session: &session,
        lease: &lease,
        page: String::new(),
    };

    let save = Request::SaveTarget(SaveTargetInput {
        objective: Some(best.clone()),
        focus: Some(FocusOptions::default()),
        ..SaveTargetInput::default()
    });
    let save = AnyJob::new(save, |id| Err(id.to_owned())).unwrap();
    let Ok(Answer::SaveTarget(saved)) = front_end.run(save) else {
        panic!("{}", front_end.page);
    };
    twin.remount([300.0, 100.0], [120.0, -80.0], 2.0, false);
    let input = RepositionInput {
        target_id: "mitosis-3".into(),
        options: RepositionOptions {
            servo: ServoOptions {
                lambda: 0.7,
                ..ServoOptions::default()
            },
            ..RepositionOptions::default()
        },
        ..RepositionInput::default()
    };
    let job = RepositionJob::new(saved.target, input);
    let Ok(Answer::Reposition(back)) = front_end.run(AnyJob::Reposition(Box::new(job))) else {
        panic!("{}", front_end.page);
    };

    let page = front_end.page;
    assert_eq!(back.outcome.verdict, Verdict::Arrived, "{page}");
    let asked = format!("please turn the nosepiece to {best}\nto {best}\n");
    assert_eq!(page.matches(&asked).count(), 2, "{page}");
    let last = page.lines().last();
    assert_eq!(last, Some(back.outcome.message.as_str()), "{page}");
    assert!(
        page.lines().filter(|l| l.ends_with(" um")).count() > 3,
        "{page}"
    );
}
