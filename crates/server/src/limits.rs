//! How much one may ask: so much at once, and so much in a second from then on.

use std::collections::HashMap;
use std::time::{Duration, Instant};

/// What is taken of one who asks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// So many requests in a second, of each session or token, and of each address that has neither.
    pub requests_per_s: f64,
    /// So many at once, before that counts.
    pub requests_at_once: f64,
    /// So many connections of one address that is no proxy and not this computer's.
    pub connections: usize,
    /// So long a picture may take to come.
    pub picture_patience: Duration,
}

impl Default for Limits {
    /// Far beyond what a page or a program asks that waits for its answers.
    fn default() -> Self {
        Self {
            requests_per_s: 200.0,
            requests_at_once: 1000.0,
            connections: 64,
            picture_patience: Duration::from_secs(60),
        }
    }
}

/// What one may ask still, and when that was so.
#[derive(Debug, Clone, Copy)]
struct Left(f64, Instant);

/// What each may ask still.
#[derive(Debug)]
pub(crate) struct Rates {
    per_s: f64,
    at_once: f64,
    all: HashMap<String, Left>,
}

/// No more are remembered: those who asked nothing for long are as if they had never been.
const REMEMBERED: usize = 4096;

impl Rates {
    pub(crate) fn new(per_s: f64, at_once: f64) -> Self {
        Self {
            per_s,
            at_once,
            all: HashMap::new(),
        }
    }

    /// One more of that one.
    ///
    /// # Errors
    /// How long is to be waited.
    pub(crate) fn take(&mut self, whose: &str, now: Instant) -> Result<(), Duration> {
        if self.all.len() >= REMEMBERED {
            let (per_s, at_once) = (self.per_s, self.at_once);
            self.all
                .retain(|_, left| left.at(now, per_s, at_once) < at_once);
        }
        // Where there are too many to tell one from the other they share.
        let whose = match self.all.len() >= REMEMBERED && !self.all.contains_key(whose) {
            true => "",
            false => whose,
        };
        let full = Left(self.at_once, now);
        let left = self.all.entry(whose.to_owned()).or_insert(full);
        *left = Left(left.at(now, self.per_s, self.at_once), now);
        if left.0 < 1.0 {
            return Err(Duration::from_secs_f64(
                ((1.0 - left.0) / self.per_s).min(3600.0),
            ));
        }
        left.0 -= 1.0;
        Ok(())
    }
}

impl Left {
    fn at(self, now: Instant, per_s: f64, at_once: f64) -> f64 {
        let since = now.saturating_duration_since(self.1);
        (self.0 + per_s * since.as_secs_f64()).min(at_once)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn so_many_at_once_and_then_so_many_in_a_second() {
        let (mut rates, now) = (Rates::new(2.0, 5.0), Instant::now());
        let mut taken = |whose: &str, at: Duration| rates.take(whose, now + at);
        let ms = Duration::from_millis;
        for _ in 0..5 {
            assert_eq!(taken("a", ms(0)), Ok(()));
        }
        assert_eq!(taken("a", ms(0)), Err(ms(500)));
        assert_eq!(taken("a", ms(250)), Err(ms(250)));
        // Another one has as much as ever.
        assert_eq!(taken("b", ms(250)), Ok(()));
        assert_eq!(taken("a", ms(500)), Ok(()));
        assert_eq!(taken("a", ms(500)), Err(ms(500)));
        // After a while as at first, and no more.
        for _ in 0..5 {
            assert_eq!(taken("a", ms(60_000)), Ok(()));
        }
        assert_eq!(taken("a", ms(60_000)), Err(ms(500)));
    }

    #[test]
    fn whoever_comes_under_many_names_shares_one() {
        let (mut rates, now) = (Rates::new(0.01, 1.0), Instant::now());
        for k in 0..REMEMBERED {
            assert_eq!(rates.take(&format!("{k}"), now), Ok(()));
        }
        assert_eq!(rates.take("one more", now), Ok(()));
        assert!(rates.take("and one", now).is_err());
        assert!(rates.all.len() <= REMEMBERED + 1);
        // Once those are forgotten there is room again.
        let later = now + Duration::from_secs(200);
        assert_eq!(rates.take("and one", later), Ok(()));
        assert!(rates.all.len() <= 2);
    }
}
