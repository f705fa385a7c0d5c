//! Autofocus: few frames to the sharpest height, on any specimen that shows anything, and an answer where none does.
//!
//! Each frame is looked at on several levels of detail at once (`levels.rs`). Far from focus only coarse detail is left, and tells which way
//! to go; near to it the finest decides. So a sweep begins with steps as wide as the coarsest level sees, from the present height
//! outwards and the safe side first, until a level shows a peak; then it is looked at closer on finer levels (`search.rs`), and
//! fitted (`curve.rs`). The measure is the caller's choice (`measure.rs`), and the noise's share is taken off (`noise.rs`): the paper's
//! mean |Laplacian| of section IV-B.1 is one of them. Heights are those that the stage says it is at; all of them are reached from the
//! side away from the specimen, so that backlash in the drive does not enter. Towards the specimen there is a bound
//! that no sweep passes. A sweep without a peak is an answer of its own: the stage goes back to where it started.

mod arrival;
mod curve;
mod levels;
mod measure;
mod noise;
mod options;
mod peak;
mod point;
mod sample;
mod search;
mod sharpness;
mod stale;
mod state;
mod sweep;

use crate::event::tell;
use crate::procedure::{Procedure, Progress, withdrawn};
use crate::vision::grab;
use crate::{Event, FrameRole, ServoError, Sink};
use scopeservo_scope::{Axis, AxisInfo, Instrument, Length, ScopeError};
use state::height;

pub use measure::{FocusMeasure, Measure};
pub(crate) use peak::Peak;
pub(crate) use point::Point;
pub(crate) use sample::Sample;
pub(crate) use state::depth_of_field_um;

pub use options::{FocusOptions, FocusResult, FocusSweep, SweepEnd};
pub use sharpness::sharpness;
pub use state::Focus;

/// Blur that is not the same above and below moves the fitted peak by so much of the depth of field.
const ASYMMETRY: f64 = 0.05;

impl Focus {
    /// Goes to a height, and tells where the stage then says it is.
    fn go(scope: &Instrument, z_um: f64) -> Result<f64, ServoError> {
        let at = scope.move_in_steps(&height(z_um))?.z;
        let at = at.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?;
        Ok(at.um())
    }

    /// So far to the side away from the specimen, where the stage may go there, that what comes next is reached from that side.
    fn take_up_play(scope: &Instrument, z_um: f64) -> Result<(), ServoError> {
        let stated = scope.gate().info().axis(Axis::Z).map(AxisInfo::clearance);
        let way_m = stated.unwrap_or(0.0).max(search::TAKES_UP_UM * 1e-6);
        let beyond = scope.gate().info().positive_z.away(z_um * 1e-6, way_m);
        let beyond = height(beyond * 1e6);
        if scope.gate().check(&beyond).is_ok() {
            scope.move_in_steps(&beyond)?;
        }
        Ok(())
    }

    /// To a height, from the side away from the specimen; tells where the stage then says it is.
    pub(crate) fn go_from_far(scope: &Instrument, z_um: f64) -> Result<f64, ServoError> {
        Self::take_up_play(scope, z_um)?;
        Self::go(scope, z_um)
    }

    fn look(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        z_um: f64,
    ) -> Result<(), ServoError> {
        let begun = scope.clock().now();
        let z_um = Self::go(scope, z_um)?;
        self.last_um = Some(z_um);
        let frame = grab(scope, sink, FrameRole::Focus, &self.objective.id)?;
        self.look_s = Some(scope.clock().now().since(begun).as_secs_f64());
        let measure = self.options.measure.measure();
        let sample = Sample::of(&frame, z_um, measure, self.levels());
        let at = self.samples.partition_point(|s| s.z_um <= z_um);
        self.samples.insert(at, sample);
        let curve = self.curve(0);
        let sharpness = self.root(curve.0.get(at).map_or(0.0, |p| p.value));
        tell(scope, sink, Event::FocusSample { z_um, sharpness });
        if self.step.is_fine() && !std::mem::take(&mut self.far_first) {
            self.fine_um.push(z_um);
        }
        Ok(())
    }

    fn advance(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<FocusResult>, ServoError> {
        if scope.gate().info().axis(Axis::Z).is_none() {
            return Ok(Progress::Done(FocusResult {
                z_um: None,
                sigma_um: None,
                sharpness: 0.0,
                contrast: 1.0,
                samples: 0,
            }));
        }
        if self.start_um.is_none() {
            self.begin(scope)?;
            return Ok(Progress::Continue);
        }
        if self.sweep_due {
            self.sweep(scope, sink)?;
            return Ok(Progress::Continue);
        }
        if !self.plan_um.is_empty() {
            let z_um = self.plan_um.remove(0);
            if !self.comes_from_far(scope, z_um)? {
                Self::take_up_play(scope, z_um)?;
            }
            self.look(scope, sink, z_um)?;
            if !self.plan_um.is_empty() {
                return Ok(Progress::Continue);
            }
        }
        match self.decide(scope)? {
            search::Decision::Look => Ok(Progress::Continue),
            search::Decision::Nothing => Err(self.nothing_found(scope, sink)?),
            search::Decision::There(sigma_um) => Ok(Progress::Done(self.found(scope, sigma_um))),
        }
    }

    /// Whether the stage stands where the last look was, on the side away from the specimen. Who goes on after a kill may not.
    fn comes_from_far(&self, scope: &Instrument, z_um: f64) -> Result<bool, ServoError> {
        let here = scope.gate().position()?.z.map_or(f64::NAN, |z| z.um());
        let farther = scope.gate().info().positive_z.nearer_by(z_um, here) > 0.0;
        Ok(farther && self.last_um.is_some_and(|last| (last - here).abs() < 1e-3))
    }

    /// The stage stands where the last look was.
    fn found(&self, scope: &Instrument, sigma_um: f64) -> FocusResult {
        let z_um = self.last_um.unwrap_or(f64::NAN);
        scope.focus_found(&self.objective.id, Length::from_um(z_um));
        let asymmetry_um = ASYMMETRY * depth_of_field_um(&self.objective);
        let curve = self.curve(0);
        let nearest = curve
            .0
            .iter()
            .min_by(|a, b| (a.z_um - z_um).abs().total_cmp(&(b.z_um - z_um).abs()));
        FocusResult {
            z_um: Some(z_um),
            sigma_um: Some(sigma_um.hypot(asymmetry_um)),
            sharpness: self.root(nearest.map_or(0.0, |p| p.value)),
            contrast: self.root(curve.contrast()),
            samples: self.samples.len(),
        }
    }
}

impl Procedure for Focus {
    type Output = FocusResult;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<FocusResult>, ServoError> {
        let ended = self.advance(scope, sink);
        withdrawn(scope, ended)
    }
}
