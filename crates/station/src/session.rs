//! One open instrument, and the jobs on it.

use crate::job::{Core, Slot};
use crate::lease::Leases;
use crate::line::Line;
use crate::{
    Bus, Ended, Job, JobError, JobHandle, JobId, JobInfo, JobState, Journal, JournalError, Lease,
    Listener, News, NoJournal, Pause, QuestionId, Questions, Refusal, StationEvent, UseCase, Work,
    lock,
};
use scopeservo_scope::{Clock, Instrument, ScopeError, SystemClock};
use scopeservo_servo::Progress;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
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

pub(crate) struct Shared {
    pub(crate) scope: Arc<Instrument>,
    pub(crate) bus: Bus,
    pub(crate) questions: Questions,
    pub(crate) journal: Arc<dyn Journal>,
    pub(crate) leases: Leases,
    line: Line,
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
        let core = shared.line.enter(|id| {
            let info = JobInfo {
                id,
                kind: case.kind().to_owned(),
                owner: lease.owner().to_owned(),
            };
            Core::new(info, lease, shared.scope.job_token())
        });
        let info = core.info.clone();
        shared.bus.station(StationEvent::JobQueued { info });
        let slot: Slot<U::Output> = Arc::default();
        let job = Job::new(JobHandle::new(core.clone(), shared), slot.clone());
        let of_thread = (shared.clone(), core.clone());
        let thread = thread::Builder::new().spawn(move || {
            let (shared, core) = of_thread;
            shared.carry_out(&core, case, &slot);
        });
        let thread = thread.map_err(|error| {
            shared.line.leave(&core);
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
        jobs.map(|core| JobHandle::new(core, &self.shared))
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

impl Shared {
    /// Stops one job, or everything. What moves for it is stopped from here too, should its thread hang in a device.
    pub(crate) fn stop(&self, one: Option<&Arc<Core>>) -> Result<(), ScopeError> {
        // No job begins meanwhile: it would be stopped in place of the one that is meant.
        let (_stopping, jobs) = self.line.stopping();
        let is_meant = |job: &Arc<Core>| one.is_none_or(|one| Arc::ptr_eq(one, job));
        for job in jobs.iter().filter(|job| is_meant(job)) {
            job.cancel.cancel();
        }
        let told = match one.is_none() || jobs.first().is_some_and(is_meant) {
            true => self.scope.gate().stop(),
            false => return Ok(()),
        };
        self.questions.cancel_all();
        for job in jobs.iter().filter(|job| is_meant(job)) {
            job.wake();
        }
        told
    }

    /// The whole life of a job, on its thread.
    fn carry_out<U: UseCase>(&self, core: &Arc<Core>, case: U, slot: &Slot<U::Output>) {
        let has_turn = self.line.wait_turn(core);
        let has_journal = has_turn && case.can_go_on();
        let result = match has_turn {
            false => Err(JobError::Stopped { at: None }),
            true => {
                self.bus.belongs_to(Some(core.info.id));
                catch_unwind(AssertUnwindSafe(|| self.run(core, case))).unwrap_or_else(|panic| {
                    // It may have been in the middle of a move; what went wrong is the news.
                    let _ = catch_unwind(AssertUnwindSafe(|| self.scope.gate().stop()));
                    Err(JobError::Mistake {
                        what: words(&*panic),
                    })
                })
            }
        };
        let how = Ended::of(&result);
        // A journal or a keeper that panics does not take the line with it.
        let _ = catch_unwind(AssertUnwindSafe(|| {
            if has_journal && let Err(error) = self.journal.ended(&core.info, &how) {
                self.not_kept(core, &error);
            }
            let (id, how) = (core.info.id, how.clone());
            self.bus.station(StationEvent::JobEnded { id, how });
        }));
        if has_turn {
            self.bus.belongs_to(None);
        }
        self.line.leave(core);
        *lock(slot) = Some(result);
        core.set(JobState::Ended(how));
    }

    fn run<U: UseCase>(&self, core: &Arc<Core>, mut case: U) -> Result<U::Output, JobError> {
        let _obeying = self.scope.obey(&core.cancel)?;
        self.scope.command_begins();
        core.set(JobState::Running);
        let info = core.info.clone();
        self.bus.station(StationEvent::JobBegan { info });
        let mut work = Work::new(self, core);
        let mut step = 0;
        loop {
            self.await_leave_to_go_on(core)?;
            let state = || serde_json::to_vec(&case).map_err(|e| JournalError(e.to_string()));
            if case.can_go_on() {
                self.journal.before_step(&core.info, step, &state)?;
            }
            if let Progress::Done(output) = case.step(&mut work)? {
                return Ok(output);
            }
            step += 1;
        }
    }

    /// Waits while somebody wants a pause or nobody has the lease; an error when a stop was asked for.
    fn await_leave_to_go_on(&self, core: &Core) -> Result<(), JobError> {
        let id = core.info.id;
        loop {
            self.scope.check_cancel()?;
            let lease = core.standing().lease;
            let is_held = self.leases.is_held(lease);
            let at = core.standing();
            let why = match (at.pause_asked, is_held || at.lease != lease) {
                (true, _) => Some(Pause::Asked),
                (false, false) => Some(Pause::LeaseLost),
                (false, true) => None,
            };
            let now = match why {
                Some(why) => JobState::Paused { why },
                None => JobState::Running,
            };
            if at.state != now {
                drop(at);
                core.set(now);
                self.bus.station(match why {
                    Some(why) => StationEvent::JobPaused { id, why },
                    None => StationEvent::JobResumed { id },
                });
            } else if why.is_none() {
                return Ok(());
            } else {
                drop(core.wait_change(at));
            }
        }
    }

    fn not_kept(&self, core: &Core, error: &JournalError) {
        let (id, why) = (core.info.id, error.to_string());
        self.bus.station(StationEvent::NotKept { id, why });
    }
}

/// What a panic said.
fn words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    text.unwrap_or_else(|| "it did not say what".into())
}
