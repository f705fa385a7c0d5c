//! A session, its jobs one after the other, and all that they tell to whoever drives them.

use scopeservo_scope::{Frame, Instrument};
use scopeservo_servo::FrameRole;
use scopeservo_station::{
    Bus, Job, JobError, JobState, News, Parts, Record, Session, StationEvent,
};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// So many frames wait to be shown at most.
const FRAMES: usize = 16;
/// How often one who hears nothing looks whether the job has ended.
const LOOK: Duration = Duration::from_millis(50);

/// What becomes of frames that come while as many wait as may. The target is never left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Late {
    /// They are not shown: the job waits for nobody.
    LeftOut,
    /// The job waits until they were taken: each is to be kept.
    WaitedFor,
}

/// What comes from a job's thread.
pub enum Told {
    /// What happened.
    Event(Arc<Record>),
    /// What was seen, and what for.
    Frame(Arc<Frame>, FrameRole),
}

/// Where it arrives.
struct Ears {
    /// In the order in which all happened; `None` is the next frame.
    told: Receiver<Option<Arc<Record>>>,
    frames: Receiver<(Arc<Frame>, FrameRole)>,
}

/// A session and one who listens to its jobs.
pub struct Console {
    ears: Mutex<Ears>,
    session: Arc<Session>,
}

impl Console {
    /// A session on the instrument, made of these parts. `at_once` hears every event on the thread that tells it.
    pub fn new(
        scope: &Arc<Instrument>,
        parts: Parts,
        late: Late,
        at_once: impl Fn(&Record) + Send + Sync + 'static,
    ) -> Self {
        let ears = Mutex::new(listen(&parts.bus, late, at_once));
        let session = Arc::new(Session::new(scope.clone(), parts));
        Self { ears, session }
    }

    /// The session, to start jobs and to stop them.
    pub fn session(&self) -> &Arc<Session> {
        &self.session
    }

    /// What was told so far is nobody's any more.
    pub fn forget(&self) {
        let ears = self.ears.lock().unwrap_or_else(PoisonError::into_inner);
        while let Ok(told) = ears.told.try_recv() {
            if told.is_none() {
                let _ = ears.frames.recv();
            }
        }
    }

    /// Hands on all that is told until a job of this session has ended.
    ///
    /// # Errors
    /// Those of the job.
    pub fn follow<T>(&self, job: Job<T>, mut hear: impl FnMut(Told)) -> Result<T, JobError> {
        let ears = self.ears.lock().unwrap_or_else(PoisonError::into_inner);
        let id = job.handle().id();
        loop {
            match ears.told.recv_timeout(LOOK) {
                Ok(None) => {
                    if let Ok((frame, role)) = ears.frames.recv() {
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
        drop(ears);
        job.wait()
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
