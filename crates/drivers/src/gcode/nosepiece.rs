//! The nosepiece on one of the board's steppers.

use crate::gcode::stage::GcodeStage;
use crate::session::{bad_setting, lock};
use crate::turret::{Part, Turns, Turret};
use scopeservo_scope::{Motion, ScopeError, Stage};
use std::sync::Arc;

impl GcodeStage {
    /// The nosepiece that the settings describe, if they do.
    pub fn nosepiece(self: &Arc<Self>) -> Option<Turret> {
        let nosepiece = self.settings.nosepiece.as_ref()?;
        Some(Turret::new(
            self.clone(),
            &nosepiece.objectives,
            nosepiece.arrival_tolerance_deg,
            !nosepiece.needs_homing,
        ))
    }
}

impl Turns for GcodeStage {
    fn is_homed(&self) -> Result<bool, ScopeError> {
        self.is_part_homed(Part::Nosepiece)
    }

    fn start_homing(&self) -> Result<(), ScopeError> {
        self.home_part(Part::Nosepiece)
    }

    fn place_deg(&self) -> Result<f64, ScopeError> {
        let mut ex = self.session.exchange()?;
        let steps = self.steps(&mut ex)?;
        let mut all = self.motors.iter().zip(steps);
        all.find(|(motor, _)| motor.part() == Part::Nosepiece)
            .map(|(motor, steps)| motor.units(steps))
            .ok_or_else(no_nosepiece)
    }

    fn start_turn(&self, to_deg: f64) -> Result<(), ScopeError> {
        let nosepiece = self.settings.nosepiece.as_ref().ok_or_else(no_nosepiece)?;
        // It stands behind the stage's motors.
        let targets = [(self.motors.len() - 1, to_deg)];
        self.start(Part::Nosepiece, &targets, nosepiece.speed_deg_per_s * 60.0)
    }

    fn poll_turn(&self) -> Result<Motion, ScopeError> {
        self.poll()
    }

    fn stop_turn(&self) -> Result<(), ScopeError> {
        self.stop()
    }

    fn invalidate_position(&self) {
        lock(&self.homed).nosepiece = false;
    }
}

fn no_nosepiece() -> ScopeError {
    bad_setting("the settings of this board name no nosepiece")
}
