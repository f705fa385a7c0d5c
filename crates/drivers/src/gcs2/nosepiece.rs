//! The nosepiece on another axis of the controller.

use crate::gcs2::codec::Command;
use crate::gcs2::settings::Gcs2Nosepiece;
use crate::gcs2::stage::{Gcs2Stage, Goal};
use crate::gcs2::talk::values;
use crate::session::bad_setting;
use crate::turret::{Part, Turns, Turret};
use scopeservo_scope::{Angle, Motion, ScopeError, Stage};
use std::sync::Arc;

impl Gcs2Stage {
    /// The nosepiece that the settings describe, if they do.
    pub fn nosepiece(self: &Arc<Self>) -> Option<Turret> {
        let Gcs2Nosepiece {
            objectives,
            arrival_tolerance_deg,
            ..
        } = &self.nosepiece.as_ref()?.settings;
        let axis = self.clone();
        Some(Turret::new(axis, objectives, *arrival_tolerance_deg, false))
    }
}

impl Turns for Gcs2Stage {
    fn is_homed(&self) -> Result<bool, ScopeError> {
        self.is_part_homed(Part::Nosepiece)
    }

    fn start_homing(&self) -> Result<(), ScopeError> {
        self.home_part(Part::Nosepiece)
    }

    fn place_deg(&self) -> Result<f64, ScopeError> {
        let mut ex = self.exchange_unless_homing()?;
        let names = self.names_of(Part::Nosepiece);
        let at = values(&mut ex, &Command::Positions(names), names)?;
        let unit = self.nosepiece.as_ref().map(|n| n.unit);
        let here = at.first().zip(unit).map(|(at, unit)| unit.si(*at));
        Ok(Angle::from_rad(here.ok_or_else(no_nosepiece)?).deg())
    }

    fn start_turn(&self, to_deg: f64) -> Result<(), ScopeError> {
        let nosepiece = self.nosepiece.as_ref().ok_or_else(no_nosepiece)?;
        let wire = |deg| nosepiece.unit.of_si(Angle::from_deg(deg).rad());
        let goal = Goal {
            name: nosepiece.name.clone(),
            to: wire(to_deg),
            tolerance: wire(nosepiece.settings.arrival_tolerance_deg),
        };
        self.start(Part::Nosepiece, vec![goal], None)
    }

    fn poll_turn(&self) -> Result<Motion, ScopeError> {
        self.poll()
    }

    fn stop_turn(&self) -> Result<(), ScopeError> {
        self.stop()
    }

    fn invalidate_position(&self) {
        // It measures where its axes are.
    }
}

fn no_nosepiece() -> ScopeError {
    bad_setting("the settings of this controller name no nosepiece")
}
