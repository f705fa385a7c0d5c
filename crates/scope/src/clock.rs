//! Time behind one contract: the wall's, or a simulation's.

use serde::{Deserialize, Serialize};
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Time since the start of the clock that made it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Timestamp(Duration);

impl Timestamp {
    /// From the time passed since the clock's start.
    pub const fn from_start(since_start: Duration) -> Self {
        Self(since_start)
    }
    /// Seconds since the clock's start.
    pub fn seconds(self) -> f64 {
        self.0.as_secs_f64()
    }
    /// The moment `later` after this one.
    pub fn after(self, later: Duration) -> Self {
        Self(self.0 + later)
    }
    /// Time from `earlier` until this moment; zero if `earlier` is later.
    pub fn since(self, earlier: Self) -> Duration {
        self.0.saturating_sub(earlier.0)
    }
}

/// Where all waiting goes through. A device that waits, waits here.
pub trait Clock: Send + Sync {
    /// The present moment.
    fn now(&self) -> Timestamp;
    /// Returns when `duration` has passed on this clock.
    fn sleep(&self, duration: Duration);
    /// How long that takes for who watches: less, on a clock that runs faster than life.
    fn in_life(&self, duration: Duration) -> Duration {
        duration
    }
}

/// The wall clock, from the moment of its making; or one that runs faster, for a simulation that need not take as long as life.
#[derive(Debug)]
pub struct SystemClock {
    start: Instant,
    speed: f64,
}

impl SystemClock {
    /// Starts now.
    pub fn new() -> Self {
        Self::faster(1.0)
    }

    /// Starts now, and runs so many times as fast as the wall's: at least as fast, at most a thousand times.
    pub fn faster(speed: f64) -> Self {
        Self {
            start: Instant::now(),
            speed: speed.clamp(1.0, 1000.0),
        }
    }
}

impl Default for SystemClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for SystemClock {
    fn now(&self) -> Timestamp {
        Timestamp(self.start.elapsed().mul_f64(self.speed))
    }
    fn sleep(&self, duration: Duration) {
        std::thread::sleep(self.in_life(duration));
    }
    fn in_life(&self, duration: Duration) -> Duration {
        duration.div_f64(self.speed)
    }
}

/// A clock that moves only when someone sleeps: minutes of instrument time pass in no time.
#[derive(Debug, Default)]
pub struct VirtualClock {
    now: Mutex<Duration>,
}

impl VirtualClock {
    /// Starts at zero.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Clock for VirtualClock {
    fn now(&self) -> Timestamp {
        Timestamp(*self.now.lock().unwrap_or_else(|e| e.into_inner()))
    }
    fn sleep(&self, duration: Duration) {
        *self.now.lock().unwrap_or_else(|e| e.into_inner()) += duration;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn virtual_time_passes_only_by_sleeping() {
        let clock = VirtualClock::new();
        assert_eq!(clock.now().seconds(), 0.0);
        clock.sleep(Duration::from_secs(3600));
        assert_eq!(clock.now().seconds(), 3600.0);
        assert_eq!(clock.now(), clock.now());
    }

    #[test]
    fn system_time_passes_by_itself() {
        let clock = SystemClock::new();
        let before = clock.now();
        clock.sleep(Duration::from_millis(2));
        assert!(clock.now().since(before) >= Duration::from_millis(2));
    }

    #[test]
    fn a_faster_clock_passes_more_in_less() {
        let (life, clock) = (SystemClock::new(), SystemClock::faster(100.0));
        clock.sleep(Duration::from_secs(1));
        let (passed, seen) = (life.now().seconds(), clock.now().seconds());
        assert!(passed >= 0.01 && seen >= 1.0, "{passed} {seen}");
        assert!(seen >= 99.0 * passed - 0.5, "{passed} {seen}");
    }
}
