//! Autofocus, the paper's section IV-B.1: sweep a range of heights, take the one with the largest mean |Laplacian|, here over the mean
//! luminance. Parts of the picture that are as sharp at every height do not count (`sharpness.rs`).
//!
//! The sweep is done twice, coarse over the candidate range and fine around its best, and the peak is a parabola through
//! the best samples. A sweep without a peak is an answer of its own: the stage goes back to where it started. Heights are those that the
//! stage says it is at, and towards the specimen there is a bound that no sweep passes.

use crate::event::tell;
use crate::procedure::{Procedure, Progress, withdrawn};
use crate::sharpness::{Grid, constant, sharpness_and_grid};
use crate::vision::grab;
use crate::{Event, FrameRole, ServoError, Sink};
use scopeservo_scope::{Axis, Instrument, Length, Objective, ScopeError, StagePose};
use serde::{Deserialize, Serialize};

/// Settings of the sweep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FocusOptions {
    /// Half-width of the candidate range around the present height, um.
    pub half_range_um: f64,
    /// No sweep goes nearer to the specimen than this from where the focus began, um. Where the best view lies at an end of the range
    /// it is looked for up to two half-widths farther on that side, as far as this allows.
    pub nearest_um: f64,
    /// Coarse step in depths of field (`wavelength / NA^2`), at most a tenth of the range.
    pub coarse_depths: f64,
    /// Wavelength for the depth of field, um.
    pub wavelength_um: f64,
    /// A sweep whose largest sharpness is less than this times its smallest shows no focus.
    pub min_contrast: f64,
}

impl Default for FocusOptions {
    fn default() -> Self {
        Self {
            half_range_um: 40.0,
            nearest_um: 120.0,
            coarse_depths: 2.0,
            wavelength_um: 0.55,
            min_contrast: 1.04,
        }
    }
}

/// Where the focus is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FocusResult {
    /// Height of the stage, um. `None` when the stage has no z and nothing was done.
    pub z_um: Option<f64>,
    /// Sharpness of the whole picture near there: where it is largest for what counts.
    pub sharpness: f64,
    /// Largest over smallest sharpness of the coarse sweep, of what counts in the picture.
    pub contrast: f64,
    /// Frames used.
    pub samples: usize,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
enum Pass {
    Coarse,
    Fine,
    Approach,
}

/// One look.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Sample {
    z_um: f64,
    /// Of the whole picture.
    sharpness: f64,
    /// Cell by cell.
    grid: Grid,
}

/// The autofocus as a step machine: one sample per step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Focus {
    options: FocusOptions,
    objective: Objective,
    start_um: Option<f64>,
    pass: Pass,
    extended: u8,
    /// Heights still to visit, ascending.
    plan_um: Vec<f64>,
    /// Of the present pass.
    samples: Vec<Sample>,
    /// Cells of the picture that are as sharp at every height of the coarse sweep.
    #[serde(default)]
    left_out: Vec<usize>,
    contrast: f64,
    taken: usize,
}

impl Focus {
    /// A sweep around the present height.
    pub fn new(objective: Objective, options: FocusOptions) -> Self {
        Self {
            options,
            objective,
            start_um: None,
            pass: Pass::Coarse,
            extended: 0,
            plan_um: Vec::new(),
            samples: Vec::new(),
            left_out: Vec::new(),
            contrast: 1.0,
            taken: 0,
        }
    }

    fn coarse_step_um(&self) -> f64 {
        let depth = self.options.wavelength_um / self.objective.numerical_aperture.powi(2);
        (self.options.coarse_depths * depth).min(self.options.half_range_um / 5.0)
    }

    /// Heights from `from` to `to` that the stage may go to, and that are not beyond the bound.
    fn plan(
        &self,
        scope: &Instrument,
        start_um: f64,
        [from, to]: [f64; 2],
        step: f64,
    ) -> Result<Vec<f64>, ServoError> {
        let count = ((to - from) / step).round().max(1.0) as usize;
        let nearer = |z: f64| scope.gate().info().positive_z.nearer_by(z, start_um);
        let heights: Vec<f64> = (0..=count)
            .map(|k| from + (to - from) * k as f64 / count as f64)
            // So that rounding does not leave out the bound itself.
            .filter(|&z| nearer(z) <= self.options.nearest_um + 1e-6)
            .collect();
        let places: Vec<StagePose> = heights.iter().map(|&z| height(z)).collect();
        let allowed = scope.gate().allowed(&places)?;
        let both = heights.into_iter().zip(allowed);
        Ok(both
            .filter_map(|(z, allowed)| allowed.then_some(z))
            .collect())
    }

    /// Height and sharpness of what counts, ascending.
    fn curve(&mut self) -> Vec<[f64; 2]> {
        self.samples.sort_by(|a, b| a.z_um.total_cmp(&b.z_um));
        let counted = |s: &Sample| match self.left_out.is_empty() {
            true => s.sharpness,
            false => s.grid.without(&self.left_out),
        };
        let curve = self.samples.iter().map(|s| [s.z_um, counted(s)]);
        curve.collect()
    }

    fn no_focus(&self) -> ServoError {
        ServoError::NoFocus {
            objective: self.objective.id.clone(),
            contrast: self.contrast,
            from_um: self.samples.first().map_or(f64::NAN, |s| s.z_um),
            to_um: self.samples.last().map_or(f64::NAN, |s| s.z_um),
        }
    }

    /// What the sweep shows, and the least contrast that is no noise.
    fn judged(&mut self) -> (Vec<[f64; 2]>, f64) {
        self.left_out.clear();
        self.curve();
        let grids: Vec<&Grid> = self.samples.iter().map(|s| &s.grid).collect();
        self.left_out = constant(&grids, self.options.min_contrast);
        let noise = grids.first().filter(|_| !self.left_out.is_empty());
        let noise = noise.map_or(0.0, |grid| grid.noise_without(&self.left_out));
        (self.curve(), self.options.min_contrast.max(1.0 + noise))
    }

    fn coarse_done(&mut self, scope: &Instrument, start_um: f64) -> Result<(), ServoError> {
        let (curve, min_contrast) = self.judged();
        let best = best(&curve);
        let least = curve.iter().map(|s| s[1]).fold(f64::INFINITY, f64::min);
        let Some(peak) = curve.get(best) else {
            return Err(self.no_focus());
        };
        self.contrast = peak[1] / least.max(1e-12);
        if self.contrast < min_contrast {
            scope.return_to_height(Length::from_um(start_um))?;
            return Err(self.no_focus());
        }
        let (z, step) = (peak[0], self.coarse_step_um());
        let at_end = best == 0 || best + 1 == curve.len();
        if at_end && self.extended < 2 {
            // The peak may lie beyond: look half a range further on that side.
            self.extended += 1;
            let reach = self.options.half_range_um;
            let beyond = match best == 0 {
                true => [z - reach, z - step],
                false => [z + step, z + reach],
            };
            self.plan_um = self.plan(scope, start_um, beyond, step)?;
            if !self.plan_um.is_empty() {
                return Ok(());
            }
        }
        if at_end {
            // Still rising where the sweep ends: that is no peak.
            scope.return_to_height(Length::from_um(start_um))?;
            return Err(self.no_focus());
        }
        self.pass = Pass::Fine;
        self.samples.clear();
        let around = [z - 1.5 * step, z + 1.5 * step];
        self.plan_um = self.plan(scope, start_um, around, step / 4.0)?;
        Ok(())
    }

    /// Goes to a height, and tells where the stage then says it is.
    fn go(scope: &Instrument, z_um: f64) -> Result<f64, ServoError> {
        let at = scope.move_to(&height(z_um))?.z;
        let at = at.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?;
        Ok(at.um())
    }

    fn advance(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<FocusResult>, ServoError> {
        if scope.gate().info().axis(Axis::Z).is_none() {
            return Ok(Progress::Done(FocusResult {
                z_um: None,
                sharpness: 0.0,
                contrast: 1.0,
                samples: 0,
            }));
        }
        let start_um = match self.start_um {
            Some(z) => z,
            None => {
                let here = scope.gate().position()?;
                // A stage that stands outside is told so, and not that it sees no focus.
                scope.gate().check(&here)?;
                let z = here.z.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?;
                let (z, reach) = (z.um(), self.options.half_range_um);
                self.start_um = Some(z);
                let step = self.coarse_step_um();
                self.plan_um = self.plan(scope, z, [z - reach, z + reach], step)?;
                z
            }
        };
        if self.pass == Pass::Approach {
            // From below, like every sample, so that play in the focus drive does not matter.
            let curve = self.curve();
            let best = best(&curve);
            let z = peak_of(&curve, best);
            let below = height(z - 2.0 * self.coarse_step_um());
            if scope.gate().check(&below).is_ok() {
                scope.move_to(&below)?;
            }
            let z = Self::go(scope, z)?;
            scope.focus_found(&self.objective.id, Length::from_um(z));
            return Ok(Progress::Done(FocusResult {
                z_um: Some(z),
                sharpness: self.samples[best].sharpness,
                contrast: self.contrast,
                samples: self.taken,
            }));
        }
        if !self.plan_um.is_empty() {
            let z = Self::go(scope, self.plan_um.remove(0))?;
            let frame = grab(scope, sink, FrameRole::Focus, &self.objective.id)?;
            let (sharpness, grid) = sharpness_and_grid(&frame);
            tell(scope, sink, Event::FocusSample { z_um: z, sharpness });
            self.samples.push(Sample {
                z_um: z,
                sharpness,
                grid,
            });
            self.taken += 1;
        }
        if self.plan_um.is_empty() {
            match self.pass {
                Pass::Coarse => self.coarse_done(scope, start_um)?,
                _ if self.samples.is_empty() => {
                    scope.return_to_height(Length::from_um(start_um))?;
                    return Err(self.no_focus());
                }
                _ => self.pass = Pass::Approach,
            }
        }
        Ok(Progress::Continue)
    }
}

/// The request for a height alone.
fn height(z_um: f64) -> StagePose {
    StagePose {
        z: Some(Length::from_um(z_um)),
        ..StagePose::default()
    }
}

/// The sharpest sample.
fn best(curve: &[[f64; 2]]) -> usize {
    (0..curve.len())
        .max_by(|&a, &b| curve[a][1].total_cmp(&curve[b][1]))
        .unwrap_or(0)
}

/// The top of the parabola through the samples around `best`, kept between its neighbours.
fn peak_of(samples: &[[f64; 2]], best: usize) -> f64 {
    let lo = best.saturating_sub(2);
    let hi = (best + 2).min(samples.len() - 1);
    let z0 = samples[best][0];
    let equations: Vec<([f64; 3], f64)> = samples[lo..=hi]
        .iter()
        .map(|s| ([1.0, s[0] - z0, (s[0] - z0).powi(2)], s[1]))
        .collect();
    match scopeservo_geometry::least_squares(&equations) {
        Some(([_, slope, bend], _)) if bend < 0.0 => {
            let top = z0 - slope / (2.0 * bend);
            top.clamp(samples[lo][0], samples[hi][0])
        }
        _ => z0,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parabola_finds_its_top_between_samples() {
        let samples: Vec<[f64; 2]> = (0..9)
            .map(|k| {
                let z = f64::from(k);
                [z, 5.0 - (z - 4.3f64).powi(2)]
            })
            .collect();
        assert!((peak_of(&samples, 4) - 4.3).abs() < 1e-9);
    }
}
