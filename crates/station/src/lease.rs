//! One owner of motion.
//!
//! A lease runs on a clock of its own, by default the monotonic one of the computer, and not on the instrument's: who renews it lives in
//! real time, and a simulated instrument lets minutes pass in a second.
//!
//! Expiry is noticed when somebody looks: a job before each step, and whoever asks. A job whose lease is lost **pauses** before its
//! next step. The step under way ends, at most a few moves and frames within the rules; then nothing moves, and nothing that was reached
//! is thrown away. A stop would be no safer (it leaves the stage where it is as well) and would end work that the owner, back after a
//! lost connection, can simply go on with. Whoever takes the lease next resumes the job or stops it.

use crate::bus::Bus;
use crate::{Refusal, StationEvent, lock};
use scopeservo_scope::{Clock, Timestamp};
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A lease that is to last longer lasts so long: a hundred years.
const LONGEST: Duration = Duration::from_secs(3_155_760_000);

/// The right to move the instrument, as long as it is renewed. Dropping it changes nothing: give it back, or let it expire.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lease {
    owner: String,
    number: u64,
}

impl Lease {
    /// Who works with the instrument.
    pub fn owner(&self) -> &str {
        &self.owner
    }

    pub(crate) fn number(&self) -> u64 {
        self.number
    }
}

pub(crate) struct Leases {
    clock: Arc<dyn Clock>,
    bus: Bus,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    held: Option<Held>,
    given: u64,
}

struct Held {
    lease: Lease,
    until: Option<Timestamp>,
}

impl Leases {
    pub(crate) fn new(clock: Arc<dyn Clock>, bus: Bus) -> Self {
        Self {
            clock,
            bus,
            state: Mutex::default(),
        }
    }

    /// `lasting`: `None` for an owner that lives as long as the session.
    pub(crate) fn take(&self, owner: &str, lasting: Option<Duration>) -> Result<Lease, Refusal> {
        let mut state = lock(&self.state);
        self.expire(&mut state);
        if let Some(held) = &state.held {
            let left = |until: Timestamp| until.since(self.clock.now()).as_secs_f64();
            return Err(Refusal::Held {
                owner: held.lease.owner.clone(),
                seconds_left: held.until.map(left),
            });
        }
        state.given += 1;
        let lease = Lease {
            owner: owner.to_owned(),
            number: state.given,
        };
        state.held = Some(Held {
            lease: lease.clone(),
            until: self.until(lasting),
        });
        self.bus.station(StationEvent::LeaseTaken {
            owner: owner.to_owned(),
        });
        Ok(lease)
    }

    /// From now on it lasts so long.
    pub(crate) fn renew(&self, lease: &Lease, lasting: Option<Duration>) -> Result<(), Refusal> {
        let mut state = lock(&self.state);
        self.expire(&mut state);
        let until = self.until(lasting);
        match &mut state.held {
            Some(held) if held.lease == *lease => {
                held.until = until;
                Ok(())
            }
            _ => Err(lost(lease)),
        }
    }

    pub(crate) fn give_back(&self, lease: &Lease) -> Result<(), Refusal> {
        let mut state = lock(&self.state);
        self.expire(&mut state);
        match &state.held {
            Some(held) if held.lease == *lease => {
                self.lose(&mut state, false);
                Ok(())
            }
            _ => Err(lost(lease)),
        }
    }

    pub(crate) fn check(&self, lease: &Lease) -> Result<(), Refusal> {
        match self.is_held(lease.number) {
            true => Ok(()),
            false => Err(lost(lease)),
        }
    }

    pub(crate) fn is_held(&self, number: u64) -> bool {
        let mut state = lock(&self.state);
        self.expire(&mut state);
        let held = state.held.as_ref();
        held.is_some_and(|held| held.lease.number == number)
    }

    pub(crate) fn owner(&self) -> Option<String> {
        let mut state = lock(&self.state);
        self.expire(&mut state);
        state.held.as_ref().map(|held| held.lease.owner.clone())
    }

    fn until(&self, lasting: Option<Duration>) -> Option<Timestamp> {
        lasting.map(|time| self.clock.now().after(time.min(LONGEST)))
    }

    fn expire(&self, state: &mut State) {
        let until = state.held.as_ref().and_then(|held| held.until);
        if until.is_some_and(|until| self.clock.now() >= until) {
            self.lose(state, true);
        }
    }

    fn lose(&self, state: &mut State, expired: bool) {
        if let Some(held) = state.held.take() {
            let owner = held.lease.owner;
            self.bus.station(StationEvent::LeaseLost { owner, expired });
        }
    }
}

fn lost(lease: &Lease) -> Refusal {
    Refusal::LeaseLost {
        owner: lease.owner.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::VirtualClock;

    #[test]
    fn a_lease_has_one_owner_and_ends_when_it_is_not_renewed() {
        let clock = Arc::new(VirtualClock::new());
        let leases = Leases::new(clock.clone(), Bus::default());
        let half_a_minute = Some(Duration::from_secs(30));
        let ada = leases.take("Ada", half_a_minute).unwrap();
        clock.sleep(Duration::from_secs(20));
        assert_eq!(
            leases.take("Bob", None),
            Err(Refusal::Held {
                owner: "Ada".into(),
                seconds_left: Some(10.0),
            })
        );
        leases.renew(&ada, half_a_minute).unwrap();
        clock.sleep(Duration::from_secs(29));
        assert_eq!(leases.check(&ada), Ok(()));
        clock.sleep(Duration::from_secs(1));
        assert!(matches!(
            leases.renew(&ada, half_a_minute),
            Err(Refusal::LeaseLost { .. })
        ));
        // Until it is given back, and of no use to her who had it before.
        let long = leases.take("Eve", Some(Duration::MAX)).unwrap();
        leases.give_back(&long).unwrap();
        let bob = leases.take("Bob", None).unwrap();
        clock.sleep(Duration::from_secs(1_000_000));
        assert_eq!(leases.owner().as_deref(), Some("Bob"));
        assert!(leases.give_back(&ada).is_err() && leases.check(&ada).is_err());
        leases.give_back(&bob).unwrap();
        assert_eq!(leases.owner(), None);
    }
}
