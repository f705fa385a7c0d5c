//! The coarse scan as one slow motion: z moves through the range while the camera takes frames, and nothing settles in between.
//!
//! The height of a frame is the stage's in the middle of its exposure: between two answers of the stage, one before the frame was asked for and one
//! after it came. No clock is believed beyond that. A frame whose stamp lies outside that time does not count, nor one during which the stage went
//! farther than it should. What is found is only where to look: the settled looks around it decide, and where they see nothing the settled scan
//! goes on as if there had been no sweep. So play, late images and wrong stamps cost time and no accuracy.

use super::curve::Curve;
use super::options::{FocusSweep, SweepEnd};
use super::sample::Sample;
use super::search::{CLOSER, Decision, FINER, TIMES};
use super::state::{Focus, Step, height};
use crate::event::tell;
use crate::vision::grab;
use crate::{Event, FrameRole, ServoError, Sink};
use scopeservo_scope::{Axis, ErrorKind, Frame, Instrument, ScopeError};
use std::sync::Arc;

/// A frame during which it went so many times as far does not count.
const JUMPS: f64 = 2.5;
/// What is nearer than so many is one height.
const SAME: f64 = 0.1;
/// A sweep that has fewer frames that count tells nothing.
const LEAST_FRAMES: usize = 4;
/// A sweep has so many frames at most, however slowly the stage goes.
const MOST_FRAMES: usize = 64;
/// A look of the settled scan takes so many moves on average: half of them come from the other side.
const MOVES: f64 = 1.5;

/// A frame that was taken in motion, with the stage's answers about it: seconds and um.
struct Taken {
    frame: Arc<Frame>,
    before: [f64; 2],
    after: [f64; 2],
}

impl Taken {
    /// Where the stage was in the middle of the exposure.
    fn z_um(&self, spacing_um: f64) -> Option<f64> {
        let exposed_s = self.frame.exposure.as_secs_f64();
        let middle_s = self.frame.exposure_start.seconds() + 0.5 * exposed_s;
        let ([t0, z0], [t1, z1]) = (self.before, self.after);
        let is_known = (t0..=t1).contains(&middle_s) && (z1 - z0).abs() <= JUMPS * spacing_um;
        is_known.then(|| z0 + (z1 - z0) * (middle_s - t0) / (t1 - t0).max(1e-9))
    }
}

impl Focus {
    /// The next height of the settled scan; a sweep comes first where one is wanted and none was made.
    pub(super) fn look_farther(&mut self) {
        self.plan_um = vec![self.outwards_um.remove(0)];
        self.sweep_due = self.options.sweep && !self.swept && !self.samples.is_empty();
    }

    /// Sweeps, and plans looks around the peak where one is seen.
    pub(super) fn sweep(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<(), ServoError> {
        self.sweep_due = false;
        self.swept = true;
        let told = match self.swept(scope, sink) {
            // What the stage will not do the settled scan does without.
            Err(ServoError::Scope(error)) if error.kind() == ErrorKind::Refused => {
                self.told(&[], 0.0, SweepEnd::Refused)
            }
            ended => ended?,
        };
        if let Some(near_um) = told.near_um {
            let level = (self.levels() - 1).saturating_sub(FINER);
            let step_um = CLOSER * self.width_um(level);
            let around = [-1.0, 0.0, 1.0].map(|k| near_um + k * step_um);
            let next = std::mem::take(&mut self.plan_um);
            self.plan(scope, &around)?;
            // The settled scan stays what it was, for when there is nothing.
            self.outwards_um.splice(0..0, next);
            self.step = Step::Swept { level, times: 0 };
        }
        tell(scope, sink, Event::FocusSwept { sweep: told });
        Ok(())
    }

    /// After the looks around what a sweep has found: a peak, or which way it lies. Where they show neither, the settled scan goes on.
    pub(super) fn after_sweep(
        &mut self,
        scope: &Instrument,
        level: usize,
        times: u8,
    ) -> Result<Decision, ServoError> {
        let (curve, contrast) = (self.curve(level), self.contrast());
        if curve.bracketed(contrast).is_some() {
            return self.closer(scope, level, 0);
        }
        let inner = 1..curve.0.len().saturating_sub(1);
        if let Some(best) = curve.stands_out(contrast).filter(|k| inner.contains(k)) {
            // Two that are nearly as sharp: it lies between them.
            self.fine(scope, curve.rough_top(best, self.usual_um()), false)?;
            return Ok(Decision::Look);
        }
        if let Some(way) = curve.rises_at(contrast).filter(|_| times < TIMES) {
            let end = if way < 0.0 { 0 } else { curve.0.len() - 1 };
            let next = curve.0[end].z_um + way * CLOSER * self.width_um(level);
            if self.plan(scope, &[next])? {
                let times = times + 1;
                self.step = Step::Swept { level, times };
                return Ok(Decision::Look);
            }
        }
        self.step = Step::Outwards;
        self.outwards(scope)
    }

    /// How far the stage goes during a frame, um: as far as the coarsest level is wide.
    fn spacing_um(&self) -> f64 {
        self.width_um(self.levels() - 1)
    }

    fn told(&self, taken: &[Taken], um_per_s: f64, end: SweepEnd) -> FocusSweep {
        let start = self.start_um.unwrap_or(f64::NAN);
        let heights = || taken.iter().flat_map(|t| [t.before[1], t.after[1]]);
        FocusSweep {
            range_um: [
                heights().fold(start, f64::min),
                heights().fold(start, f64::max),
            ],
            um_per_s,
            frames: taken.len(),
            counted: known(taken, self.spacing_um()).len(),
            end,
            near_um: None,
        }
    }

    fn swept(&self, scope: &Instrument, sink: &mut dyn Sink) -> Result<FocusSweep, ServoError> {
        let start_um = self.start_um.unwrap_or(f64::NAN);
        let away = scope.gate().info().positive_z.away(0.0, 1.0);
        // The ends of the settled scan, which the gate allows. The far side first.
        let heights = || self.plan_um.iter().chain(&self.outwards_um);
        let end = |side: f64| {
            let beyond = heights().map(|z| (z - start_um) * side);
            Some(beyond.fold(0.0, f64::max))
                .filter(|way| *way > 0.0)
                .map(|way| start_um + side * way)
        };
        let ends = [end(away), end(-away)];
        if self.levels() <= FINER + 1 {
            return Ok(self.told(&[], 0.0, SweepEnd::NoFaster));
        }
        let frame_s = self.frame_s(scope, sink)?;
        let spacing_um = self.spacing_um();
        let um_per_s = spacing_um / frame_s;
        let looks = 0.5 * heights().count() as f64;
        let settled_s = MOVES * looks * self.look_s.unwrap_or(0.0);
        let way_um = 0.5
            * ends
                .iter()
                .flatten()
                .map(|z| (z - start_um).abs())
                .sum::<f64>();
        let swept_s = MOVES * (way_um / um_per_s + self.look_s.unwrap_or(0.0));
        if swept_s >= settled_s {
            return Ok(self.told(&[], um_per_s, SweepEnd::NoFaster));
        }
        let mut taken: Vec<Taken> = Vec::new();
        for to_um in ends.into_iter().flatten() {
            let here = scope.gate().position()?.z.map_or(f64::NAN, |z| z.um());
            if (here - start_um).abs() > 1.0 {
                Self::go(scope, start_um)?;
            }
            self.look_along(scope, sink, to_um, um_per_s, &mut taken)?;
            let seen = self.peak_of(&taken, spacing_um);
            if seen.is_some() {
                return Ok(FocusSweep {
                    near_um: seen,
                    ..self.told(&taken, um_per_s, SweepEnd::Found)
                });
            }
            let placed = taken.iter().filter(|t| t.z_um(spacing_um).is_some());
            let few = known(&taken, spacing_um).len() < LEAST_FRAMES.min(taken.len());
            if few || 2 * placed.count() <= taken.len() {
                return Ok(self.told(&taken, um_per_s, SweepEnd::Unknown));
            }
        }
        let end = match known(&taken, spacing_um).len() < LEAST_FRAMES {
            true => SweepEnd::Unknown,
            false => SweepEnd::NoPeak,
        };
        Ok(self.told(&taken, um_per_s, end))
    }

    /// From one frame to the next with the stage's answer, s, as it is in motion.
    fn frame_s(&self, scope: &Instrument, sink: &mut dyn Sink) -> Result<f64, ServoError> {
        let mut ends = [0.0; 2];
        for end in &mut ends {
            grab(scope, sink, FrameRole::Focus, &self.objective.id)?;
            scope.gate().position()?;
            *end = scope.clock().now().seconds();
        }
        Ok((ends[1] - ends[0]).max(1e-3))
    }

    /// Grabs frames on the way to a height.
    fn look_along(
        &self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        to_um: f64,
        um_per_s: f64,
        taken: &mut Vec<Taken>,
    ) -> Result<(), ServoError> {
        let mut before = None;
        let ended = scope.move_looking(&height(to_um), um_per_s * 1e-6, || {
            let asked = match before.take() {
                Some(asked) => Some(asked),
                None => place(scope)?,
            };
            let Some(asked) = asked else {
                return Ok(());
            };
            if taken.len() >= MOST_FRAMES {
                return Ok(());
            }
            let frame = grab(scope, sink, FrameRole::Focus, &self.objective.id)?;
            let answered = place(scope)?;
            if let Some(after) = answered {
                taken.push(Taken {
                    frame,
                    before: asked,
                    after,
                });
            }
            before = answered;
            Ok::<(), ServoError>(())
        });
        ended.map(drop)
    }

    /// Where the frames of a sweep show a peak.
    fn peak_of(&self, taken: &[Taken], spacing_um: f64) -> Option<f64> {
        let measure = self.options.measure.measure();
        let known = known(taken, spacing_um);
        let sample =
            |(t, z_um): &(&Taken, f64)| Sample::of(&t.frame, *z_um, measure, self.levels());
        let mut samples: Vec<Sample> = known.iter().map(sample).collect();
        samples.sort_by(|a, b| a.z_um.total_cmp(&b.z_um));
        if samples.len() < LEAST_FRAMES {
            return None;
        }
        // Finer ones are blurred by the motion.
        let level = self.levels() - 1;
        let contrast = self.options.min_contrast;
        let curve = Curve::of(&samples, level, measure, contrast, self.width_um(level));
        let best = curve.bracketed(self.contrast())?;
        Some(curve.rough_top(best, self.usual_um()))
    }
}

/// The frames that count, with their heights, um: of those at one height the first. A stage that tells its goal or its start all the way has few.
fn known(taken: &[Taken], spacing_um: f64) -> Vec<(&Taken, f64)> {
    let mut known: Vec<(&Taken, f64)> = Vec::new();
    for frame in taken {
        if let Some(z_um) = frame.z_um(spacing_um)
            && known
                .iter()
                .all(|(_, z)| (z - z_um).abs() > SAME * spacing_um)
        {
            known.push((frame, z_um));
        }
    }
    known
}

/// When the stage was asked, and where it says it is, um. `None` of one that does not tell while it moves.
fn place(scope: &Instrument) -> Result<Option<[f64; 2]>, ScopeError> {
    let asked = scope.clock().now().seconds();
    match scope.gate().position() {
        Ok(at) => {
            let answered = scope.clock().now().seconds();
            let z = at.z.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?;
            Ok(Some([0.5 * (asked + answered), z.um()]))
        }
        Err(error) if error.kind() == ErrorKind::Refused => Ok(None),
        Err(error) => Err(error),
    }
}
