//! Stops: whatever they meet, the stage stands and says so.

use crate::common::{detail, pose, wait};
use crate::controller::{connect, hexapod, settings};
use scopeservo_drivers::emulator::Fault;
use scopeservo_drivers::emulator::gcs2::{EmulatedStage, Gcs2Emulator, Obeys};
use scopeservo_drivers::gcs2::Gcs2Stage;
use scopeservo_drivers::link::{LinkError, Tcp, Transport};
use scopeservo_scope::{Axis, Motion, ScopeError, Stage};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::thread;
use std::time::{Duration, Instant};

#[test]
fn a_stop_does_not_wait_for_an_answer_that_is_slow() {
    let (emulator, stage) = hexapod();
    stage.start_move(&pose(Axis::X, 20e-3)).unwrap();
    emulator.set_fault(Fault::SlowBytes(1));
    thread::scope(|s| {
        // Six values of a dozen bytes take a tenth of a second and more.
        let asks = s.spawn(|| stage.position());
        thread::sleep(Duration::from_millis(20));
        let stops = s.spawn(|| stage.stop());
        thread::sleep(Duration::from_millis(20));
        assert!(emulator.heard().contains(&"#24".to_string()));
        assert!(!asks.is_finished(), "the answer was not slow");
        asks.join().unwrap().unwrap();
        stops.join().unwrap().unwrap();
    });
    let truth = emulator.truth()[0];
    thread::sleep(Duration::from_millis(20));
    assert_eq!(emulator.truth()[0], truth);
    assert_eq!(stage.poll().unwrap(), Motion::Stopped);
}

#[test]
fn no_move_starts_after_a_stop_however_they_meet() {
    let (emulator, stage) = hexapod();
    for round in 0..60 {
        thread::scope(|s| {
            let starts = s.spawn(|| stage.start_move(&pose(Axis::X, 15e-3)));
            thread::sleep(Duration::from_micros(10 * round));
            stage.stop().unwrap();
            let answer = starts.join().unwrap();
            assert!(
                matches!(answer, Ok(()) | Err(ScopeError::Interrupted { .. })),
                "{answer:?}"
            );
        });
        // A start that came after the stop is a new wish: let it be stopped as well.
        if stage.poll().unwrap() == Motion::Moving {
            stage.stop().unwrap();
        }
        let at = emulator.truth();
        thread::sleep(Duration::from_millis(2));
        assert_eq!(emulator.truth(), at);
    }
}

/// Holds back the answer to VMO? until the stop byte has gone out.
struct StopBetween {
    tcp: Tcp,
    holds: AtomicBool,
    stopped: AtomicBool,
}

impl Transport for Between {
    fn read(&self, into: &mut [u8], deadline: Instant) -> Result<usize, LinkError> {
        while self.0.holds.load(SeqCst) && !self.0.stopped.load(SeqCst) {
            thread::sleep(Duration::from_millis(1));
        }
        self.0.tcp.read(into, deadline)
    }
    fn write(&self, bytes: &[u8]) -> Result<(), LinkError> {
        self.0.tcp.write(bytes)?;
        if bytes.starts_with(b"VMO?") {
            self.0.holds.store(true, SeqCst);
        }
        if bytes == [24] {
            self.0.stopped.store(true, SeqCst);
        }
        Ok(())
    }
    fn close(&self) {
        self.0.tcp.close();
    }
}

struct Between(Arc<StopBetween>);

#[test]
fn a_stop_while_a_move_is_prepared_keeps_it_from_starting() {
    let emulator = Gcs2Emulator::serve(EmulatedStage::hexapod()).unwrap();
    let between = Arc::new(StopBetween {
        tcp: Tcp::connect(&emulator.address(), Duration::from_secs(2)).unwrap(),
        holds: AtomicBool::new(false),
        stopped: AtomicBool::new(false),
    });
    let stage = Gcs2Stage::connect(Box::new(Between(between.clone())), &settings()).unwrap();
    thread::scope(|s| {
        let starts = s.spawn(|| stage.start_move(&pose(Axis::X, 15e-3)));
        let start = Instant::now();
        while !between.holds.load(SeqCst) {
            assert!(start.elapsed() < Duration::from_secs(60), "it never asks");
            thread::sleep(Duration::from_millis(1));
        }
        stage.stop().unwrap();
        assert_eq!(
            starts.join().unwrap(),
            Err(ScopeError::Interrupted { at: None })
        );
    });
    assert!(!emulator.heard().iter().any(|l| l.starts_with("MOV")));
}

#[test]
fn stopping_a_stage_that_stands_is_harmless() {
    let (_emulator, stage) = hexapod();
    stage.stop().unwrap();
    stage.stop().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Settled);
    stage.start_move(&pose(Axis::X, 0.2e-3)).unwrap();
    assert_eq!(wait(&stage), Motion::Settled);
}

#[test]
fn a_stop_that_is_ignored_is_repeated_as_a_line_and_then_told() {
    let (emulator, stage) = hexapod();
    emulator.set_obeys(Obeys::OnlyLines);
    stage.start_move(&pose(Axis::X, 20e-3)).unwrap();
    stage.stop().unwrap();
    assert_eq!(stage.poll().unwrap(), Motion::Stopped);
    assert!(emulator.heard().contains(&"STP".to_string()));

    emulator.set_obeys(Obeys::None);
    stage.start_move(&pose(Axis::X, -20e-3)).unwrap();
    let why = detail(stage.stop().unwrap_err());
    assert!(why.contains("emergency"), "{why}");
    // Long before the move has ended. The link is sound: it can be tried again.
    assert_eq!(stage.poll().unwrap(), Motion::Moving);
    emulator.set_obeys(Obeys::All);
    stage.stop().unwrap();
}

#[test]
fn halting_ends_a_move_too() {
    let (_emulator, stage) = hexapod();
    stage.start_move(&pose(Axis::X, 20e-3)).unwrap();
    stage.halt().unwrap();
    assert_eq!(wait(&stage), Motion::Stopped);
}

#[test]
fn a_stop_by_somebody_else_is_not_taken_for_an_arrival() {
    let (emulator, stage) = hexapod();
    stage.start_move(&pose(Axis::X, 20e-3)).unwrap();
    emulator.stop_by_hand();
    assert_eq!(wait(&stage), Motion::Stopped);
}

#[test]
fn a_stage_that_stands_off_target_is_waited_for_and_then_counts_as_stopped() {
    let emulator = Gcs2Emulator::serve(EmulatedStage::hexapod()).unwrap();
    let mut settings = settings();
    settings.settle_timeout_ms = 200;
    let stage = connect(&emulator, &settings).unwrap();
    for (settles, ends) in [(true, Motion::Settled), (false, Motion::Stopped)] {
        emulator.set_never_on_target(true);
        let to = if settles { 0.05e-3 } else { 0.0 };
        stage.start_move(&pose(Axis::X, to)).unwrap();
        thread::sleep(Duration::from_millis(60));
        assert_eq!(stage.poll().unwrap(), Motion::Moving);
        emulator.set_never_on_target(!settles);
        assert_eq!(wait(&stage), ends);
    }
}
