//! Browsers that are logged in: by the checksum of what they have as a cookie. They end with the program.

use std::collections::HashMap;
use std::time::{Duration, Instant};

/// A session that nobody used for so long has ended.
const IDLE: Duration = Duration::from_secs(12 * 3600);
/// No more at once: the one that was used longest ago goes.
const MOST: usize = 1000;

#[derive(Default)]
pub(super) struct Sessions(HashMap<String, (String, Instant)>);

impl Sessions {
    pub(super) fn add(&mut self, key: &str, user: &str, now: Instant) {
        self.0.retain(|_, (_, last)| now - *last < IDLE);
        if self.0.len() >= MOST {
            let oldest = self.0.iter().min_by_key(|(_, (_, last))| *last);
            if let Some(oldest) = oldest.map(|(key, _)| key.clone()) {
                self.0.remove(&oldest);
            }
        }
        self.0.insert(key.into(), (user.into(), now));
    }

    pub(super) fn user(&mut self, key: &str, now: Instant) -> Option<String> {
        let (user, last) = self.0.get_mut(key)?;
        if now - *last >= IDLE {
            self.0.remove(key);
            return None;
        }
        *last = now;
        Some(user.clone())
    }

    pub(super) fn remove(&mut self, key: &str) {
        self.0.remove(key);
    }

    pub(super) fn remove_user(&mut self, name: &str) {
        self.0.retain(|_, (user, _)| user != name);
    }
}
