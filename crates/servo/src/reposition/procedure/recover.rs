//! What a run tries, once each, where a leg cannot go on: another exposure, a wider focus.

use super::super::light;
use super::{Reposition, State, Work};
use crate::event::tell;
use crate::{Attempt, ErrorCode, Event, FocusOptions, Remark, ServoError, Sink};
use scopeservo_scope::{Instrument, Length, ObjectiveId};

/// A wider sweep goes so many times as far from the specimen; towards it, no farther than before.
const WIDER: f64 = 2.5;
/// A camera exposes as it was told to within this share.
const SAME_EXPOSURE: f64 = 0.05;

impl Reposition {
    /// Goes on with the leg that an error ended, where something is left to try.
    pub(super) fn tries_again(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        error: &ServoError,
    ) -> Result<bool, ServoError> {
        let unseen = matches!(
            error.code(),
            ErrorCode::NoFocus
                | ErrorCode::AtLimit
                | ErrorCode::WrongObjective
                | ErrorCode::CalibrationFailed
        );
        Ok(unseen && self.adapts_exposure(scope, sink)?)
    }

    /// Exposes otherwise where the view is too dark or too bright, and begins the leg anew.
    pub(super) fn adapts_exposure(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<bool, ServoError> {
        let State::Under { leg, .. } = &self.state else {
            return Ok(false);
        };
        if self.exposure_before.is_some() {
            return Ok(false);
        }
        let (leg, target) = (leg.clone(), self.target()?);
        let objective = leg.objective().clone();
        let Some([before, now]) = light::adapt(scope, sink, &objective, &target)? else {
            return Ok(false);
        };
        (self.exposure_before, self.exposes) = (Some(before), Some(now));
        let [from_ms, to_ms] = [before, now].map(|t| 1e3 * t.as_secs_f64());
        let attempt = Attempt::ExposureAdapted { from_ms, to_ms };
        self.tell_attempt(scope, sink, objective, attempt);
        self.returns_to_where_it_began(scope)?;
        self.bring(scope, leg);
        Ok(true)
    }

    /// After a focus that found nothing the stage stands where the command began, which may be farther from the specimen than where this objective is
    /// expected in focus.
    fn returns_to_where_it_began(&self, scope: &Instrument) -> Result<(), ServoError> {
        if let State::Under {
            work: Work::Bring(bring),
            ..
        } = &self.state
            && let Some(z_um) = bring.focus_began_um()
        {
            scope.return_to_height(Length::from_um(z_um))?;
        }
        Ok(())
    }

    /// As the camera was exposed when the run began. What fails is no answer to the run.
    pub(super) fn exposes_as_before(&mut self, scope: &Instrument) {
        self.exposes = None;
        if let Some(before) = self.exposure_before.take() {
            let _ = scope.camera().set_exposure(before);
        }
    }

    /// As the run has adapted it, or after a kill as it was when the run began: who went on after a kill or a stop opened the camera anew.
    pub(super) fn exposes_as_adapted(&mut self, scope: &Instrument) -> Result<(), ServoError> {
        let began = std::mem::take(&mut self.exposed_anyhow);
        let began = self.exposed.filter(|_| began);
        let Some(adapted) = self.exposes.or(began) else {
            return Ok(());
        };
        let is = scope.camera().exposure()?.as_secs_f64();
        if (is / adapted.as_secs_f64() - 1.0).abs() > SAME_EXPOSURE {
            scope.camera().set_exposure(adapted)?;
        }
        Ok(())
    }

    /// Looks for the focus in a wider range, where nothing was seen in the usual one.
    pub(super) fn widens_focus(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        error: &ServoError,
    ) -> Result<bool, ServoError> {
        let unfocused = matches!(error.code(), ErrorCode::NoFocus | ErrorCode::AtLimit);
        let State::Under {
            leg,
            work: Work::Bring(_),
        } = &self.state
        else {
            return Ok(false);
        };
        let half_range_um = WIDER * self.options.focus.half_range_um;
        let attempt = Attempt::FocusWidened { half_range_um };
        if !unfocused || !self.tried.first(&attempt) {
            return Ok(false);
        }
        let leg = leg.clone();
        self.tell_attempt(scope, sink, leg.objective().clone(), attempt);
        let wider = FocusOptions {
            half_range_um,
            ..self.options.focus.clone()
        };
        self.returns_to_where_it_began(scope)?;
        self.bring_within(leg, Some(wider));
        Ok(true)
    }

    pub(super) fn tell_attempt(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        objective: ObjectiveId,
        attempt: Attempt,
    ) {
        let remark = Remark::Tried { objective, attempt };
        self.remarks.push(remark.clone());
        tell(scope, sink, Event::Remarked { remark });
    }
}
