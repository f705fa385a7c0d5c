//! What follows in a leg: its objective is in focus, calibrated, and the servo begins.

use super::super::parcentric::Beside;
use super::super::{Leg, MagnificationResult, parcentric};
use super::{Reposition, State, Work};
use crate::{Calibrate, Calibration, Law, Phase, Servo, ServoEnd, ServoError, Sink, Target};
use scopeservo_scope::{Instrument, ObjectiveId};

impl Reposition {
    /// The objective is active and in focus.
    pub(super) fn brought(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        leg: Leg,
    ) -> Result<(), ServoError> {
        if self.visits(&leg) {
            return Ok(());
        }
        let before = self.done.last();
        let trusted = parcentric::centres_hold(&self.done).then_some(&self.calibrations);
        if let Some(before) = before.filter(|d| matches!(d.end, ServoEnd::Converged(_)))
            && let Some(offset_um) = parcentric::offset_um(
                [&before.objective, leg.objective()],
                &Beside::of(&self.switchings, &self.parcentric, trusted),
            )
        {
            let own = self.calibrations.get(leg.objective());
            let nominal = scope.objective(leg.objective())?.nominal_um_per_px;
            let um_per_px = own.map_or(nominal, Calibration::um_per_px);
            parcentric::keep_centre(scope, self.ended_at, offset_um, um_per_px)?;
        }
        // The paper calibrates the target's objective again for the last leg, so that its error cancels; a joint calibration has none to speak of.
        let known = |objective: &ObjectiveId| match self.options.servo.law {
            Law::Direct => self.calibrations.contains_key(objective),
            Law::Proportional => self.known.contains(objective),
        };
        if matches!(&leg, Leg::Servo(objective) if known(objective)) {
            self.servo(scope, sink, leg);
            return Ok(());
        }
        let calibrate = Calibrate::new(
            scope.objective(leg.objective())?.clone(),
            self.options.calibrate.clone(),
            self.options.vision.clone(),
        );
        self.enter(scope, sink, Phase::Calibrate, &leg);
        let work = Work::Calibrate(Box::new(calibrate));
        self.state = State::Under { leg, work };
        Ok(())
    }

    pub(super) fn servo(&mut self, scope: &Instrument, sink: &mut dyn Sink, leg: Leg) {
        self.enter(scope, sink, Phase::Servo, &leg);
        let seen =
            |d: &MagnificationResult| d.objective == *leg.objective() && d.end.result().is_some();
        let first = !self.done.iter().any(seen);
        let watch = std::mem::take(&mut self.watch).handed_over(first);
        let work = Work::Servo(Box::new(Servo::after(watch)));
        self.state = State::Under { leg, work };
    }

    pub(super) fn calibrated(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        (leg, calibration): (Leg, Calibration),
        target: &Target,
    ) {
        self.calibrations
            .insert(leg.objective().clone(), calibration);
        match leg {
            Leg::Servo(_) => self.servo(scope, sink, leg),
            Leg::Calibrate(_) => {
                if let Some(next) = self.policy().next(&self.so_far(scope, target)) {
                    self.bring(scope, next);
                }
            }
        }
    }
}
