//! The program at a station: a session that it alone works with, its jobs one after the other, and all that they tell.

use crate::error::CliError;
use crate::progress::Watcher;
use scopeservo_scope::{Frame, Instrument};
use scopeservo_servo::{FrameRole, Sink as _, Stamped};
use scopeservo_station::{
    Bus, JobState, Journal, Lease, News, Parts, Record, Session, StationEvent, UseCase,
};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::Duration;

/// So many frames wait to be shown at most.
const FRAMES: usize = 16;
/// How often one who hears nothing looks whether the job has ended.
const LOOK: Duration = Duration::from_millis(50);

/// What becomes of frames that come while as many wait as may. The target is never left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Late {
    /// They are not shown: the job waits for nobody.
    LeftOut,
    /// The job waits until they were taken: each is to be kept.
    WaitedFor,
}

/// What comes from a job's thread.
pub(crate) enum Told {
    Event(Arc<Record>),
    Frame(Arc<Frame>, FrameRole),
}

/// Where it arrives.
struct Ears {
    /// In the order in which all happened; `None` is the next frame.
    told: Receiver<Option<Arc<Record>>>,
    frames: Receiver<(Arc<Frame>, FrameRole)>,
}

/// A session with an owner that listens.
pub(crate) struct Console {
    ears: Ears,
    lease: Lease,
    session: Session,
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
        let ears = listen(&parts.bus, late, at_once);
        let session = Session::new(scope.clone(), parts);
        let lease = session
            .take_lease("scopeservo", None)
            .map_err(|e| CliError::Internal(e.to_string()))?;
        Ok(Self {
            ears,
            lease,
            session,
        })
    }

    /// Runs a job to its end, and hands on all that it tells. The inner error is the job's.
    pub(crate) fn follow<U: UseCase>(
        &self,
        case: U,
        mut hear: impl FnMut(Told),
    ) -> Result<Result<U::Output, CliError>, CliError> {
        let job = self.session.start(&self.lease, case);
        let job = job.map_err(|e| CliError::Internal(e.to_string()))?;
        let id = job.handle().id();
        loop {
            match self.ears.told.recv_timeout(LOOK) {
                Ok(None) => {
                    if let Ok((frame, role)) = self.ears.frames.recv() {
                        hear(Told::Frame(frame, role));
                    }
                }
                Ok(Some(record)) => {
                    let is_end = matches!(
                        &record.news,
                        News::Station(StationEvent::JobEnded { id: ended, .. }) if *ended == id
                    );
                    hear(Told::Event(record));
                    if is_end {
                        break;
                    }
                }
                Err(RecvTimeoutError::Timeout) => {
                    if let JobState::Ended(_) = job.state() {
                        break;
                    }
                }
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        Ok(job.wait().map_err(CliError::from))
    }
}

impl Told {
    /// Shows it, where it is of a procedure.
    pub(crate) fn show(&self, watcher: &mut Watcher) {
        match self {
            Self::Frame(frame, role) => watcher.frame(frame, *role),
            Self::Event(record) => {
                if let News::Procedure(event) = &record.news {
                    watcher.event(Stamped {
                        time_s: record.time_s,
                        event: (**event).clone(),
                    });
                }
            }
        }
    }
}

/// Hands on all events, and frames as far as they are taken.
fn listen(bus: &Bus, late: Late, at_once: impl Fn(&Record) + Send + Sync + 'static) -> Ears {
    let (tell, told) = mpsc::channel();
    let (show, frames) = mpsc::sync_channel(FRAMES);
    let coming = tell.clone();
    bus.keep(Arc::new(move |record| {
        at_once(record);
        let _ = tell.send(Some(record.clone()));
    }));
    bus.keep_frames(Arc::new(move |frame, role| {
        let shown = (frame.clone(), role);
        let is_taken = match late == Late::WaitedFor || role == FrameRole::Target {
            true => show.send(shown).is_ok(),
            false => show.try_send(shown).is_ok(),
        };
        if is_taken {
            let _ = coming.send(None);
        }
    }));
    Ears { told, frames }
}
