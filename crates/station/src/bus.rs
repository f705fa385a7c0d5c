//! Events and frames, from one who works to any number who listen.
//!
//! A listener who never reads cannot keep every event in memory and never lose one. So events stand once, in one log of
//! [`LOG_BYTES`] that all listeners share and read by a cursor: a listener costs a number. Who falls behind the log is told how
//! many events were missed, never silently: [`Heard::Missed`]. Whoever has to have every event, as the library of runs, is the bus' one
//! [`Keeper`], which is handed each as it happens and keeps it elsewhere.
//!
//! Frames are never queued. The bus holds the newest one while somebody watches, by an `Arc` and without a copy; who is slow sees
//! fewer. The publisher waits for nobody and encodes nothing.

use crate::lock;
use crate::news::{News, Record};
use crate::{JobId, StationEvent};
use scopeservo_scope::{Frame, Instrument};
use scopeservo_servo::{FrameRole, Sink, Stamped};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError, Weak};
use std::time::Duration;

/// What the log of recent events takes at most, about: half of a run over three objectives.
pub const LOG_BYTES: usize = 512 << 10;

/// Is handed every event in order, on the thread that told it: it must take it at once (send it to a thread of its own), neither
/// encode nor write it there, and publish nothing.
pub type Keeper = Arc<dyn Fn(&Arc<Record>) + Send + Sync>;

/// Is handed every frame, as a [`Keeper`] is every event. Who keeps frames bounds how many.
pub type FrameKeeper = Arc<dyn Fn(&Arc<Frame>, FrameRole) + Send + Sync>;

/// The way from a session to those who listen. Clones are the same bus.
#[derive(Clone)]
pub struct Bus(Arc<Shared>);

struct Shared {
    log: Mutex<Log>,
    news: Condvar,
    /// Held while an event is told, so that the keeper hears all in order.
    keeper: Mutex<Option<Keeper>>,
    frame_keeper: Mutex<Option<FrameKeeper>>,
    /// Listeners who have asked for a frame.
    watching: AtomicUsize,
    /// Whose clock the time is of.
    instrument: Mutex<Option<Weak<Instrument>>>,
}

struct Log {
    recent: VecDeque<Arc<Record>>,
    /// The number of the event that comes.
    next: u64,
    bytes: usize,
    most_bytes: usize,
    job: Option<JobId>,
    /// Frames that came.
    frames: u64,
    newest: Option<(Arc<Frame>, FrameRole)>,
}

/// What a listener hears.
#[derive(Debug, Clone, PartialEq)]
pub enum Heard {
    /// The next event.
    Event(Arc<Record>),
    /// The listener was slower than the log is long: so many events are gone, and the next one comes after them.
    Missed {
        /// How many.
        events: u64,
    },
}

/// The newest frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Shown {
    /// The frame.
    pub frame: Arc<Frame>,
    /// What it was grabbed for.
    pub role: FrameRole,
    /// Frames that came since this listener last looked, and that it did not see.
    pub missed: u64,
}

impl Default for Bus {
    fn default() -> Self {
        Self::new(LOG_BYTES)
    }
}

impl Bus {
    /// A bus whose log takes about `log_bytes`, and at least one event.
    pub fn new(log_bytes: usize) -> Self {
        Self(Arc::new(Shared {
            log: Mutex::new(Log {
                recent: VecDeque::new(),
                next: 0,
                bytes: 0,
                most_bytes: log_bytes,
                job: None,
                frames: 0,
                newest: None,
            }),
            news: Condvar::new(),
            keeper: Mutex::new(None),
            frame_keeper: Mutex::new(None),
            watching: AtomicUsize::new(0),
            instrument: Mutex::new(None),
        }))
    }

    /// From now on every event is also handed to `keeper`.
    pub fn keep(&self, keeper: Keeper) {
        *lock(&self.0.keeper) = Some(keeper);
    }

    /// From now on every frame is also handed to `keeper`.
    pub fn keep_frames(&self, keeper: FrameKeeper) {
        *lock(&self.0.frame_keeper) = Some(keeper);
    }

    /// Who hears what comes from now on.
    pub fn listen(&self) -> Listener {
        let next = lock(&self.0.log).next;
        self.listen_from(next)
    }

    /// Who hears everything from the event of that number on, as far as the log still has it: for a listener that was cut off.
    pub fn listen_from(&self, number: u64) -> Listener {
        Listener {
            bus: self.clone(),
            next: number,
            frames: lock(&self.0.log).frames,
            watches: false,
        }
    }

    /// Tells what happens now.
    pub fn tell(&self, news: News) {
        let instrument = lock(&self.0.instrument).as_ref().and_then(Weak::upgrade);
        let time_s = instrument.map_or(0.0, |i| i.clock().now().seconds());
        self.tell_at(time_s, news);
    }

    /// Tells what happened at that moment on the instrument's clock.
    pub fn tell_at(&self, time_s: f64, news: News) {
        let keeper = lock(&self.0.keeper);
        let record = lock(&self.0.log).take(time_s, news);
        self.0.news.notify_all();
        if let Some(keep) = &*keeper {
            keep(&record);
        }
    }

    /// Shows a frame.
    pub fn show(&self, frame: &Arc<Frame>, role: FrameRole) {
        if let Some(keep) = &*lock(&self.0.frame_keeper) {
            keep(frame, role);
        }
        let mut log = lock(&self.0.log);
        log.frames += 1;
        if self.0.watching.load(Ordering::SeqCst) > 0 {
            log.newest = Some((frame.clone(), role));
            drop(log);
            self.0.news.notify_all();
        }
    }

    pub(crate) fn station(&self, event: StationEvent) {
        self.tell(News::Station(event));
    }

    pub(crate) fn belongs_to(&self, job: Option<JobId>) {
        lock(&self.0.log).job = job;
    }

    pub(crate) fn job(&self) -> Option<JobId> {
        lock(&self.0.log).job
    }

    /// From now on the time is that of this instrument. The first one counts.
    pub(crate) fn time_of(&self, instrument: &Arc<Instrument>) {
        lock(&self.0.instrument).get_or_insert_with(|| Arc::downgrade(instrument));
    }
}

impl Log {
    fn take(&mut self, time_s: f64, news: News) -> Arc<Record> {
        let record = Arc::new(Record {
            number: self.next,
            time_s,
            job: self.job,
            news,
        });
        self.next += 1;
        self.bytes += record.bytes();
        self.recent.push_back(record.clone());
        while self.bytes > self.most_bytes && self.recent.len() > 1 {
            let oldest = self.recent.pop_front();
            self.bytes -= oldest.map_or(0, |r| r.bytes());
        }
        record
    }
}

/// A sink of procedures that tells all to a bus.
impl Sink for Bus {
    fn event(&mut self, event: Stamped) {
        self.tell_at(event.time_s, News::Procedure(Box::new(event.event)));
    }
    fn frame(&mut self, frame: &Frame, role: FrameRole) {
        self.show(&Arc::new(frame.clone()), role);
    }
    fn shared_frame(&mut self, frame: &Arc<Frame>, role: FrameRole) {
        self.show(frame, role);
    }
}

/// One who listens, at a pace of its own.
pub struct Listener {
    bus: Bus,
    next: u64,
    frames: u64,
    watches: bool,
}

impl Listener {
    /// The next event, if there is one.
    pub fn heard(&mut self) -> Option<Heard> {
        let log = lock(&self.bus.0.log);
        hear(&log, &mut self.next)
    }

    /// The next event; `None` when none came within `limit`.
    pub fn wait(&mut self, limit: Duration) -> Option<Heard> {
        let log = lock(&self.bus.0.log);
        let next = self.next;
        let waited = self
            .bus
            .0
            .news
            .wait_timeout_while(log, limit, |log| log.next <= next);
        let log = waited.unwrap_or_else(PoisonError::into_inner).0;
        hear(&log, &mut self.next)
    }

    /// The newest frame, if this listener has not seen it. Frames are held from the first time that somebody asks.
    pub fn frame(&mut self) -> Option<Shown> {
        let mut log = lock(&self.bus.0.log);
        if !self.watches {
            self.watches = true;
            self.bus.0.watching.fetch_add(1, Ordering::SeqCst);
            // What came before was not held, or is somebody's last look.
            self.frames = log.frames - u64::from(log.newest.is_some());
        }
        let missed = log.frames.checked_sub(self.frames + 1)?;
        let (frame, role) = log.newest.as_mut()?;
        let shown = Shown {
            frame: frame.clone(),
            role: *role,
            missed,
        };
        self.frames = log.frames;
        Some(shown)
    }
}

fn hear(log: &Log, next: &mut u64) -> Option<Heard> {
    let first = log.next - log.recent.len() as u64;
    if *next < first {
        let events = first - *next;
        *next = first;
        return Some(Heard::Missed { events });
    }
    let record = log.recent.get((*next - first) as usize)?;
    *next += 1;
    Some(Heard::Event(record.clone()))
}

impl Drop for Listener {
    fn drop(&mut self) {
        if self.watches && self.bus.0.watching.fetch_sub(1, Ordering::SeqCst) == 1 {
            lock(&self.bus.0.log).newest = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::{Channels, Samples, Timestamp};

    fn frame(sequence: u64) -> Arc<Frame> {
        Arc::new(Frame {
            width: 1,
            height: 1,
            channels: Channels::Gray,
            bit_depth: 8,
            samples: Samples::U8(vec![0]),
            sequence,
            exposure_start: Timestamp::default(),
            exposure: Duration::ZERO,
        })
    }

    fn tell(bus: &Bus) {
        bus.tell(News::Station(StationEvent::StopAsked));
    }

    #[test]
    fn every_event_is_heard_once_and_in_order_and_a_gap_is_told() {
        let bus = Bus::new(8 << 10);
        let kept = Arc::new(Mutex::new(0));
        let keeper = kept.clone();
        bus.keep(Arc::new(move |r| {
            assert_eq!(r.number, *lock(&keeper));
            *lock(&keeper) += 1;
        }));
        let (mut brisk, mut slow) = (bus.listen(), bus.listen());
        for k in 0..1000 {
            tell(&bus);
            let Some(Heard::Event(record)) = brisk.heard() else {
                panic!("event {k} is missing");
            };
            assert_eq!(record.number, k);
            assert_eq!(brisk.heard(), None);
        }
        let Some(Heard::Missed { events }) = slow.heard() else {
            panic!("the log has a bound");
        };
        let mut rest = 0;
        while let Some(Heard::Event(record)) = slow.heard() {
            assert_eq!(record.number, events + rest);
            rest += 1;
        }
        assert_eq!(events + rest, 1000);
        assert!(rest > 1, "{rest}");
        assert_eq!(*lock(&kept), 1000);
        // One who was cut off goes on where it was.
        let mut again = bus.listen_from(998);
        assert!(matches!(again.heard(), Some(Heard::Event(r)) if r.number == 998));
        assert_eq!(slow.wait(Duration::ZERO), None);
    }

    #[test]
    fn who_watches_sees_the_newest_frame_without_a_copy_and_what_nobody_watches_is_not_held() {
        let bus = Bus::default();
        let (mut first, mut second) = (bus.listen(), bus.listen());
        let unseen = frame(0);
        bus.show(&unseen, FrameRole::Servo);
        assert_eq!(Arc::strong_count(&unseen), 1);
        assert_eq!(first.frame(), None);
        for sequence in 1..=3 {
            bus.show(&frame(sequence), FrameRole::Focus);
        }
        let shown = first.frame().unwrap();
        assert_eq!((shown.frame.sequence, shown.missed), (3, 2));
        assert_eq!(first.frame(), None);
        // Who comes later sees the last one.
        let late = second.frame().unwrap();
        assert!(Arc::ptr_eq(&late.frame, &shown.frame));
        drop((first, second, late));
        assert_eq!(Arc::strong_count(&shown.frame), 1);
    }
}
