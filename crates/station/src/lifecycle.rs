//! The life of a job, on its thread: its turn, its steps, and its end.

use crate::control::Control;
use crate::job::Slot;
use crate::shared::Shared;
use crate::{Ended, JobError, JobState, JournalError, Pause, StationEvent, UseCase, Work, lock};
use scopeservo_servo::Progress;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;

impl Shared {
    /// The whole life of a job, on its thread.
    pub(crate) fn carry_out<U: UseCase>(
        &self,
        control: &Arc<Control>,
        case: U,
        slot: &Slot<U::Output>,
    ) {
        let has_turn = self.line.wait_turn(control);
        let has_journal = has_turn && case.can_go_on();
        let result = match has_turn {
            false => Err(JobError::Stopped { at: None }),
            true => {
                self.bus.belongs_to(Some(control.info.id));
                catch_unwind(AssertUnwindSafe(|| self.run(control, case))).unwrap_or_else(|panic| {
                    // It may have been in the middle of a move; what went wrong is the news.
                    let _ = catch_unwind(AssertUnwindSafe(|| self.scope.gate().stop()));
                    Err(JobError::Mistake {
                        what: words(&*panic),
                    })
                })
            }
        };
        let how = ended(&result);
        // A journal or a keeper that panics does not take the line with it.
        let _ = catch_unwind(AssertUnwindSafe(|| {
            if has_journal && let Err(error) = self.journal.ended(&control.info, &how) {
                self.not_kept(control, &error);
            }
            let (id, how) = (control.info.id, how.clone());
            self.bus.station(StationEvent::JobEnded { id, how });
        }));
        if has_turn {
            self.bus.belongs_to(None);
        }
        self.line.leave(control);
        *lock(slot) = Some(result);
        control.set(JobState::Ended(how));
    }

    fn run<U: UseCase>(&self, control: &Arc<Control>, mut case: U) -> Result<U::Output, JobError> {
        let _obeying = self.scope.obey(&control.cancel)?;
        self.scope.command_begins();
        control.set(JobState::Running);
        let info = control.info.clone();
        self.bus.station(StationEvent::JobBegan { info });
        let ended = catch_unwind(AssertUnwindSafe(|| self.steps(control, &mut case)));
        case.leave(&self.scope);
        ended.unwrap_or_else(|panic| resume_unwind(panic))
    }

    fn steps<U: UseCase>(
        &self,
        control: &Arc<Control>,
        case: &mut U,
    ) -> Result<U::Output, JobError> {
        let mut work = Work::new(self, control);
        let mut step = 0;
        loop {
            self.await_leave_to_go_on(control)?;
            let state = || serde_json::to_vec(case).map_err(|e| JournalError(e.to_string()));
            if case.can_go_on() {
                self.journal.before_step(&control.info, step, &state)?;
            }
            if let Progress::Done(output) = case.step(&mut work)? {
                return Ok(output);
            }
            step += 1;
        }
    }

    /// Waits while somebody wants a pause or nobody has the lease; an error when a stop was asked for.
    fn await_leave_to_go_on(&self, control: &Control) -> Result<(), JobError> {
        let id = control.info.id;
        loop {
            self.scope.check_cancel()?;
            let lease = control.standing().lease;
            let is_held = self.leases.is_held(lease);
            let at = control.standing();
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
                control.set(now);
                self.bus.station(match why {
                    Some(why) => StationEvent::JobPaused { id, why },
                    None => StationEvent::JobResumed { id },
                });
            } else if why.is_none() {
                return Ok(());
            } else {
                drop(control.wait_change(at));
            }
        }
    }
}

/// What a panic said.
fn words(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
    text.unwrap_or_else(|| "it did not say what".into())
}

/// How a job ended that has this answer, or none.
fn ended<T>(result: &Result<T, JobError>) -> Ended {
    match result {
        Ok(_) => Ended::Answered,
        Err(JobError::Stopped { at }) => Ended::Stopped { at: *at },
        Err(error) => Ended::Failed {
            message: error.to_string(),
            kind: Some(error.kind()),
        },
    }
}
