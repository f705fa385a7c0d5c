//! Whether a view is in focus, before it is saved: a blurred one can be come back to, but badly, and nobody sees that on a small screen.

use crate::event::tell;
use crate::procedure::{Procedure, Progress, withdrawn};
use crate::vision::{grab, gray};
use crate::{Event, Focus, FocusOptions, FrameRole, ServoError, Sink, VisionOptions};
use scopeservo_scope::{Axis, Instrument, Length, ObjectiveId, ScopeError};
use serde::{Deserialize, Serialize};

/// A view is blurred when the sharpest one nearby has this many times its features.
const SHARPER: f64 = 1.25;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Begin,
    Focus {
        start_um: f64,
        features: usize,
        focus: Box<Focus>,
    },
}

/// Looks a little above and below whether the view is sharper there, and tells. A view in focus ends where it is sharpest; one that is
/// not is left as it was found: the height may be what somebody wants.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct InFocus {
    objective: ObjectiveId,
    options: FocusOptions,
    vision: VisionOptions,
    state: State,
}

impl InFocus {
    /// Of the active objective.
    pub fn new(objective: ObjectiveId, options: FocusOptions, vision: VisionOptions) -> Self {
        Self {
            objective,
            options,
            vision,
            state: State::Begin,
        }
    }

    fn features(&self, scope: &Instrument, sink: &mut dyn Sink) -> Result<usize, ServoError> {
        let frame = grab(scope, sink, FrameRole::Focus, &self.objective)?;
        Ok(self.vision.of_view(&gray(scope, &frame)?)?.len())
    }

    /// The focus stands where it is sharpest. Ends there, or back where it began.
    fn judge(
        &self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        (start_um, here): (f64, usize),
        sharpest_um: f64,
    ) -> Result<(), ServoError> {
        let width_um = Focus::finest_width_um(scope.objective(&self.objective)?);
        if (sharpest_um - start_um).abs() <= width_um {
            return Ok(());
        }
        let there = self.features(scope, sink)?;
        let blurred = there as f64 > SHARPER * here as f64;
        scope.return_to_height(Length::from_um(start_um))?;
        if blurred {
            tell(
                scope,
                sink,
                Event::Blurred {
                    objective: self.objective.clone(),
                    sharper_by_um: sharpest_um - start_um,
                    features: here,
                    features_there: there,
                },
            );
        } else if here as f64 > SHARPER * self.features(scope, sink)? as f64 {
            // The drive has backlash: the same number is another height now, and the view was as sharp as the sharpest.
            let sharpest = Length::from_um(sharpest_um);
            scope.return_to_height(sharpest)?;
        }
        Ok(())
    }

    fn advance(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<()>, ServoError> {
        if scope.gate().info().axis(Axis::Z).is_none() {
            return Ok(Progress::Done(()));
        }
        match &mut self.state {
            State::Begin => {
                let z = scope.gate().position()?.z;
                let start_um = z.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?.um();
                self.state = State::Focus {
                    start_um,
                    features: self.features(scope, sink)?,
                    focus: Box::new(Focus::nearby(
                        scope.objective(&self.objective)?.clone(),
                        &self.options,
                    )),
                };
            }
            State::Focus {
                start_um,
                features,
                focus,
            } => {
                let began = (*start_um, *features);
                let found = match focus.step(scope, sink) {
                    Ok(Progress::Continue) => return Ok(Progress::Continue),
                    Ok(Progress::Done(result)) => result.z_um,
                    // Nothing nearby tells. A failed focus ends where the command began, which may be farther away.
                    Err(ServoError::NoFocus { .. } | ServoError::FocusAtLimit { .. }) => {
                        scope.return_to_height(Length::from_um(*start_um))?;
                        None
                    }
                    Err(error) => return Err(error),
                };
                if let Some(sharpest_um) = found {
                    self.judge(scope, sink, began, sharpest_um)?;
                }
                return Ok(Progress::Done(()));
            }
        }
        Ok(Progress::Continue)
    }
}

impl Procedure for InFocus {
    type Output = ();

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<()>, ServoError> {
        let ended = self.advance(scope, sink);
        withdrawn(scope, ended)
    }
}
