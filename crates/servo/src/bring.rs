//! An objective brought into the beam, into focus, and, where only somebody's word tells which one is there, shown by an image to
//! be the one.

use crate::event::tell;
use crate::procedure::{Procedure, Progress, withdrawn};
use crate::{
    Event, Focus, FocusOptions, FocusResult, Identify, Phase, ServoError, Sink, VisionOptions,
};
use scopeservo_scope::{Instrument, ObjectiveChange, ObjectiveId};
use serde::{Deserialize, Serialize};

/// So often somebody is asked again who brought another objective into the beam.
const MISTAKES: u8 = 2;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Switch,
    Focus(Box<Focus>),
    Identify(Box<Identify>),
}

/// Changing, focusing and looking as a step machine. Its output is the focus that was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Bring {
    objective: ObjectiveId,
    /// `None`: the view is in focus, or somebody focuses by hand.
    focus: Option<FocusOptions>,
    vision: VisionOptions,
    state: State,
    found: Option<FocusResult>,
    mistakes: u8,
    /// The change that is under way, written down before anything moves.
    #[serde(default)]
    change: Option<ObjectiveChange>,
}

impl Bring {
    /// `focus`: `None` to leave the height as the change left it.
    pub fn new(objective: ObjectiveId, focus: Option<FocusOptions>, vision: VisionOptions) -> Self {
        Self {
            objective,
            focus,
            vision,
            state: State::Switch,
            found: None,
            mistakes: 0,
            change: None,
        }
    }

    fn turn_again(&mut self) {
        (self.state, self.change) = (State::Switch, None);
    }

    /// The height from which the focus was looked for, um.
    pub(crate) fn focus_began_um(&self) -> Option<f64> {
        match &self.state {
            State::Focus(focus) => focus.began_um(),
            State::Switch | State::Identify(_) => None,
        }
    }

    fn enter(&self, scope: &Instrument, sink: &mut dyn Sink, phase: Phase) {
        let objective = self.objective.clone();
        tell(scope, sink, Event::PhaseStarted { phase, objective });
    }

    /// The end, unless an image has to show which objective is there.
    fn focused(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Progress<Option<FocusResult>> {
        if !scope.gate().objective_is_reported() {
            return Progress::Done(self.found);
        }
        self.enter(scope, sink, Phase::Identify);
        let identify = Identify::new(self.objective.clone(), self.vision.clone());
        self.state = State::Identify(Box::new(identify));
        Progress::Continue
    }
}

impl Bring {
    fn advance(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Option<FocusResult>>, ServoError> {
        // A run that goes on after a kill may find another objective than it left.
        if self.state != State::Switch
            && scope.gate().current_objective()?.as_ref() != Some(&self.objective)
        {
            self.turn_again();
        }
        match &mut self.state {
            State::Switch => {
                match &self.change {
                    Some(change) => scope.change(change)?,
                    None => {
                        self.enter(scope, sink, Phase::Switch);
                        self.change = scope.planned_change(&self.objective)?;
                        if self.change.is_some() {
                            return Ok(Progress::Continue);
                        }
                    }
                }
                let Some(options) = self.focus.clone() else {
                    return Ok(self.focused(scope, sink));
                };
                let focus = Focus::new(scope.objective(&self.objective)?.clone(), options);
                self.enter(scope, sink, Phase::Focus);
                self.state = State::Focus(Box::new(focus));
            }
            State::Focus(focus) => {
                if let Progress::Done(result) = focus.step(scope, sink)? {
                    self.found = Some(result);
                    let objective = self.objective.clone();
                    tell(scope, sink, Event::Focused { objective, result });
                    return Ok(self.focused(scope, sink));
                }
            }
            State::Identify(identify) => {
                let seen = identify.step(scope, sink).inspect_err(|_| {
                    // Nobody knows with which objective this was in focus.
                    scope.forget_focus(&self.objective);
                })?;
                if let Progress::Done(identity) = seen {
                    if identity.as_told {
                        return Ok(Progress::Done(self.found));
                    }
                    // What was found in focus was with another objective.
                    scope.forget_focus(&self.objective);
                    // What fits no objective is no mistake of whoever turned it: the scales in the file may be wrong.
                    let again =
                        scope.gate().contradict_objective() && identity.looks_like.is_some();
                    if !again || self.mistakes == MISTAKES {
                        return Err(ServoError::WrongObjective {
                            told: self.objective.clone(),
                            looks_like: identity.looks_like,
                            um_per_px: identity.um_per_px,
                        });
                    }
                    self.mistakes += 1;
                    self.turn_again();
                }
            }
        }
        Ok(Progress::Continue)
    }
}

impl Procedure for Bring {
    type Output = Option<FocusResult>;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Option<FocusResult>>, ServoError> {
        let ended = self.advance(scope, sink);
        withdrawn(scope, ended)
    }
}
