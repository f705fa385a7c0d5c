//! The sweep that shows how a view is tilted.

use super::blocks::{Seen, Sweep};
use super::plane::{Plane, robust_plane};
use super::tilt::{Scale, TiltReport, tilt};
use crate::event::tell;
use crate::focus::{Focus, Measure, Sample, depth_of_field_um};
use crate::procedure::{Procedure, Progress, withdrawn};
use crate::vision::grab;
use crate::{Calibration, Event, FrameRole, ServoError, Sink};
use scopeservo_geometry::Mat2;
use scopeservo_scope::{Axis, Instrument, Length, Objective, ScopeError, StagePose};
use serde::{Deserialize, Serialize};

/// Steps of the sweep, in widths of the finest level of detail, and how many there are to either side of the focus.
const STEP: f64 = 0.3;
const STEPS: i32 = 7;
/// A sweep is continued by so many steps, so often, where this share of the blocks is sharpest beyond an end of it.
const MORE: i32 = 5;
const CONTINUED: u8 = 4;
const BEYOND: f64 = 0.04;
/// Levels of detail that are looked at: a weak stain shows more on a coarse one.
const LEVELS: usize = 3;
/// How arrivals usually scatter, in depths of field.
const USUAL: f64 = 0.1;

/// A sweep about the present height, which must be in focus, with the active objective. It ends where it began.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MeasureTilt {
    objective: Objective,
    stage_from_pixel: Option<Mat2>,
    /// Where the stage stood when it began, um.
    start_um: Option<f64>,
    /// Heights to look at, the farthest from the specimen first.
    todo_um: Vec<f64>,
    /// Whether the next of them is to be reached from the side away from the specimen.
    from_far: bool,
    samples: Vec<Sample>,
    image_px: [usize; 2],
    continued: u8,
}

impl MeasureTilt {
    /// Of `objective`.
    pub fn new(objective: Objective) -> Self {
        Self {
            objective,
            stage_from_pixel: None,
            start_um: None,
            todo_um: Vec::new(),
            from_far: true,
            samples: Vec::new(),
            image_px: [0; 2],
            continued: 0,
        }
    }

    /// With a calibration, which tells the tilt along the stage's axes as well.
    #[must_use]
    pub fn knowing(mut self, calibration: &Calibration) -> Self {
        self.stage_from_pixel = Some(calibration.stage_from_pixel);
        self
    }

    fn step_um(&self) -> f64 {
        STEP * Focus::finest_width_um(&self.objective)
    }

    fn work(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<TiltReport>, ServoError> {
        let Some(start) = self.start_um else {
            let here = scope.gate().position()?;
            scope.gate().check(&here)?;
            let z = here.z.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?.um();
            self.start_um = Some(z);
            let steps = (-STEPS..=STEPS).map(|k| z + f64::from(k) * self.step_um());
            self.plan(scope, steps.collect())?;
            return Ok(Progress::Continue);
        };
        if !self.todo_um.is_empty() {
            let z_um = self.todo_um.remove(0);
            self.look(scope, sink, z_um)?;
            return Ok(Progress::Continue);
        }
        if self.go_on(scope)? {
            return Ok(Progress::Continue);
        }
        let report = self.report(scope);
        scope.return_to_height(Length::from_um(start))?;
        let tilt = Box::new(report.clone());
        tell(scope, sink, Event::Tilted { tilt });
        Ok(Progress::Done(report))
    }

    /// Those of some heights that the stage may go to come next.
    fn plan(&mut self, scope: &Instrument, mut heights_um: Vec<f64>) -> Result<(), ServoError> {
        let side = scope.gate().info().positive_z;
        heights_um.sort_by(|a, b| side.nearer_by(*a, 0.0).total_cmp(&side.nearer_by(*b, 0.0)));
        let places: Vec<StagePose> = heights_um.iter().map(|&z| height(z)).collect();
        let allowed = scope.gate().allowed(&places)?;
        let both = heights_um.into_iter().zip(allowed);
        self.todo_um = both
            .filter_map(|(z, allowed)| allowed.then_some(z))
            .collect();
        self.from_far = true;
        Ok(())
    }

    fn look(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        z_um: f64,
    ) -> Result<(), ServoError> {
        match std::mem::take(&mut self.from_far) {
            true => scope.return_to_height(Length::from_um(z_um))?,
            false => drop(scope.move_in_steps(&height(z_um))?),
        }
        let at = scope.gate().position()?.z;
        let at = at.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?.um();
        let frame = grab(scope, sink, FrameRole::Focus, &self.objective.id)?;
        self.image_px = [frame.width, frame.height];
        let sample = Sample::of(&frame, at, Measure::default().measure(), LEVELS);
        let place = self.samples.partition_point(|s| s.z_um <= at);
        self.samples.insert(place, sample);
        Ok(())
    }

    fn seen(&self, level: usize) -> Seen {
        Sweep {
            samples: &self.samples,
            measure: Measure::default().measure(),
            image_px: self.image_px,
            width_um: Focus::finest_width_um(&self.objective),
            usual_um: USUAL * depth_of_field_um(&self.objective),
        }
        .heights(level)
    }

    /// Where many blocks are sharpest beyond an end, the sweep goes on there. Returns whether it does.
    fn go_on(&mut self, scope: &Instrument) -> Result<bool, ServoError> {
        let (Some(first), Some(last)) = (self.samples.first(), self.samples.last()) else {
            return Ok(false);
        };
        if self.continued == CONTINUED {
            return Ok(false);
        }
        let seen = self.seen(0);
        let many = |count: usize| count as f64 > BEYOND * seen.all as f64;
        let steps = |from: f64, way: f64| (1..=MORE).map(move |k| (from, way * f64::from(k)));
        let [below, above] = seen.at_ends.map(many);
        let mut heights = Vec::new();
        heights.extend(steps(first.z_um, -1.0).filter(|_| below));
        heights.extend(steps(last.z_um, 1.0).filter(|_| above));
        let heights: Vec<f64> = heights
            .into_iter()
            .map(|(from, k)| from + k * self.step_um())
            .collect();
        if heights.is_empty() {
            return Ok(false);
        }
        self.continued += 1;
        self.plan(scope, heights)?;
        Ok(!self.todo_um.is_empty())
    }

    fn report(&self, scope: &Instrument) -> TiltReport {
        let half_px = self.image_px.map(|side| 0.5 * side as f64);
        let fits = (0..LEVELS).map(|level| {
            let seen = self.seen(level);
            let plane = robust_plane(&seen.heights, half_px);
            (seen, plane)
        });
        // The level that knows it best.
        let unsure = |plane: &Option<Plane>| match plane {
            Some(p) => p.covariance[1][1] + p.covariance[2][2],
            None => f64::INFINITY,
        };
        let best = fits.min_by(|a, b| unsure(&a.1).total_cmp(&unsure(&b.1)));
        let (mut seen, plane) = best.unwrap_or_default();
        if let Some(plane) = &plane {
            for (height, used) in seen.heights.iter_mut().zip(&plane.used) {
                height.used = *used;
            }
        }
        let scale = Scale {
            half_px,
            stage_from_pixel: self.stage_from_pixel,
            nominal_um: self.objective.nominal_um_per_px,
        };
        TiltReport {
            objective: self.objective.id.clone(),
            image_size_px: self.image_px,
            depth_of_field_um: depth_of_field_um(&self.objective),
            positive_z: scope.gate().info().positive_z,
            blocks: seen.all,
            heights: seen.heights,
            frames: self.samples.len(),
            tilt: plane.map(|plane| tilt(&plane, &scale)),
        }
    }
}

fn height(z_um: f64) -> StagePose {
    StagePose {
        z: Some(Length::from_um(z_um)),
        ..StagePose::default()
    }
}

impl Procedure for MeasureTilt {
    type Output = TiltReport;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<TiltReport>, ServoError> {
        let ended = self.work(scope, sink);
        withdrawn(scope, ended)
    }
}
