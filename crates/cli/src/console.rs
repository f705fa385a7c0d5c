//! The program at a station: a session that it alone works with.

use crate::error::CliError;
use crate::progress::Watcher;
use scopeservo_scope::Instrument;
use scopeservo_servo::{Sink as _, Stamped};
use scopeservo_station::{Journal, Lease, News, Parts, Record, UseCase};
use scopeservo_workbench::{self as workbench, Late, Told};
use std::sync::Arc;

/// A session with an owner that listens.
pub(crate) struct Console {
    console: workbench::Console,
    lease: Lease,
}

impl Console {
    /// `at_once` hears every event on the thread that tells it.
    pub(crate) fn new(
        scope: &Arc<Instrument>,
        journal: Arc<dyn Journal>,
        late: Late,
        at_once: impl Fn(&Record) + Send + Sync + 'static,
    ) -> Result<Self, CliError> {
        let parts = Parts {
            journal,
            ..Parts::default()
        };
        let console = workbench::Console::new(scope, parts, late, at_once);
        let lease = console
            .session()
            .take_lease("scopeservo", None)
            .map_err(|e| CliError::Internal(e.to_string()))?;
        Ok(Self { console, lease })
    }

    /// Runs a job to its end, and hands on all that it tells. The inner error is the job's.
    pub(crate) fn follow<U: UseCase>(
        &self,
        case: U,
        hear: impl FnMut(Told),
    ) -> Result<Result<U::Output, CliError>, CliError> {
        let job = self.console.session().start(&self.lease, case);
        let job = job.map_err(|e| CliError::Internal(e.to_string()))?;
        Ok(self.console.follow(job, hear).map_err(CliError::from))
    }
}

/// Shows what was told, where it is of a procedure.
pub(crate) fn hand_on(told: &Told, watcher: &mut Watcher) {
    match told {
        Told::Frame(frame, role) => watcher.frame(frame, *role),
        Told::Event(record) => {
            if let News::Procedure(event) = &record.news {
                watcher.event(Stamped {
                    time_s: record.time_s,
                    event: (**event).clone(),
                });
            }
        }
    }
}
