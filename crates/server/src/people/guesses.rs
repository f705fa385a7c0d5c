//! Wrong passwords: after a few, a name has to wait.

use crate::error::ApiError;
use axum::http::StatusCode;
use std::collections::HashMap;
use std::time::{Duration, Instant};

/// So many wrong ones are free.
const FREE: u32 = 5;
/// Then so long passes between two.
const WAIT: Duration = Duration::from_secs(30);
/// No more names are remembered.
const NAMES: usize = 1000;

#[derive(Default)]
pub(super) struct Guesses(HashMap<String, (u32, Instant)>);

impl Guesses {
    /// Whether this name may be tried now.
    pub(super) fn may(&self, name: &str, now: Instant) -> Result<(), ApiError> {
        let wait = match self.0.get(name) {
            Some((wrong, last)) if *wrong >= FREE => WAIT.saturating_sub(now - *last),
            _ => Duration::ZERO,
        };
        match wait.is_zero() {
            true => Ok(()),
            false => {
                let message = format!(
                    "too many wrong passwords for this name: wait {:.0} s",
                    wait.as_secs_f64().ceil()
                );
                let status = StatusCode::TOO_MANY_REQUESTS;
                Err(ApiError::new(status, "too_many", message))
            }
        }
    }

    pub(super) fn was(&mut self, name: &str, is_right: bool, now: Instant) {
        if is_right {
            self.0.remove(name);
            return;
        }
        if self.0.len() >= NAMES {
            self.0.retain(|_, (_, last)| now - *last < WAIT);
        }
        if self.0.len() < NAMES {
            let (wrong, last) = self.0.entry(name.into()).or_insert((0, now));
            *wrong += 1;
            *last = now;
        }
    }
}
