//! What the tests of the drivers share, and tests that every driver passes against its emulator.
#![allow(
    dead_code,
    unreachable_pub,
    unused_imports,
    unused_macros,
    reason = "each test file uses its own part"
)]

use scopeservo_drivers::emulator::{Fault, Server};
use scopeservo_drivers::link::Tcp;
use scopeservo_scope::{Axis, Motion, ScopeError, Stage, StagePose};
use std::thread;
use std::time::{Duration, Instant};

/// SplitMix64.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }
    pub fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())]
    }
}

pub fn tcp(address: &str) -> Box<Tcp> {
    Box::new(Tcp::connect(address, Duration::from_secs(2)).unwrap())
}

/// One axis, in metres or radians.
pub fn pose(axis: Axis, si: f64) -> StagePose {
    StagePose::default().with_si(axis, si)
}

/// Polls until the move has ended.
pub fn wait(stage: &impl Stage) -> Motion {
    let start = Instant::now();
    loop {
        match stage.poll().unwrap() {
            Motion::Moving => assert!(start.elapsed() < Duration::from_secs(10), "it never ends"),
            ended => return ended,
        }
        thread::sleep(Duration::from_millis(2));
    }
}

pub fn detail(error: ScopeError) -> String {
    match error {
        ScopeError::Device { detail, .. } => detail,
        other => panic!("{other:?}"),
    }
}

/// Of a refusal: nothing moved, and there is nothing to stop.
pub fn refusal(error: ScopeError) -> String {
    match error {
        ScopeError::Refused { detail, .. } => detail,
        other => panic!("{other:?}"),
    }
}

pub fn is_device(error: &ScopeError) -> bool {
    matches!(error, ScopeError::Device { .. })
}

/// A driver, the emulator behind it, and a move along x that takes seconds.
pub struct Bench<D, S> {
    pub emulator: Server<D>,
    pub stage: S,
    /// Where the axes really are, x first, m.
    pub truth: fn(&Server<D>) -> Vec<f64>,
    /// Where the move ends, m.
    pub far: f64,
}

impl<D: Send, S: Stage> Bench<D, S> {
    fn start(&self) {
        self.stage.start_move(&pose(Axis::X, self.far)).unwrap();
    }

    fn truth(&self) -> Vec<f64> {
        (self.truth)(&self.emulator)
    }

    /// A fault in the middle of a move: the first call after it fails before that ends, and as `first` says; every
    /// later call, also the driver's `own`, says that the link is closed and why; a stage that still hears was told to stop.
    pub fn fails(
        self,
        own: fn(&S) -> Result<(), ScopeError>,
        fault: Fault,
        first: fn(&ScopeError) -> bool,
        why: &str,
        hears: bool,
    ) {
        self.start();
        let stage = &self.stage;
        self.emulator.set_fault(fault);
        let start = Instant::now();
        let error = stage.position().unwrap_err();
        let took = start.elapsed();
        assert!(took < Duration::from_secs(30), "{fault:?} {took:?}");
        assert!(first(&error), "{fault:?} {error:?}");
        for later in [
            stage.position().map(|_| ()),
            stage.poll().map(|_| ()),
            stage.start_move(&pose(Axis::X, 0.0)),
            stage.stop(),
            own(stage),
        ] {
            let text = detail(later.unwrap_err());
            assert!(text.contains("closed because"), "{fault:?} {text}");
            assert!(text.contains(why), "{fault:?} {text}");
        }
        if hears {
            stands(|| self.truth(), self.far, &format!("{fault:?}"));
        }
    }

    /// A driver that ends on the way stops the stage.
    pub fn ends(self) {
        self.start();
        let Self {
            emulator,
            stage,
            truth,
            far,
        } = self;
        drop(stage);
        stands(|| truth(&emulator), far, "the end of the driver");
    }

    /// Stops a hundred moves on the way while another thread polls, and prints how long it took until the stage stood.
    #[expect(clippy::print_stdout, reason = "the test reports what it measured")]
    pub fn stops_quickly(&self) {
        let mut took = Vec::new();
        let mut there = self.far;
        for _ in 0..100 {
            self.stage.start_move(&pose(Axis::X, there)).unwrap();
            there = -there;
            let ended = thread::scope(|s| {
                let polls = s.spawn(|| wait(&self.stage));
                thread::sleep(Duration::from_millis(5));
                let start = Instant::now();
                self.stage.stop().unwrap();
                took.push(start.elapsed());
                polls.join().unwrap()
            });
            assert_eq!(ended, Motion::Stopped);
            let at = self.truth();
            thread::sleep(Duration::from_millis(2));
            assert_eq!(self.truth(), at, "it creeps");
            assert!(at[0].abs() < 0.99 * self.far, "it arrived");
        }
        took.sort();
        let at = |part: usize| took[part * took.len() / 100 - 1];
        let (half, most) = (at(50), at(99));
        println!("stop: median {half:?}, 99th percentile {most:?}");
        // The figure is in docs/hardware.md; that no stop waits for the move is seen by where it ends.
    }
}

/// That a stage told to stop stands, on its way.
fn stands(truth: impl Fn() -> Vec<f64>, far: f64, why: &str) {
    thread::sleep(Duration::from_millis(50));
    let at = truth();
    thread::sleep(Duration::from_millis(20));
    assert_eq!(truth(), at, "{why} left it moving");
    assert!(at[0].abs() < 0.95 * far, "{why} let it arrive");
}

/// What every driver on a line makes of what can happen to the line while the stage moves. `bench()` of the test file starts a move;
/// `own` is a call that only this driver has, `after_stops` what must go well
/// after a hundred stops; the rest is what differs: the time-out of an answer, how slowly bytes come that never make
/// an answer in time, the longest line, and what comes of answers without end.
macro_rules! link_faults {
    (
        own: $own:expr,
        silence: $silence:expr,
        slow_bytes_ms: $slow:expr,
        longest_line: $longest:expr,
        endless: $endless:expr,
        after_stops: $after:expr $(,)?
    ) => {
        fn fails(fault: Fault, first: fn(&ScopeError) -> bool, why: &str, hears: bool) {
            bench().fails($own, fault, first, why, hears);
        }

        #[test]
        fn silence_is_a_time_out() {
            fails(Fault::Silence, $silence, "no answer", true);
        }

        #[test]
        fn half_an_answer_is_told() {
            fails(Fault::Half, is_device, "middle of a line", true);
        }

        #[test]
        fn an_answer_byte_by_byte_beyond_the_time_out_is_told() {
            fails(Fault::SlowBytes($slow), is_device, "middle of a line", true);
        }

        #[test]
        fn garbage_is_told() {
            fails(Fault::Garbage, is_device, "not text", true);
        }

        #[test]
        fn an_endless_line_is_told() {
            let why = format!("more than {} bytes", $longest);
            fails(Fault::EndlessLine, is_device, &why, false);
        }

        #[test]
        fn answers_without_end_are_told() {
            let (first, why): (fn(&ScopeError) -> bool, &str) = $endless;
            fails(Fault::EndlessLines, first, why, false);
        }

        #[test]
        fn a_disconnection_on_the_way_is_told() {
            fails(Fault::Disconnect, is_device, "closed the connection", false);
        }

        #[test]
        fn a_driver_that_ends_on_the_way_stops_the_stage() {
            bench().ends();
        }

        #[test]
        fn stops_on_the_way_are_quick_while_another_thread_polls() {
            let bench = bench();
            bench.stops_quickly();
            // What the stops left behind is accounted for: the next command is not blamed for it.
            let after: fn(&_) = $after;
            after(&bench.stage);
        }
    };
}
pub(crate) use link_faults;
