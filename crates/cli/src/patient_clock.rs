//! A clock for the simulated microscope that waits for those who ask: a program that computes for long on a busy computer finds it as it left it.

use scopeservo_scope::{Clock, Timestamp};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Runs so many times as fast as the wall's clock, but between two who look at it no longer than it was told.
#[derive(Debug)]
pub(crate) struct PatientClock {
    speed: f64,
    /// Passes at most while nobody looks, of its own time.
    idle: Duration,
    at: Mutex<At>,
}

#[derive(Debug)]
struct At {
    looked: Instant,
    now: Duration,
}

impl PatientClock {
    pub(crate) fn new(speed: f64, idle: Duration) -> Self {
        Self {
            speed,
            idle,
            at: Mutex::new(At {
                looked: Instant::now(),
                now: Duration::ZERO,
            }),
        }
    }

    /// Looks: what has passed since somebody did, as far as it counts.
    fn look(&self, most: Duration) -> Duration {
        let mut at = self.at.lock().unwrap_or_else(PoisonError::into_inner);
        let looked = Instant::now();
        let passed = looked.duration_since(at.looked).mul_f64(self.speed);
        at.now += passed.min(most);
        at.looked = looked;
        at.now
    }
}

impl Clock for PatientClock {
    fn now(&self) -> Timestamp {
        Timestamp::from_start(self.look(self.idle))
    }
    fn sleep(&self, duration: Duration) {
        self.look(self.idle);
        std::thread::sleep(self.in_life(duration));
        self.look(duration.max(self.idle));
    }
    fn in_life(&self, duration: Duration) -> Duration {
        duration.div_f64(self.speed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn while_nobody_looks_little_passes_and_who_sleeps_has_slept() {
        let clock = PatientClock::new(1000.0, Duration::from_secs(2));
        let before = clock.now();
        std::thread::sleep(Duration::from_millis(20));
        // Twenty seconds in its own time.
        let after = clock.now();
        assert_eq!(after.since(before), Duration::from_secs(2));
        clock.sleep(Duration::from_secs(10));
        let slept = clock.now().since(after);
        assert!(slept >= Duration::from_secs(10), "{slept:?}");
        assert!(slept <= Duration::from_secs(14), "{slept:?}");
    }
}
