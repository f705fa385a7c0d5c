//! The change of objective: retract, turn, come back.

use super::Instrument;
use crate::{Axis, ChangeRule, GateEvent, Motion, ObjectiveId, ScopeError, StagePose};
use serde::{Deserialize, Serialize};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Nor an objective change, also by somebody who has to come from next door.
const CHANGE_TIMEOUT: Duration = Duration::from_secs(1800);

fn height(z_m: f64) -> StagePose {
    StagePose::default().with_si(Axis::Z, z_m)
}

/// A change of objective, as it was before anything moved. Kept, it can be gone on with after a kill in the middle of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObjectiveChange {
    /// The objective that is to come.
    to: ObjectiveId,
    /// The one that was there, where that was known.
    from: Option<ObjectiveId>,
    /// The height at which the stage stood where the nosepiece may not turn, m.
    stood_m: Option<f64>,
}

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
        match self.planned_change(id)? {
            Some(change) => self.change(&change),
            None => Ok(()),
        }
    }

    /// What [`Instrument::select_objective`] has to do; `None` where the objective is there. Nothing moves.
    ///
    /// # Errors
    /// [`ScopeError::NoSuchObjective`], and what the devices report.
    pub fn planned_change(&self, id: &ObjectiveId) -> Result<Option<ObjectiveChange>, ScopeError> {
        self.check_cancel()?;
        self.gate.objective(id)?;
        self.remember_beginning()?;
        let from = self.gate.current_objective()?;
        if from.as_ref() == Some(id) {
            return Ok(None);
        }
        Ok(Some(ObjectiveChange {
            to: id.clone(),
            from,
            stood_m: self.gate.at_work()?.map(|work| work.here_m),
        }))
    }

    /// Makes a planned change, or what is left of it.
    ///
    /// # Errors
    /// As [`Instrument::select_objective`].
    pub fn change(&self, change: &ObjectiveChange) -> Result<(), ScopeError> {
        self.check_cancel()?;
        self.remember_beginning()?;
        let id = &change.to;
        if self.gate.current_objective()?.as_ref() != Some(id) {
            self.ask_before_immersion(id)?;
            if let Some(work) = self.gate.at_work()? {
                self.move_to(&height(work.retreat_m))?;
            }
            self.turn(id)
                .map_err(|error| match (error, change.stood_m) {
                    (ScopeError::ChangeEnded { asked, .. }, Some(stood_m)) => {
                        ScopeError::ChangeEnded {
                            asked,
                            retracted_from_um: Some(stood_m * 1e6),
                        }
                    }
                    (error, _) => error,
                })?;
        }
        self.come_back(change)
    }

    /// To where the new objective is expected in focus, or short of where the stage stood.
    fn come_back(&self, change: &ObjectiveChange) -> Result<(), ScopeError> {
        let (ChangeRule::Retracted { margin, .. }, Some(stood)) =
            (self.gate.rules().change, change.stood_m)
        else {
            return Ok(());
        };
        let side = self.gate.positive_z();
        let focus = self.focus_positions();
        let of = |id: &ObjectiveId| focus.get(id).map(|height| height.m());
        let old = change.from.as_ref().and_then(of);
        // Nearer to the specimen than the last objective was in focus, which may cost that one nothing, this one does not come.
        let from = match old {
            Some(old) if side.nearer_by(stood, old) > 0.0 => old,
            _ => stood,
        };
        let expected = match old.zip(of(&change.to)) {
            Some((old, new)) => from + (new - old),
            None => side.away(from, margin),
        };
        let here = self.gate.position()?.si(Axis::Z);
        let here = here.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?;
        match side.nearer_by(expected, here) > 0.0 {
            true => self.move_in_steps(&height(expected)).map(drop),
            false => Ok(()),
        }
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
