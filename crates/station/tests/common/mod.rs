//! A session on a simulated microscope with one objective, and a journal that can be waited at.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::allow_attributes_without_reason,
    reason = "each test file uses its own part of this module"
)]

use scopeservo_scope::{Axis, CancelToken, Clock, Instrument, StagePose, VirtualClock};
use scopeservo_servo::Progress;
use scopeservo_station::{
    Ended, Heard, JobError, JobInfo, Journal, JournalError, Listener, News, Parts, Record, Session,
    StationEvent, UseCase, Work,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Truth, Twin};
use serde::{Deserialize, Serialize};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Nothing in these tests takes so long, on any computer.
pub const LONG: Duration = Duration::from_secs(300);

pub struct Bench {
    pub twin: Twin,
    pub scope: Arc<Instrument>,
    /// Ends everything.
    pub cancel: CancelToken,
}

/// A place with tissue all over.
pub const PLACE_UM: [f64; 2] = [300.0, 100.0];

pub fn bench() -> Bench {
    let mut config = Config::realistic();
    config.optics = config.optics.split_off(2);
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(config, Arc::new(Tissue::new(7)), 5, clock.clone()).unwrap();
    let cancel = CancelToken::new();
    let scope = Instrument::new(twin.devices(), twin.rules(), cancel.clone()).unwrap();
    twin.centre_specimen(PLACE_UM, 0.0);
    Bench {
        twin,
        scope: Arc::new(scope),
        cancel,
    }
}

impl Bench {
    pub fn session(&self, journal: Arc<dyn Journal>) -> Session {
        let parts = Parts {
            journal,
            ..Parts::default()
        };
        Session::new(self.scope.clone(), parts)
    }

    /// True distance (um) and angle (deg) of the present view from `target`.
    pub fn error_from(&self, target: &Truth) -> (f64, f64) {
        let now = self.twin.truth_now();
        let d = [0, 1].map(|k| now.centre_um[k] - target.centre_um[k]);
        let turn = (now.angle_deg - target.angle_deg + 180.0).rem_euclid(360.0) - 180.0;
        (f64::hypot(d[0], d[1]), turn.abs())
    }
}

type Wanted = Box<dyn Fn(&JobInfo, u64, &str) -> bool + Send>;

/// A journal that waits before the step that somebody wants to see, and keeps all that it was told.
pub struct Watched {
    wanted: Mutex<Option<Wanted>>,
    reached: Mutex<Sender<()>>,
    go: Mutex<Receiver<()>>,
    /// Job, step and state.
    pub told: Mutex<Vec<(JobInfo, u64, String)>>,
    pub ended: Mutex<Vec<(JobInfo, Ended)>>,
}

/// The other end of it.
pub struct Hand {
    journal: Arc<Watched>,
    reached: Receiver<()>,
    go: Sender<()>,
}

impl Watched {
    pub fn new() -> (Arc<Self>, Hand) {
        let ((tell_reached, reached), (tell_go, go)) = (channel(), channel());
        let journal = Arc::new(Self {
            wanted: Mutex::new(None),
            reached: Mutex::new(tell_reached),
            go: Mutex::new(go),
            told: Mutex::default(),
            ended: Mutex::default(),
        });
        let hand = Hand {
            journal: journal.clone(),
            reached,
            go: tell_go,
        };
        (journal, hand)
    }

    pub fn last_state(&self) -> String {
        self.told.lock().unwrap().last().unwrap().2.clone()
    }
}

impl Hand {
    /// The journal will wait before the next step that is like that.
    pub fn wait_at(&self, wanted: impl Fn(&JobInfo, u64, &str) -> bool + Send + 'static) {
        *self.journal.wanted.lock().unwrap() = Some(Box::new(wanted));
    }
    /// Until it waits there.
    pub fn reached(&self) {
        self.reached.recv_timeout(LONG).unwrap();
    }
    pub fn go(&self) {
        self.go.send(()).unwrap();
    }
}

impl Journal for Watched {
    fn before_step(
        &self,
        job: &JobInfo,
        step: u64,
        state: &dyn Fn() -> Result<Vec<u8>, JournalError>,
    ) -> Result<(), JournalError> {
        let state = String::from_utf8(state()?).unwrap();
        let mut wanted = self.wanted.lock().unwrap();
        let waits = wanted.as_ref().is_some_and(|w| w(job, step, &state));
        if waits {
            *wanted = None;
        }
        drop(wanted);
        self.told.lock().unwrap().push((job.clone(), step, state));
        if waits {
            self.reached.lock().unwrap().send(()).unwrap();
            self.go.lock().unwrap().recv_timeout(LONG).unwrap();
        }
        Ok(())
    }
    fn ended(&self, job: &JobInfo, how: &Ended) -> Result<(), JournalError> {
        self.ended.lock().unwrap().push((job.clone(), how.clone()));
        Ok(())
    }
}

/// Goes there and back by 10 um, so many times; answers how many moves it made.
#[derive(Serialize, Deserialize)]
pub struct Walk {
    pub moves: u32,
    pub done: u32,
}

impl Walk {
    pub fn of(moves: u32) -> Self {
        Self { moves, done: 0 }
    }
}

impl UseCase for Walk {
    type Output = u32;

    fn kind(&self) -> &'static str {
        "walk"
    }

    fn step(&mut self, work: &mut Work<'_>) -> Result<Progress<u32>, JobError> {
        if self.done == self.moves {
            return Ok(Progress::Done(self.done));
        }
        let x = f64::from(self.done % 2) * 10e-6;
        let to = StagePose::default().with_si(Axis::X, x);
        work.scope().move_to(&to)?;
        self.done += 1;
        Ok(Progress::Continue)
    }
}

/// All that was told since the listener last looked, and how many events it missed.
pub fn drain(listener: &mut Listener) -> (Vec<Arc<Record>>, u64) {
    let (mut all, mut missed) = (Vec::new(), 0);
    while let Some(heard) = listener.heard() {
        match heard {
            Heard::Event(record) => all.push(record),
            Heard::Missed { events } => missed += events,
        }
    }
    (all, missed)
}

/// Waits for an event of the station.
pub fn wait_for<T>(listener: &mut Listener, pick: impl Fn(&StationEvent) -> Option<T>) -> T {
    loop {
        match listener.wait(LONG) {
            Some(Heard::Event(record)) => {
                if let News::Station(event) = &record.news
                    && let Some(found) = pick(event)
                {
                    return found;
                }
            }
            Some(Heard::Missed { .. }) => {}
            None => panic!("it was never told"),
        }
    }
}
