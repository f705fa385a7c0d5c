//! Who drives: the station's lease, held by a browser or a program as long as it says that it is there.

use crate::error::ApiError;
use crate::lock;
use crate::people::Caller;
use scopeservo_station::{Lease, Refusal, Session};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Who does not say so for so long is gone.
const LASTS: Duration = Duration::from_secs(15);

/// The one seat of an instrument.
pub(crate) struct Seat {
    session: Arc<Session>,
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    held: Option<Held>,
    /// Who asks for it: key and name.
    asked: Option<(String, String)>,
}

struct Held {
    lease: Lease,
    key: String,
    user: String,
}

impl Seat {
    pub(crate) fn new(session: Arc<Session>) -> Self {
        Self {
            session,
            inner: Mutex::default(),
        }
    }

    /// Takes the seat, or stays in it. The same person at another browser takes it along.
    ///
    /// # Errors
    /// `held`, when somebody else has it.
    pub(crate) fn take(&self, caller: &Caller) -> Result<Lease, ApiError> {
        let mut inner = lock(&self.inner);
        if let Some(held) = &mut inner.held
            && held.user == caller.user
            && self.session.renew(&held.lease, Some(LASTS)).is_ok()
        {
            held.key.clone_from(&caller.key);
            return Ok(held.lease.clone());
        }
        self.sit(&mut inner, &caller.key, &caller.user)
    }

    fn sit(&self, inner: &mut Inner, key: &str, user: &str) -> Result<Lease, ApiError> {
        let lease = self.session.take_lease(user, Some(LASTS))?;
        inner.held = Some(Held {
            lease: lease.clone(),
            key: key.into(),
            user: user.into(),
        });
        if inner.asked.as_ref().is_some_and(|(k, _)| k == key) {
            inner.asked = None;
        }
        Ok(lease)
    }

    /// Whoever has it is there still.
    pub(crate) fn renew(&self, caller: &Caller) {
        let inner = lock(&self.inner);
        if let Some(held) = inner.held.as_ref().filter(|held| held.key == caller.key) {
            // One that was lost meanwhile is taken again by the next job.
            let _ = self.session.renew(&held.lease, Some(LASTS));
        }
    }

    /// Asks whoever has it. A free one is taken.
    pub(crate) fn ask(&self, caller: &Caller) {
        if self.take(caller).is_err() {
            lock(&self.inner).asked = Some((caller.key.clone(), caller.user.clone()));
        }
    }

    /// Gives it to whoever asked, or back.
    pub(crate) fn give(&self, caller: &Caller) -> Result<(), ApiError> {
        let mut inner = lock(&self.inner);
        let is_theirs = |held: &Held| held.key == caller.key;
        let Some(held) = inner.held.take_if(|held| is_theirs(held)) else {
            let message = "you do not drive this instrument";
            return Err(ApiError::conflict("lease_lost", message));
        };
        self.session.give_back(&held.lease)?;
        if let Some((key, user)) = inner.asked.take() {
            self.sit(&mut inner, &key, &user)?;
        }
        Ok(())
    }

    /// Whoever has it goes: it is whoever asked for it, or nobody's.
    pub(crate) fn leave(&self, caller: &Caller) {
        // Who did not have it leaves nothing.
        let _ = self.give(caller);
        let mut inner = lock(&self.inner);
        inner.asked.take_if(|(key, _)| *key == caller.key);
    }

    /// Whether this one has it, or could take it.
    ///
    /// # Errors
    /// `held`.
    pub(crate) fn is_free_for(&self, caller: &Caller) -> Result<(), ApiError> {
        match self.owner() {
            Some(owner) if owner != caller.user => Err(Refusal::Held {
                owner,
                seconds_left: None,
            }
            .into()),
            _ => Ok(()),
        }
    }

    /// Who drives.
    pub(crate) fn owner(&self) -> Option<String> {
        self.session.owner()
    }

    /// Whether that is this browser or program.
    pub(crate) fn is_of(&self, key: &str) -> bool {
        let inner = lock(&self.inner);
        let theirs = inner.held.as_ref().is_some_and(|held| held.key == key);
        theirs && self.session.owner().is_some()
    }

    /// Who asks for it.
    pub(crate) fn asked_by(&self) -> Option<String> {
        let inner = lock(&self.inner);
        inner.asked.as_ref().map(|(_, user)| user.clone())
    }
}
