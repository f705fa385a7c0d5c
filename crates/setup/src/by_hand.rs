//! Nosepieces without a motor: one that somebody turns, and one that nobody can.

use scopeservo_scope::{KnownBy, Motion, Nosepiece, Objective, ObjectiveId, ScopeError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Asks somebody to bring an objective into the beam, and waits while the second argument says that the answer is wanted. `false` when
/// they will not, or it is wanted no more.
pub type Ask = Arc<dyn Fn(&Objective, &dyn Fn() -> bool) -> bool + Send + Sync>;

/// A nosepiece that somebody turns when asked to.
pub(crate) struct ByHand {
    objectives: Vec<Objective>,
    ask: Ask,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Clone, PartialEq)]
struct State {
    current: Option<ObjectiveId>,
    motion: Motion,
    /// Counts the requests, so that a late answer to a stopped one changes nothing.
    asked: u64,
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl ByHand {
    /// Nobody knows yet which objective is active.
    pub(crate) fn new(objectives: Vec<Objective>, ask: Ask) -> Self {
        // There is nothing to ask about a single one.
        let only = (objectives.len() == 1).then(|| objectives[0].id.clone());
        Self {
            objectives,
            ask,
            state: Arc::new(Mutex::new(State {
                current: only,
                motion: Motion::Settled,
                asked: 0,
            })),
        }
    }
}

impl Nosepiece for ByHand {
    fn objectives(&self) -> &[Objective] {
        &self.objectives
    }

    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        Ok(lock(&self.state).current.clone())
    }

    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        let names: Vec<&str> = self.objectives.iter().map(|o| o.id.0.as_str()).collect();
        let Some(objective) = self.objectives.iter().find(|o| o.id == *to).cloned() else {
            return Err(ScopeError::NoSuchObjective {
                asked: to.clone(),
                available: names.join(", "),
            });
        };
        let turn = {
            let mut state = lock(&self.state);
            if state.motion == Motion::Moving {
                return Err(ScopeError::Busy {
                    device: "nosepiece",
                });
            }
            state.current = None;
            state.motion = Motion::Moving;
            state.asked += 1;
            state.asked
        };
        let (ask, state) = (self.ask.clone(), self.state.clone());
        std::thread::spawn(move || {
            let wanted = |state: &State| state.asked == turn && state.motion == Motion::Moving;
            let done = ask(&objective, &|| wanted(&lock(&state)));
            let mut state = lock(&state);
            if wanted(&state) {
                state.current = done.then(|| objective.id.clone());
                state.motion = match done {
                    true => Motion::Settled,
                    false => Motion::Stopped,
                };
            }
        });
        Ok(())
    }

    fn poll(&self) -> Result<Motion, ScopeError> {
        Ok(lock(&self.state).motion)
    }

    fn stop(&self) -> Result<(), ScopeError> {
        let mut state = lock(&self.state);
        if state.motion == Motion::Moving {
            state.motion = Motion::Stopped;
        }
        Ok(())
    }

    fn known_by(&self) -> KnownBy {
        match self.objectives.len() {
            // There is no other.
            1 => KnownBy::Sensor,
            _ => KnownBy::Report,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::Immersion;
    use std::sync::mpsc::channel;
    use std::time::Duration;

    fn objectives() -> Vec<Objective> {
        ["10x", "40x"]
            .map(|id| Objective {
                id: ObjectiveId(id.into()),
                magnification: 100.0,
                numerical_aperture: 0.3,
                nominal_um_per_px: 1.0,
                immersion: Immersion::Air,
            })
            .into()
    }

    fn settle(nosepiece: &ByHand) -> Motion {
        for _ in 0..500 {
            let motion = nosepiece.poll().unwrap();
            if motion != Motion::Moving {
                return motion;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        Motion::Moving
    }

    #[test]
    fn somebody_is_asked_and_waited_for() {
        let (answer, answers) = channel();
        let answers = Mutex::new(answers);
        let ask: Ask = Arc::new(move |_, _| answers.lock().unwrap().recv().unwrap());
        let nosepiece = ByHand::new(objectives(), ask);
        let id = |name: &str| ObjectiveId(name.into());
        assert_eq!(nosepiece.current(), Ok(None));
        nosepiece.start_change(&id("40x")).unwrap();
        assert_eq!(nosepiece.poll(), Ok(Motion::Moving));
        assert!(nosepiece.start_change(&id("10x")).is_err());
        answer.send(true).unwrap();
        assert_eq!(settle(&nosepiece), Motion::Settled);
        assert_eq!(nosepiece.current(), Ok(Some(id("40x"))));
        // The instrument takes that for a report until an image has shown it.
        assert_eq!(nosepiece.known_by(), KnownBy::Report);
        nosepiece.start_change(&id("10x")).unwrap();
        assert_eq!(nosepiece.current(), Ok(None));
        answer.send(false).unwrap();
        assert_eq!(settle(&nosepiece), Motion::Stopped);
        assert_eq!(nosepiece.current(), Ok(None));
        // Stopped while somebody thinks: a late yes is none.
        nosepiece.start_change(&id("10x")).unwrap();
        nosepiece.stop().unwrap();
        answer.send(true).unwrap();
        std::thread::sleep(Duration::from_millis(50));
        assert_eq!(nosepiece.poll(), Ok(Motion::Stopped));
        assert_eq!(nosepiece.current(), Ok(None));
        assert!(nosepiece.start_change(&id("63x")).is_err());
    }

    #[test]
    fn a_single_objective_is_in_the_beam() {
        let mut all = objectives();
        all.truncate(1);
        let nosepiece = ByHand::new(all, Arc::new(|_, _| false));
        assert_eq!(nosepiece.known_by(), KnownBy::Sensor);
        assert_eq!(nosepiece.current(), Ok(Some(ObjectiveId("10x".into()))));
    }
}
