//! A simulated microscope over tissue, ready to be studied.

use scopeservo_scope::{
    Angle, CancelToken, Clock, Instrument, Length, ObjectiveId, ScopeError, StagePose, VirtualClock,
};
use scopeservo_servo::{
    Calibrate, CalibrateOptions, Calibration, Focus, FocusOptions, NoSink, ServoError,
    VisionOptions, run,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Twin, TwinError};
use std::sync::Arc;

/// A twin and the instrument made of its devices.
pub struct Bench {
    /// The simulation, for the truth.
    pub twin: Twin,
    /// What the servo sees.
    pub scope: Instrument,
}

impl Bench {
    /// A microscope over procedural tissue.
    ///
    /// # Errors
    /// Those of the twin and of the checked stage.
    pub fn tissue(config: Config, seed: u64) -> Result<Self, Box<dyn std::error::Error>> {
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let twin = make(config, seed, clock.clone())?;
        let scope = instrument(&twin)?;
        Ok(Self { twin, scope })
    }

    /// Moves x, y and rotation to zero.
    ///
    /// # Errors
    /// Those of the instrument.
    pub fn home(&self) -> Result<(), ScopeError> {
        let zero = StagePose {
            x: Some(Length::from_um(0.0)),
            y: Some(Length::from_um(0.0)),
            rz: Some(Angle::from_deg(0.0)),
            ..StagePose::default()
        };
        self.scope.move_to(&zero)?;
        Ok(())
    }

    /// Brings `objective` in and focuses.
    ///
    /// # Errors
    /// Those of the instrument and of the focus.
    pub fn focus(&self, objective: &ObjectiveId) -> Result<(), ServoError> {
        self.scope.select_objective(objective)?;
        let data = self.scope.objective(objective)?.clone();
        run(
            &mut Focus::new(data, FocusOptions::default()),
            &self.scope,
            &mut NoSink,
        )?;
        Ok(())
    }

    /// Calibrates the active objective.
    ///
    /// # Errors
    /// Those of the calibration.
    pub fn calibrate(&self, objective: &ObjectiveId) -> Result<Calibration, ServoError> {
        let data = self.scope.objective(objective)?.clone();
        let mut calibrate =
            Calibrate::new(data, CalibrateOptions::default(), VisionOptions::default());
        run(&mut calibrate, &self.scope, &mut NoSink)
    }

    /// The objectives, lowest magnification first.
    pub fn objectives(&self) -> Vec<ObjectiveId> {
        let mut all = self.scope.gate().objectives().to_vec();
        all.sort_by(|a, b| a.magnification.total_cmp(&b.magnification));
        all.into_iter().map(|o| o.id).collect()
    }
}

fn make(config: Config, seed: u64, clock: Arc<dyn Clock>) -> Result<Twin, TwinError> {
    Twin::new(config, Arc::new(Tissue::new(seed)), seed, clock)
}

fn instrument(twin: &Twin) -> Result<Instrument, ScopeError> {
    Instrument::new(twin.devices(), twin.rules(), CancelToken::new())
}
