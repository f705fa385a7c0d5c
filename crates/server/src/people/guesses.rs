//! Wrong passwords: after a few, whoever goes on has to wait, and longer each time.
//!
//! What is counted is a name at a place, and a place by itself: whoever guesses at a name from one place keeps its owner at another from nothing.

use crate::error::ApiError;
use std::collections::HashMap;
use std::hash::Hash;
use std::time::{Duration, Instant};

/// So many wrong ones of a name at a place are free.
const FREE: u32 = 5;
/// So many of all names at a place.
const FREE_OF_PLACE: u32 = 20;
/// A name that was guessed at so often, from many places, has one free one at each.
const MANY: u32 = 50;
/// Then so long passes before the next one, twice as long after it, and so on, up to the longest.
const WAIT: Duration = Duration::from_secs(30);
const LONGEST: Duration = Duration::from_secs(3600);
/// Nobody guessed for so long: it is forgotten.
const FORGOTTEN: Duration = Duration::from_secs(24 * 3600);
/// No more are remembered of each kind: the oldest goes.
const REMEMBERED: usize = 1000;

#[derive(Debug, Clone, Copy)]
struct Tries {
    wrong: u32,
    last: Instant,
}

/// How often somebody was wrong.
struct Counts<K>(HashMap<K, Tries>);

impl<K> Default for Counts<K> {
    fn default() -> Self {
        Self(HashMap::new())
    }
}

impl<K: Hash + Eq + Clone> Counts<K> {
    fn wrong(&self, key: &K, now: Instant) -> u32 {
        let tries = self.0.get(key);
        let tries = tries.filter(|t| now.saturating_duration_since(t.last) < FORGOTTEN);
        tries.map_or(0, |t| t.wrong)
    }

    /// How long is to be waited still, where so many are free.
    fn wait(&self, key: &K, free: u32, now: Instant) -> Duration {
        let wrong = self.wrong(key, now);
        let (Some(tries), true) = (self.0.get(key), wrong >= free) else {
            return Duration::ZERO;
        };
        // Beyond the longest it grows no more.
        let doubled = 1 << (wrong - free).min(10);
        let whole = (WAIT * doubled).min(LONGEST);
        whole.saturating_sub(now.saturating_duration_since(tries.last))
    }

    fn count(&mut self, key: K, now: Instant) {
        let wrong = self.wrong(&key, now) + 1;
        if self.0.len() >= REMEMBERED && !self.0.contains_key(&key) {
            let oldest = self.0.iter().min_by_key(|(_, tries)| tries.last);
            if let Some(oldest) = oldest.map(|(key, _)| key.clone()) {
                self.0.remove(&oldest);
            }
        }
        self.0.insert(key, Tries { wrong, last: now });
    }
}

#[derive(Default)]
pub(super) struct Guesses {
    pairs: Counts<[String; 2]>,
    places: Counts<String>,
    names: Counts<String>,
}

impl Guesses {
    /// Whether this name may be tried at that place now.
    pub(super) fn may(&self, name: &str, place: &str, now: Instant) -> Result<(), ApiError> {
        let free = match self.names.wrong(&name.to_owned(), now) {
            many if many >= MANY => 1,
            _ => FREE,
        };
        let pair = [name, place].map(str::to_owned);
        let of_name = self.pairs.wait(&pair, free, now);
        let of_place = self.places.wait(&pair[1], FREE_OF_PLACE, now);
        let wait = of_name.max(of_place);
        if wait.is_zero() {
            return Ok(());
        }
        let whose = match of_name >= of_place {
            true => "for this name",
            false => "from there",
        };
        let s = wait.as_secs_f64().ceil();
        let message = format!(
            "too many wrong passwords {whose}: wait {s:.0} s. After another one it is longer"
        );
        Err(ApiError::too_many(message, wait))
    }

    /// What came of a try.
    pub(super) fn was(&mut self, name: &str, place: &str, is_right: bool, now: Instant) {
        let pair = [name, place].map(str::to_owned);
        if !is_right {
            self.places.count(pair[1].clone(), now);
            self.names.count(pair[0].clone(), now);
            self.pairs.count(pair, now);
            return;
        }
        // Whoever mistyped it was no stranger.
        if let (Some(own), Some(all)) = (self.pairs.0.remove(&pair), self.places.0.get_mut(place)) {
            all.wrong = all.wrong.saturating_sub(own.wrong);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: Duration = Duration::from_secs(1);

    /// So many wrong ones, each as soon as it may be; when the last one was.
    fn guess(of: &mut Guesses, name: &str, place: &str, times: usize, mut now: Instant) -> Instant {
        for _ in 0..times {
            while of.may(name, place, now).is_err() {
                now += S;
            }
            of.was(name, place, false, now);
        }
        now
    }

    fn wait(of: &Guesses, name: &str, place: &str, now: Instant) -> u64 {
        let refused = of.may(name, place, now).err();
        refused.map_or(0, |e| e.retry_after.unwrap().as_secs())
    }

    #[test]
    fn the_wait_grows_and_has_an_end() {
        let (mut guesses, mut now) = (Guesses::default(), Instant::now());
        now = guess(&mut guesses, "anna", "a", 4, now);
        assert_eq!(wait(&guesses, "anna", "a", now), 0);
        let mut waits = Vec::new();
        for _ in 0..10 {
            now = guess(&mut guesses, "anna", "a", 1, now);
            waits.push(wait(&guesses, "anna", "a", now));
        }
        assert_eq!(waits, [30, 60, 120, 240, 480, 960, 1920, 3600, 3600, 3600]);
        assert_eq!(wait(&guesses, "anna", "a", now + 3599 * S), 1);
        assert_eq!(wait(&guesses, "anna", "a", now + 3600 * S), 0);
        // Who knows it then begins anew.
        guesses.was("anna", "a", true, now + 3600 * S);
        assert_eq!(wait(&guesses, "anna", "a", now + 3600 * S), 0);
    }

    #[test]
    fn whoever_guesses_keeps_the_owner_elsewhere_from_nothing() {
        let (mut guesses, now) = (Guesses::default(), Instant::now());
        let mut late = guess(&mut guesses, "anna", "a", 40, now);
        assert_eq!(wait(&guesses, "anna", "b", late), 0);
        // From a hundred places: whoever comes from another still has a try, and the right one is let in.
        for k in 0..100 {
            late = guess(&mut guesses, "anna", &format!("place {k}"), 3, late);
        }
        assert_eq!(wait(&guesses, "anna", "b", late), 0);
        guesses.was("anna", "b", false, late);
        assert_eq!(wait(&guesses, "anna", "b", late), 30);
        assert_eq!(wait(&guesses, "anna", "b", late + 30 * S), 0);
    }

    #[test]
    fn a_place_that_goes_through_names_waits_for_all_of_them() {
        let (mut guesses, now) = (Guesses::default(), Instant::now());
        for k in 0..20 {
            guesses.was(&format!("name {k}"), "a", false, now);
        }
        assert_eq!(wait(&guesses, "somebody", "a", now), 30);
        assert_eq!(wait(&guesses, "somebody", "b", now), 0);
        // Whoever mistypes and then knows it costs the others there nothing.
        for k in 0..40 {
            let name = format!("name {k}");
            guesses.was(&name, "c", false, now);
            guesses.was(&name, "c", true, now);
        }
        assert_eq!(wait(&guesses, "somebody", "c", now), 0);
        // After a day nobody remembers.
        assert_eq!(wait(&guesses, "somebody", "a", now + FORGOTTEN), 0);
        for k in 0..5000 {
            guesses.was(&format!("name {k}"), &format!("{k}"), false, now);
        }
        assert!(guesses.pairs.0.len() <= REMEMBERED && guesses.places.0.len() <= REMEMBERED);
    }
}
