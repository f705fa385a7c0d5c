//! A camera that sends one image after another, whether anybody looks or not.

use crate::camera::exposing::Exposing;
use crate::camera::picture::{self, Picture, PictureError};
use crate::camera::raw::{self, Layout};
use crate::camera::{check_latency, device, frame, info, lost};
use crate::session::lock;
use scopeservo_scope::{Camera, CameraInfo, Clock, Frame, ScopeError};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// An image as it came.
#[derive(Debug, Clone, PartialEq)]
pub enum Packed {
    /// A JPEG, PNG or TIFF file.
    File(Vec<u8>),
    /// Pixels.
    Raw(Layout, Vec<u8>),
}

impl Packed {
    fn unpack(&self) -> Result<Picture, PictureError> {
        match self {
            Self::File(bytes) => picture::decode(bytes),
            Self::Raw(layout, bytes) => raw::unpack(layout, bytes),
        }
    }
}

/// Where the images come from.
pub trait Source: Send {
    /// Waits up to `wait` for an image, and tells when it was here whole, or a moment before that. `None` when none came; an error
    /// when none will come any more.
    ///
    /// # Errors
    /// What happened, for people.
    fn next(&mut self, wait: Duration) -> Result<Option<(Packed, Instant)>, String>;
}

type Open = Box<dyn Fn() -> Result<Box<dyn Source>, ScopeError> + Send + Sync>;

/// How often the reading thread looks whether it is still wanted.
const LOOK: Duration = Duration::from_millis(50);

/// A camera whose images a thread of its own reads, so that none grows old in a buffer. After a fault the next grab opens it
/// again.
pub struct StreamCamera {
    info: CameraInfo,
    exposing: Exposing,
    latency: Duration,
    /// The exposure that the latency was told for.
    first_exposure: Duration,
    timeout: Duration,
    clock: Arc<dyn Clock>,
    open: Open,
    reader: Mutex<Option<Reader>>,
    /// Counts images through all readers.
    count: Arc<AtomicU64>,
}

impl StreamCamera {
    /// Opens it and waits for its first image.
    ///
    /// An image may take up to `latency` from the start of its exposure until it is here; one that has not come `timeout` later is
    /// not waited for any more.
    ///
    /// # Errors
    /// What `open` reports, [`ScopeError::Timeout`], [`ScopeError::Lost`], [`ScopeError::Device`].
    pub(crate) fn new(
        name: String,
        open: Open,
        exposing: Exposing,
        latency: Duration,
        timeout: Duration,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, ScopeError> {
        let first_exposure = exposing.get();
        check_latency("latency_ms", latency, first_exposure)?;
        let count = Arc::new(AtomicU64::new(0));
        let reader = Reader::start(open()?, count.clone());
        let (first, _) = reader
            .shared
            .fresh(Instant::now(), latency, latency + timeout)?;
        Ok(Self {
            info: info(name, &first, exposing.range()),
            exposing,
            latency,
            first_exposure,
            timeout,
            clock,
            open,
            reader: Mutex::new(Some(reader)),
            count,
        })
    }

    /// The state of a reader that reads.
    fn shared(&self) -> Result<Arc<Shared>, ScopeError> {
        let mut reader = lock(&self.reader);
        if let Some(reader) = &*reader
            && lock(&reader.shared.state).ended.is_none()
        {
            return Ok(reader.shared.clone());
        }
        // The old one goes first: many devices can be open only once.
        *reader = None;
        let new = Reader::start((self.open)()?, self.count.clone());
        let shared = new.shared.clone();
        *reader = Some(new);
        Ok(shared)
    }
}

impl Camera for StreamCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn exposure(&self) -> Result<Duration, ScopeError> {
        Ok(self.exposing.get())
    }

    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
        self.exposing.set(&self.info, exposure)
    }

    fn grab(&self) -> Result<Frame, ScopeError> {
        let exposure = self.exposing.get();
        // A longer exposure is longer on its way.
        let latency = self.latency + exposure.saturating_sub(self.first_exposure);
        let shared = self.shared()?;
        // Not before it was opened, should it have been lost: the first image may be one that was kept.
        let (asked_at, asked) = (self.clock.now(), Instant::now());
        let within = latency + self.timeout;
        let (picture, at) = shared.fresh(asked, latency, within).inspect_err(|_| {
            // What is on this connection nobody knows; the next grab makes another.
            let mut reader = lock(&self.reader);
            if reader
                .as_ref()
                .is_some_and(|r| Arc::ptr_eq(&r.shared, &shared))
            {
                *reader = None;
            }
        })?;
        let start = at.came.saturating_duration_since(asked + latency);
        frame(
            &self.info,
            picture,
            at.sequence,
            asked_at.after(start),
            exposure,
        )
    }
}

/// The thread that reads.
struct Reader {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

struct Shared {
    state: Mutex<State>,
    news: Condvar,
    unwanted: AtomicBool,
}

#[derive(Default)]
struct State {
    newest: Option<(Arc<Packed>, Arrival)>,
    /// Why no image will come any more.
    ended: Option<String>,
}

/// When an image was here, and which one it was.
#[derive(Debug, Clone, Copy)]
struct Arrival {
    came: Instant,
    sequence: u64,
}

impl Reader {
    fn start(mut source: Box<dyn Source>, count: Arc<AtomicU64>) -> Self {
        let shared = Arc::new(Shared {
            state: Mutex::default(),
            news: Condvar::new(),
            unwanted: AtomicBool::new(false),
        });
        let kept = shared.clone();
        let thread = std::thread::spawn(move || {
            while !kept.unwanted.load(Ordering::Relaxed) {
                let news = source.next(LOOK);
                let mut state = lock(&kept.state);
                match news {
                    Ok(None) => continue,
                    Ok(Some((packed, came))) => {
                        let sequence = count.fetch_add(1, Ordering::Relaxed);
                        state.newest = Some((Arc::new(packed), Arrival { came, sequence }));
                    }
                    Err(why) => state.ended = Some(why),
                }
                kept.news.notify_all();
                if state.ended.is_some() {
                    return;
                }
            }
        });
        Self {
            shared,
            thread: Some(thread),
        }
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.shared.unwanted.store(true, Ordering::Relaxed);
        // Waited for, so that the device is free. It looks every 50 ms.
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        // Others may wait for its images still.
        lock(&self.shared.state)
            .ended
            .get_or_insert_with(|| "its connection was given up".into());
        self.shared.news.notify_all();
    }
}

impl Shared {
    /// An image whose exposure began at or after `asked`. One that cannot be unpacked is passed over: the next may be whole.
    fn fresh(
        &self,
        asked: Instant,
        latency: Duration,
        within: Duration,
    ) -> Result<(Picture, Arrival), ScopeError> {
        let give_up = asked + within;
        let (mut damaged, mut fault) = (None, None);
        let mut state = lock(&self.state);
        loop {
            if let Some((packed, at)) = state.newest.clone()
                && at.came >= asked + latency
                && damaged.is_none_or(|sequence| at.sequence > sequence)
            {
                drop(state);
                match packed.unpack() {
                    Ok(picture) => return Ok((picture, at)),
                    Err(error) => {
                        damaged = Some(at.sequence);
                        fault = Some(error);
                    }
                }
                state = lock(&self.state);
                continue;
            }
            if let Some(why) = &state.ended {
                return Err(lost(why.clone()));
            }
            let left = give_up.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(match fault {
                    Some(fault) => device(fault.to_string()),
                    None => device(format!(
                        "no image came within {:.1} s: see whether it is switched on, sends, and serves nobody else",
                        within.as_secs_f64()
                    )),
                });
            }
            let waited = self.news.wait_timeout(state, left);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::raw::PixelOrder;
    use scopeservo_scope::{Samples, SystemClock};
    use std::sync::atomic::AtomicU8;

    const LATENCY: Duration = Duration::from_millis(60);

    /// From the exposure of an image until it is here.
    const ON_THE_WAY: Duration = Duration::from_millis(50);

    /// Sends what the world looks like, but as it was some time ago, every 10 ms. Each image was here when it was due, however late a loaded
    /// machine comes to hand it on.
    struct Delayed {
        world: Arc<AtomicU8>,
        on_the_way: Vec<(Instant, u8)>,
        fault: Arc<Mutex<Option<&'static str>>>,
    }

    impl Source for Delayed {
        fn next(&mut self, _: Duration) -> Result<Option<(Packed, Instant)>, String> {
            std::thread::sleep(Duration::from_millis(10));
            let now = |packed| Ok(Some((packed, Instant::now())));
            match *lock(&self.fault) {
                Some("silent") => return Ok(None),
                Some("damaged") => return now(Packed::File(vec![0xff, 0xd8, 1])),
                Some("other size") => return now(Packed::Raw(layout(2), vec![0; 4])),
                Some(fault) => return Err(fault.into()),
                None => {}
            }
            self.on_the_way
                .push((Instant::now(), self.world.load(Ordering::SeqCst)));
            let due = |(at, _): &&(Instant, u8)| at.elapsed() >= ON_THE_WAY;
            Ok(self.on_the_way.iter().rev().find(due).map(|(at, v)| {
                let picture = Packed::Raw(layout(1), vec![*v; 2]);
                (picture, *at + ON_THE_WAY)
            }))
        }
    }

    fn layout(height: usize) -> Layout {
        Layout {
            order: PixelOrder::Gray,
            width: 2,
            height,
            row_bytes: 2,
        }
    }

    struct Bench {
        camera: StreamCamera,
        world: Arc<AtomicU8>,
        fault: Arc<Mutex<Option<&'static str>>>,
        opened: Arc<AtomicU8>,
    }

    fn bench(latency: Duration) -> Bench {
        let world = Arc::new(AtomicU8::new(7));
        let fault = Arc::new(Mutex::new(None));
        let opened = Arc::new(AtomicU8::new(0));
        let (seen, broken, counted) = (world.clone(), fault.clone(), opened.clone());
        let open: Open = Box::new(move || {
            counted.fetch_add(1, Ordering::SeqCst);
            if *lock(&broken) == Some("unplugged") {
                return Err(lost("nothing there"));
            }
            Ok(Box::new(Delayed {
                world: seen.clone(),
                on_the_way: Vec::new(),
                fault: broken.clone(),
            }))
        });
        let camera = StreamCamera::new(
            "delayed".into(),
            open,
            Exposing::fixed(Duration::from_millis(1)),
            latency,
            Duration::from_millis(300),
            Arc::new(SystemClock::new()),
        )
        .unwrap();
        Bench {
            camera,
            world,
            fault,
            opened,
        }
    }

    /// How many of some grabs show the world as it was before they were asked for.
    fn stale(bench: &Bench) -> usize {
        (0..10u8)
            .filter(|value| {
                bench.world.store(*value, Ordering::SeqCst);
                let asked = bench.camera.clock.now();
                let frame = bench.camera.grab().unwrap();
                assert!(frame.exposure_start >= asked);
                assert!(
                    bench.camera.clock.now() >= frame.exposure_start.after(bench.camera.latency)
                );
                frame.samples != Samples::U8(vec![*value; 2])
            })
            .count()
    }

    #[test]
    fn a_grab_never_shows_what_was_before_it() {
        assert_eq!(stale(&bench(LATENCY)), 0);
        // The test can tell: without the latency, old images pass.
        assert!(stale(&bench(Duration::from_millis(1))) > 0);
    }

    #[test]
    fn a_camera_that_is_lost_says_so_and_is_opened_again() {
        let bench = bench(LATENCY);
        *lock(&bench.fault) = Some("unplugged");
        // Not the silence that it would be after the time for an image.
        let answer = bench.camera.grab();
        assert!(matches!(answer, Err(ScopeError::Lost { .. })), "{answer:?}");
        // Still gone.
        assert!(bench.camera.grab().is_err());
        *lock(&bench.fault) = None;
        let before = bench.opened.load(Ordering::SeqCst);
        let first = bench.camera.grab().unwrap();
        let second = bench.camera.grab().unwrap();
        assert!(second.sequence > first.sequence);
        assert_eq!(bench.opened.load(Ordering::SeqCst), before + 1);
    }

    #[test]
    fn silence_damage_and_another_size_are_told_in_time() {
        let bench = bench(LATENCY);
        let told = |fault| {
            *lock(&bench.fault) = Some(fault);
            bench.camera.grab().unwrap_err()
        };
        let silent = told("silent").to_string();
        assert!(silent.contains("no image came within 0.4 s"), "{silent}");
        let damaged = told("damaged").to_string();
        assert!(damaged.contains("breaks off"), "{damaged}");
        let size = told("other size").to_string();
        assert!(
            size.contains("were 2 x 1") && size.contains("now are 2 x 2"),
            "{size}"
        );
        *lock(&bench.fault) = None;
        assert!(bench.camera.grab().is_ok());
    }

    #[test]
    fn a_latency_shorter_than_the_exposure_is_refused_and_a_longer_exposure_waited_for() {
        let open = |latency_ms, exposing| {
            let open: Open = Box::new(|| {
                Ok(Box::new(Delayed {
                    world: Arc::default(),
                    on_the_way: Vec::new(),
                    fault: Arc::default(),
                }))
            });
            let (latency, timeout) = (Duration::from_millis(latency_ms), Duration::from_secs(1));
            let clock = Arc::new(SystemClock::new());
            StreamCamera::new("camera".into(), open, exposing, latency, timeout, clock)
        };
        let ms = Duration::from_millis;
        let short = open(60, Exposing::fixed(ms(61))).err().unwrap();
        assert!(matches!(short, ScopeError::BadSetting { .. }), "{short}");
        let exposing = Exposing::with(ms(10), [ms(1), ms(500)], Box::new(Ok));
        let camera = open(60, exposing).unwrap();
        camera.set_exposure(ms(200)).unwrap();
        let asked = Instant::now();
        camera.grab().unwrap();
        assert!(asked.elapsed() >= ms(60 + 190));
    }

    #[test]
    fn an_exposure_that_cannot_be_set_is_refused() {
        let camera = bench(LATENCY).camera;
        let ms = Duration::from_millis;
        assert_eq!(camera.set_exposure(ms(1)), Ok(ms(1)));
        assert!(camera.set_exposure(ms(2)).is_err());
    }
}
