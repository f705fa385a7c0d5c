//! The change of objective: retract, turn, come back.

use super::Instrument;
use crate::{Axis, ChangeRule, GateEvent, Motion, ObjectiveId, ScopeError, StagePose};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Nor an objective change, also by somebody who has to come from next door.
const CHANGE_TIMEOUT: Duration = Duration::from_secs(1800);

impl Instrument {
    /// Brings an objective into the beam and waits for it. Does nothing when it is there already.
    ///
    /// Where the rules say so, the stage retracts first, and afterwards comes back to where the new objective is expected in focus:
    /// as much higher or lower as it was found to be in focus before, or short of the old height by the rule's margin. Where it stood nearer
    /// to the specimen than the last objective was found in focus, this counts from that focus. A stage that was retracted already stays so.
    ///
    /// Where the objective works in another medium than the one before, somebody is asked first, before anything moves; that answer
    /// is for this one change.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`], [`ScopeError::ImmersionNotAgreed`], and as [`Instrument::move_to`]. When the way back is refused the stage stays retracted.
    pub fn select_objective(&self, id: &ObjectiveId) -> Result<(), ScopeError> {
        self.check_cancel()?;
        self.gate.objective(id)?;
        self.remember_beginning()?;
        let before = self.gate.current_objective()?;
        if before.as_ref() == Some(id) {
            return Ok(());
        }
        self.ask_before_immersion(id)?;
        let ChangeRule::Retracted { margin, .. } = self.gate.rules().change else {
            return self.turn(id);
        };
        let to = |z: f64| StagePose::default().with_si(Axis::Z, z);
        let side = self.gate.positive_z();
        let work = self.gate.at_work()?;
        if let Some(work) = work {
            self.move_to(&to(work.retreat_m))?;
        }
        self.turn(id).map_err(|error| match (error, work) {
            (ScopeError::ChangeEnded { asked, .. }, Some(work)) => ScopeError::ChangeEnded {
                asked,
                retracted_from_um: Some(work.here_m * 1e6),
            },
            (error, _) => error,
        })?;
        if let Some(work) = work {
            let focus = self.focus_positions();
            let of = |id: &ObjectiveId| focus.get(id).map(|height| height.m());
            let old = before.as_ref().and_then(of);
            // Nearer to the specimen than the last objective was in focus, which may cost that one nothing, this one does not come.
            let from = match old {
                Some(old) if side.nearer_by(work.here_m, old) > 0.0 => old,
                _ => work.here_m,
            };
            let expected = match old.zip(of(id)) {
                Some((old, new)) => from + (new - old),
                None => side.away(from, margin),
            };
            if side.nearer_by(expected, work.retreat_m) > 0.0 {
                self.move_in_steps(&to(expected))?;
            }
        }
        Ok(())
    }

    /// Where the objective works in another medium, asks whether the specimen is ready for it.
    fn ask_before_immersion(&self, id: &ObjectiveId) -> Result<(), ScopeError> {
        let Some(change) = self.gate.immersion_change(id)? else {
            return Ok(());
        };
        let wanted = || !self.gate.is_cancelled();
        let ask = self.ask_immersion.as_ref();
        if ask.is_some_and(|ask| ask(&change, &wanted)) {
            self.gate.agree_to_immersion(&change);
            return self.check_cancel();
        }
        self.check_cancel()?;
        let refused = ScopeError::ImmersionNotAgreed { change };
        self.gate.tell(|| GateEvent::ChangeRefused {
            to: id.clone(),
            why: refused.to_string(),
        });
        Err(refused)
    }

    fn turn(&self, id: &ObjectiveId) -> Result<(), ScopeError> {
        self.gate.start_change(id).map_err(|e| self.seen(e))?;
        self.objective_changes.fetch_add(1, Ordering::SeqCst);
        let settled = self.wait("nosepiece", CHANGE_TIMEOUT, || self.gate.poll_nosepiece())?;
        let turned = self.check_turned(id, settled);
        let to = id.clone();
        self.gate.tell(|| match &turned {
            Ok(()) => GateEvent::Changed { to },
            Err(why) => GateEvent::NotChanged {
                to,
                why: why.to_string(),
            },
        });
        turned
    }

    fn check_turned(&self, id: &ObjectiveId, settled: Motion) -> Result<(), ScopeError> {
        if settled == Motion::Stopped {
            return Err(ScopeError::ChangeEnded {
                asked: id.clone(),
                retracted_from_um: None,
            });
        }
        let now = self.gate.current_objective()?;
        if settled != Motion::Settled || now.as_ref() != Some(id) {
            return Err(ScopeError::Device {
                device: "nosepiece",
                detail: format!(
                    "asked for {id}, but {} is active",
                    now.map_or("nothing known".to_string(), |o| o.0)
                ),
            });
        }
        Ok(())
    }
}
