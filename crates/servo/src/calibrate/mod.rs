//! Pattern-free calibration: the map from pixels to the stage, the rotation centre, the backlash.
//!
//! [`CalibrationMethod::Joint`] follows a chain of views and solves everything at once (`joint` has the mathematics, `chain` the
//! procedure); [`CalibrationMethod::TwoStep`] is the paper's.

mod agree;
mod alone;
mod chain;
pub mod joint;
mod options;
mod together;
pub(crate) mod told;
mod two_step;

use crate::procedure::{Procedure, Progress, withdrawn};
use crate::{Calibration, ServoError, Sink, VisionOptions};
use chain::Chain;
use scopeservo_scope::{Instrument, Objective};
use serde::{Deserialize, Serialize};
use two_step::TwoStep;

pub use agree::agree;
pub use alone::Alone;
pub use options::{CalibrateOptions, CalibrationMethod};
pub use together::{CalibrationSet, NotOne, Parcentric, SET_SCHEMA, one_microscope};
pub use told::{ChainPair, ChainPlace, ChainView};
#[cfg(test)]
pub(crate) use two_step::DIRECTIONS;

/// The calibration of the active objective as a step machine: one view per step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibrate {
    method: Method,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Method {
    Joint(Box<Chain>),
    TwoStep(Box<TwoStep>),
}

impl Calibrate {
    /// A calibration around the present place with the active objective.
    pub fn new(objective: Objective, options: CalibrateOptions, vision: VisionOptions) -> Self {
        let method = match options.method {
            CalibrationMethod::Joint => {
                Method::Joint(Box::new(Chain::new(objective, options, vision)))
            }
            CalibrationMethod::TwoStep => {
                Method::TwoStep(Box::new(TwoStep::new(objective, options, vision)))
            }
        };
        Self { method }
    }

    /// What it saw, once it has answered with this calibration, for [`one_microscope`]; nothing of two steps.
    pub fn alone(&self, calibration: &Calibration) -> Option<Alone> {
        match &self.method {
            Method::Joint(chain) => chain.alone(calibration.clone()),
            Method::TwoStep(_) => None,
        }
    }
}

impl Procedure for Calibrate {
    type Output = Calibration;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Calibration>, ServoError> {
        let ended = match &mut self.method {
            Method::Joint(chain) => chain.advance(scope, sink),
            Method::TwoStep(two_step) => two_step.advance(scope, sink),
        };
        withdrawn(scope, ended)
    }
}
