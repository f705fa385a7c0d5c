//! One open instrument, and the jobs on it.

use crate::control::Control;
use crate::job::Slot;
use crate::lease::Leases;
use crate::line::Line;
use crate::shared::Shared;
use crate::{
    Bus, Job, JobHandle, JobId, JobInfo, Journal, Lease, Listener, News, NoJournal, QuestionId,
    Questions, Refusal, StationEvent, UseCase, lock,
};
use scopeservo_scope::{Clock, Instrument, ScopeError, SystemClock};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// What a session is made with, beside the instrument.
pub struct Parts {
    /// Where all is told.
    pub bus: Bus,
    /// Questions to people; of the same bus.
    pub questions: Questions,
    /// Where the state of jobs is kept.
    pub journal: Arc<dyn Journal>,
    /// What leases are timed with: a monotonic clock, in the time of those who renew them.
    pub lease_clock: Arc<dyn Clock>,
}

impl Default for Parts {
    fn default() -> Self {
        let bus = Bus::default();
        Self {
            questions: Questions::new(bus.clone()),
            bus,
            journal: Arc::new(NoJournal),
            lease_clock: Arc::new(SystemClock::new()),
        }
    }
}

/// One open instrument. Any thread may use it; when it is dropped its jobs are stopped.
pub struct Session {
    shared: Arc<Shared>,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

impl Session {
    /// From now on every command to the instrument's gate is told on the bus.
    pub fn new(scope: Arc<Instrument>, parts: Parts) -> Self {
        let bus = parts.bus;
        bus.time_of(&scope);
        let ear = bus.clone();
        scope
            .gate()
            .observe(Some(Arc::new(move |event| ear.tell(News::Gate(event)))));
        Self {
            shared: Arc::new(Shared {
                scope,
                leases: Leases::new(parts.lease_clock, bus.clone()),
                bus,
                questions: parts.questions,
                journal: parts.journal,
                line: Line::default(),
            }),
            threads: Mutex::default(),
        }
    }

    /// The instrument, to look at: what moves it is a job.
    pub fn scope(&self) -> &Instrument {
        &self.shared.scope
    }

    /// Where all is told.
    pub fn bus(&self) -> &Bus {
        &self.shared.bus
    }

    /// Who hears what comes from now on. Needs no lease.
    pub fn listen(&self) -> Listener {
        self.shared.bus.listen()
    }

    /// Takes the right to move for so long, unless renewed; with `None` until it is given back, for a program that lives as long as
    /// the session.
    ///
    /// # Errors
    /// [`Refusal::Held`].
    pub fn take_lease(&self, owner: &str, lasting: Option<Duration>) -> Result<Lease, Refusal> {
        self.shared.leases.take(owner, lasting)
    }

    /// From now on the lease lasts so long.
    ///
    /// # Errors
    /// [`Refusal::LeaseLost`].
    pub fn renew(&self, lease: &Lease, lasting: Option<Duration>) -> Result<(), Refusal> {
        self.shared.leases.renew(lease, lasting)
    }

    /// Gives the right to move back. A job under way pauses before its next step.
    ///
    /// # Errors
    /// [`Refusal::LeaseLost`].
    pub fn give_back(&self, lease: &Lease) -> Result<(), Refusal> {
        self.shared.leases.give_back(lease)
    }

    /// Who has the right to move.
    pub fn owner(&self) -> Option<String> {
        self.shared.leases.owner()
    }

    /// Starts a job; it begins when those before it have ended.
    ///
    /// # Errors
    /// [`Refusal::LeaseLost`], [`Refusal::NoThread`].
    pub fn start<U: UseCase>(&self, lease: &Lease, case: U) -> Result<Job<U::Output>, Refusal> {
        let shared = &self.shared;
        shared.leases.check(lease)?;
        let control = shared.line.enter(|id| {
            let info = JobInfo {
                id,
                kind: case.kind().to_owned(),
                owner: lease.owner().to_owned(),
            };
            Control::new(info, lease, shared.scope.job_token())
        });
        let info = control.info.clone();
        shared.bus.station(StationEvent::JobQueued { info });
        let slot: Slot<U::Output> = Arc::default();
        let job = Job::new(JobHandle::new(control.clone(), shared), slot.clone());
        let of_thread = (shared.clone(), control.clone());
        let thread = thread::Builder::new().spawn(move || {
            let (shared, control) = of_thread;
            shared.carry_out(&control, case, &slot);
        });
        let thread = thread.map_err(|error| {
            shared.line.leave(&control);
            let why = error.to_string();
            Refusal::NoThread { why }
        })?;
        let mut threads = lock(&self.threads);
        threads.retain(|t| !t.is_finished());
        threads.push(thread);
        Ok(job)
    }

    /// Stops everything: the job under way, those that wait, and what moves. Needs no lease; the next job that is started runs normally.
    ///
    /// # Errors
    /// What a device answers that does not take the stop; the jobs were told all the same.
    pub fn stop(&self) -> Result<(), ScopeError> {
        let told = self.shared.stop(None);
        self.shared.bus.station(StationEvent::StopAsked);
        told
    }

    /// The job under way, and those that wait for their turn.
    pub fn jobs(&self) -> Vec<JobHandle> {
        let jobs = self.shared.line.jobs().into_iter();
        jobs.map(|control| JobHandle::new(control, &self.shared))
            .collect()
    }

    /// A job that is under way or waits.
    ///
    /// # Errors
    /// [`Refusal::NoSuchJob`].
    pub fn job(&self, id: JobId) -> Result<JobHandle, Refusal> {
        let mut jobs = self.jobs().into_iter();
        jobs.find(|job| job.id() == id)
            .ok_or(Refusal::NoSuchJob { id })
    }

    /// Questions that wait for an answer.
    pub fn questions(&self) -> &Questions {
        &self.shared.questions
    }

    /// Answers a question. Needs no lease: whoever stands at the microscope knows.
    ///
    /// # Errors
    /// [`Refusal::NoSuchQuestion`].
    pub fn answer(&self, id: QuestionId, yes: bool) -> Result<(), Refusal> {
        self.shared.questions.answer(id, yes)
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        for job in self.shared.line.jobs() {
            job.cancel.cancel();
            job.wake();
        }
        self.shared.questions.cancel_all();
        let threads = lock(&self.threads).drain(..).collect::<Vec<_>>();
        for thread in threads {
            // A job that holds the session itself cannot wait for its own end.
            if thread.thread().id() != thread::current().id() {
                let _ = thread.join();
            }
        }
        self.shared.scope.gate().observe(None);
    }
}
