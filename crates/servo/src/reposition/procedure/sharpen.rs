//! A view that is less sharp than its target: another height, before the run says that it has arrived.
//!
//! How much softer the view is tells how far it is from where it would be as sharp, and not to which side. So the stage goes as far away from the
//! specimen first, and where the next frame is softer still, to the other side. The loop goes on meanwhile: its frames are the looks. Where that
//! does not help, as with a target that was itself out of focus, a sweep around the height does it, once. What is softer after that is told.

use super::super::sharpening::Sharpening;
use super::{Reposition, State, Work};
use crate::event::tell;
use crate::procedure::Progress;
use crate::{Attempt, Event, Focus, FocusResult, Law, Outcome, Phase, Remark, ServoError, Sink};
use scopeservo_scope::{Axis, AxisInfo, Instrument, Length, StagePose};

/// What is softer than so many depths of field make is looked for by a sweep: twice as far to the wrong side a target may not be found.
const BY_STEPS: f64 = 2.5;

/// An axis that may have more play than this share of a step takes it up before.
const LITTLE_PLAY: f64 = 0.75;

impl Reposition {
    /// Another height where the last frame was softer than the target; whether the stage has moved, or is about to.
    pub(super) fn sharpens(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<bool, ServoError> {
        let State::Under {
            leg,
            work: Work::Servo(servo),
        } = &self.state
        else {
            return Ok(false);
        };
        let can = scope.gate().info().axis(Axis::Z).is_some();
        if !can || self.options.servo.law != Law::Direct {
            return Ok(false);
        }
        let (blur, leg) = (servo.blur().copied(), leg.clone());
        let softer = blur.filter(|blur| blur.counts());
        match (self.sharpening, softer) {
            (Sharpening::Swept, _) | (Sharpening::Not | Sharpening::Stepped, None) => Ok(false),
            (Sharpening::Not, Some(blur)) => {
                let attempt = Attempt::FocusedAgain {
                    defocus_um: blur.defocus_um,
                };
                self.tell_attempt(scope, sink, leg.objective().clone(), attempt);
                let from_um = height_um(scope)?;
                let side = scope.gate().info().positive_z;
                let to_um = side.away(from_um, blur.defocus_um);
                let near = blur.defocus_um <= 2.0 * BY_STEPS * blur.half_depth_um;
                if near && self.goes_to(scope, to_um)? {
                    let defocus_um = blur.defocus_um;
                    self.sharpening = Sharpening::Away {
                        from_um,
                        defocus_um,
                    };
                    return Ok(true);
                }
                self.sweeps(scope, sink)
            }
            // What is not seen any more is softer.
            (
                Sharpening::Away {
                    from_um,
                    defocus_um,
                },
                seen,
            ) if blur.is_none() || seen.is_some_and(|now| now.defocus_um > defocus_um) => {
                let side = scope.gate().info().positive_z;
                match self.goes_to(scope, side.away(from_um, -defocus_um))? {
                    true => self.sharpening = Sharpening::Nearer,
                    false => return self.sweeps(scope, sink),
                }
                Ok(true)
            }
            (Sharpening::Away { .. } | Sharpening::Nearer, None) if blur.is_some() => {
                let z = Length::from_um(height_um(scope)?);
                scope.focus_found(leg.objective(), z);
                self.sharpening = Sharpening::Stepped;
                Ok(false)
            }
            _ => self.sweeps(scope, sink),
        }
    }

    /// Goes to a height from the side away from the specimen, where the stage may go there. Frames so far confirm nothing then.
    fn goes_to(&mut self, scope: &Instrument, z_um: f64) -> Result<bool, ServoError> {
        let to = StagePose {
            z: Some(Length::from_um(z_um)),
            ..StagePose::default()
        };
        if scope.gate().check(&to).is_err() {
            return Ok(false);
        }
        let info = scope.gate().info();
        let way_um = z_um - height_um(scope)?;
        let nearer = info.positive_z.nearer_by(way_um, 0.0) > 0.0;
        let play_um = info.axis(Axis::Z).map_or(0.0, AxisInfo::clearance) * 1e6;
        match nearer || play_um <= LITTLE_PLAY * way_um.abs() {
            true => scope.move_in_steps(&to).map(drop)?,
            false => Focus::go_from_far(scope, z_um).map(drop)?,
        }
        if let State::Under {
            work: Work::Servo(servo),
            ..
        } = &mut self.state
        {
            servo.focused_again();
        }
        Ok(true)
    }

    /// Looks for the sharpest height around the present one.
    fn sweeps(&mut self, scope: &Instrument, sink: &mut dyn Sink) -> Result<bool, ServoError> {
        let State::Under { leg, work } = &self.state else {
            return Ok(false);
        };
        let Work::Servo(servo) = work else {
            return Ok(false);
        };
        self.sharpening = Sharpening::Swept;
        let objective = scope.objective(leg.objective())?.clone();
        let focus = Focus::nearby(objective, &self.options.focus);
        self.enter(scope, sink, Phase::Focus, leg);
        let work = Work::Focus {
            focus: Box::new(focus),
            servo: servo.clone(),
        };
        self.state = State::Under {
            leg: leg.clone(),
            work,
        };
        Ok(true)
    }

    /// The sweep goes on or has ended. After one that found nothing the loop goes on where it began.
    pub(super) fn focused(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        ended: Result<Progress<FocusResult>, ServoError>,
    ) -> Result<Option<Outcome>, ServoError> {
        let State::Under {
            leg,
            work: Work::Focus { servo, focus },
        } = &self.state
        else {
            return Ok(None);
        };
        let (leg, mut servo, began_um) = (leg.clone(), servo.clone(), focus.began_um());
        match ended {
            Ok(Progress::Continue) => return Ok(None),
            Ok(Progress::Done(result)) => {
                let objective = leg.objective().clone();
                tell(scope, sink, Event::Focused { objective, result });
            }
            Err(ServoError::NoFocus { .. } | ServoError::FocusAtLimit { .. }) => {
                // A failed focus ends where the command began, which may be farther away.
                if let Some(z_um) = began_um {
                    scope.return_to_height(Length::from_um(z_um))?;
                }
            }
            Err(error) => return Err(error),
        }
        self.enter(scope, sink, Phase::Servo, &leg);
        servo.focused_again();
        let work = Work::Servo(servo);
        self.state = State::Under { leg, work };
        Ok(None)
    }

    /// What is to be told of an arrival that is less sharp than the target.
    pub(super) fn tells_blur(&mut self, scope: &Instrument, sink: &mut dyn Sink) {
        let State::Under {
            leg,
            work: Work::Servo(servo),
        } = &self.state
        else {
            return;
        };
        let Some(blur) = servo.blur().filter(|blur| blur.counts()) else {
            return;
        };
        let remark = Remark::Blurred {
            objective: leg.objective().clone(),
            defocus_um: blur.defocus_um,
            sharpness: blur.ratio,
        };
        self.remarks.push(remark.clone());
        tell(scope, sink, Event::Remarked { remark });
    }
}

fn height_um(scope: &Instrument) -> Result<f64, ServoError> {
    Ok(scope.gate().position()?.z.map_or(f64::NAN, |z| z.um()))
}
