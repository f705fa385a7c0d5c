//! Measuring the tilt of a view, and levelling it, as a step machine.

use super::error::LevelError;
use super::lever::{Bounds, Lever};
use super::measure::MeasureTilt;
use super::options::{LevelOptions, LevelReport, Levelled};
use super::plane::NEEDED;
use super::tilt::{Tilt, TiltReport};
use super::tip::{LEAST_RAD, Tip, tip_back};
use crate::procedure::{Procedure, Progress, withdrawn};
use crate::{Calibration, ErrorKind, ServoError, Sink};
use scopeservo_geometry::Mat2;
use scopeservo_scope::{Axis, Instrument, Length, Objective, StagePose};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The axes that tip.
const AXES: [Axis; 2] = [Axis::Rx, Axis::Ry];
/// A turn that shows what an axis does is seen with so many standard deviations of a tilt, mrad, and lies between these.
const TRIAL_SIGMAS: f64 = 10.0;
const TRIAL_MRAD: [f64; 2] = [0.7, 4.0];
/// An axis tips the view by this share of its own angle, at least, or by this many standard deviations.
const FOLLOWS: f64 = 0.25;
const FOR_SURE: f64 = 3.0;
/// Of each correction so much is made.
const DAMPED: f64 = 0.9;
/// And no more at once, mrad.
const MOST_MRAD: f64 = 20.0;
/// A tilt that is so much smaller than it was is better, whatever is left.
const BETTER: f64 = 0.5;

/// What the next measurement is for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Aim {
    Before,
    /// What this axis (its number) does.
    Trial(usize),
    Round,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Measure(Box<MeasureTilt>),
    Tip(Box<Tip>),
}

/// Measures how the view is tilted, and levels it. The active objective must be in focus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Level {
    options: LevelOptions,
    objective: Objective,
    calibration: Option<Box<Calibration>>,
    state: Option<State>,
    aim: Aim,
    /// Where the stage stood when it began.
    start: Option<StagePose>,
    /// Where the objective was known to be in focus then.
    focus_before: Option<Length>,
    before: Option<Box<TiltReport>>,
    /// Turns that are due, rad.
    todo: VecDeque<(Axis, f64)>,
    /// What the turn before the next measurement was, of rx and ry, rad.
    turned: [f64; 2],
    /// The last slope, mrad along image x and y.
    slope: [f64; 2],
    /// What a rad of rx and of ry adds to the slope, in columns.
    response: Mat2,
    levers: [Lever; 2],
    /// Where it was last in focus, um.
    z_um: f64,
    rounds: u8,
}

impl Level {
    /// Its objective.
    pub fn objective(&self) -> &Objective {
        &self.objective
    }

    /// With `objective`.
    pub fn new(objective: Objective, options: LevelOptions) -> Self {
        Self {
            options,
            objective,
            calibration: None,
            state: None,
            aim: Aim::Before,
            start: None,
            focus_before: None,
            before: None,
            todo: VecDeque::new(),
            turned: [0.0; 2],
            slope: [0.0; 2],
            response: Mat2([[0.0; 2]; 2]),
            levers: [Lever::default(); 2],
            z_um: 0.0,
            rounds: 0,
        }
    }

    /// With a calibration, which tells the tilt along the stage's axes as well. Levelling does not need it.
    #[must_use]
    pub fn knowing(mut self, calibration: &Calibration) -> Self {
        self.calibration = Some(Box::new(calibration.clone()));
        self
    }

    fn measure(&mut self, aim: Aim) {
        let measure = MeasureTilt::new(self.objective.clone());
        let measure = match &self.calibration {
            Some(calibration) => measure.knowing(calibration),
            None => measure,
        };
        (self.aim, self.state) = (aim, Some(State::Measure(Box::new(measure))));
    }

    fn bounds(&self, scope: &Instrument, axis: Axis) -> Bounds {
        Bounds::new(self.options.lever_mm, scope.gate().info().axis(axis))
    }

    fn work(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<LevelReport>, ServoError> {
        match &mut self.state {
            None => {
                let here = scope.gate().position()?;
                self.z_um = here.z.map_or(0.0, Length::um);
                self.start = Some(here);
                let known = scope.focus_positions();
                self.focus_before = known.get(&self.objective.id).copied();
                self.measure(Aim::Before);
            }
            Some(State::Measure(measure)) => {
                if let Progress::Done(report) = measure.step(scope, sink)? {
                    return self.seen(scope, report);
                }
            }
            Some(State::Tip(tip)) => {
                let ended = tip.step(scope, sink);
                // Also of a turn that found no focus afterwards: it was made.
                let k = number(tip.axis);
                (self.levers[k], self.z_um) = (tip.lever, tip.z_um);
                if let Progress::Done(()) = ended? {
                    match self.todo.pop_front() {
                        Some(turn) => self.tip(scope, turn),
                        None => self.measure(self.aim),
                    }
                }
            }
        }
        Ok(Progress::Continue)
    }

    fn tip(&mut self, scope: &Instrument, turn: (Axis, f64)) {
        let known = (self.levers[number(turn.0)], self.bounds(scope, turn.0));
        let tip = Tip::new(turn, &self.objective, &self.options.focus, known, self.z_um);
        self.state = Some(State::Tip(Box::new(tip)));
    }

    /// Turns, then measures again.
    fn go(&mut self, scope: &Instrument, turns: Vec<(Axis, f64)>, aim: Aim) {
        self.turned = [0.0; 2];
        for (axis, by) in &turns {
            self.turned[number(*axis)] += by;
        }
        self.aim = aim;
        self.todo = turns.into();
        match self.todo.pop_front() {
            Some(turn) => self.tip(scope, turn),
            None => self.measure(aim),
        }
    }

    /// A measurement ended.
    fn seen(
        &mut self,
        scope: &Instrument,
        report: TiltReport,
    ) -> Result<Progress<LevelReport>, ServoError> {
        let axes: Vec<Axis> = AXES
            .into_iter()
            .filter(|axis| scope.gate().info().axis(*axis).is_some())
            .collect();
        let is_level = report.is_level();
        if self.aim == Aim::Before {
            let ends = !self.options.apply || axes.is_empty() || is_level == Some(true);
            self.before = Some(Box::new(report.clone()));
            if ends {
                return Ok(Progress::Done(LevelReport {
                    before: report,
                    levelled: None,
                    can_tip: !axes.is_empty(),
                }));
            }
        }
        let tilt = report.tilt.as_ref().ok_or(LevelError::TiltUnseen {
            objective: self.objective.id.clone(),
            seen: report.heights.len(),
            needed: NEEDED,
        })?;
        let slope = tilt.slope_um_per_mm.map(|k| k.value);
        let change = [0, 1].map(|k| slope[k] - self.slope[k]);
        let sigma = sigma_mrad(tilt);
        self.slope = slope;
        match self.aim {
            Aim::Before => self.try_axis(scope, (0, axes[0]), sigma)?,
            Aim::Trial(k) => {
                self.learn(axes[k], change, sigma)?;
                match axes.get(k + 1) {
                    Some(next) => self.try_axis(scope, (k + 1, *next), sigma)?,
                    None => return self.correct(scope, &axes, report),
                }
            }
            Aim::Round => {
                self.rounds += 1;
                self.follow(change, sigma);
                return self.correct(scope, &axes, report);
            }
        }
        Ok(Progress::Continue)
    }

    /// A turn of one axis, large enough for its effect to be seen.
    fn try_axis(
        &mut self,
        scope: &Instrument,
        (k, axis): (usize, Axis),
        sigma: f64,
    ) -> Result<(), ServoError> {
        let by = 1e-3 * (TRIAL_SIGMAS * sigma).clamp(TRIAL_MRAD[0], TRIAL_MRAD[1]);
        let goals = scope.gate().goals()?;
        let here = goals.here.si(axis).unwrap_or(f64::NAN);
        let to = |by: f64| StagePose::default().with_si(axis, here + by);
        let by = match goals.allow(&to(by)) {
            true => by,
            false => -by,
        };
        scope.gate().check(&to(by))?;
        self.go(scope, vec![(axis, by)], Aim::Trial(k));
        Ok(())
    }

    /// What a turn of one axis did to the slope.
    fn learn(&mut self, axis: Axis, change: [f64; 2], sigma: f64) -> Result<(), ServoError> {
        let k = number(axis);
        let by = self.turned[k];
        let seen = change[0].hypot(change[1]);
        // Of two measurements.
        let least = (FOR_SURE * 2f64.sqrt() * sigma).max(FOLLOWS * 1e3 * by.abs());
        if seen < least {
            return Err(LevelError::TiltStays { axis, asked: by }.into());
        }
        for (row, change) in self.response.0.iter_mut().zip(change) {
            row[k] = change / by;
        }
        Ok(())
    }

    /// What a correction did corrects what is believed of the axes (Broyden's rule).
    fn follow(&mut self, change: [f64; 2], sigma: f64) {
        let square: f64 = self.turned.iter().map(|t| t * t).sum();
        if 1e3 * square.sqrt() < TRIAL_SIGMAS * sigma {
            return;
        }
        for (row, change) in self.response.0.iter_mut().zip(change) {
            let expected = row[0] * self.turned[0] + row[1] * self.turned[1];
            for (cell, turned) in row.iter_mut().zip(self.turned) {
                *cell += (change - expected) * turned / square;
            }
        }
    }

    /// The next correction, or the end.
    fn correct(
        &mut self,
        scope: &Instrument,
        axes: &[Axis],
        report: TiltReport,
    ) -> Result<Progress<LevelReport>, ServoError> {
        let level = report.is_level() == Some(true);
        // By luck a trial may level; what is still seen then is taken away all the same.
        let shown = report.tilt.as_ref().is_some_and(|t| t.shown);
        let ends = level && (self.rounds > 0 || !shown) || self.rounds >= self.options.rounds;
        let turns = match ends {
            true => Vec::new(),
            false => self.turns(scope, axes)?,
        };
        if !turns.is_empty() {
            self.go(scope, turns, Aim::Round);
            return Ok(Progress::Continue);
        }
        let corner = |r: &TiltReport| r.tilt.as_ref().map_or(f64::NAN, |t| t.corner_um.value);
        let before = self.before.as_deref().cloned();
        let before = before.ok_or_else(|| ServoError::CannotGoOn("nothing was measured".into()))?;
        let (before_um, after_um) = (corner(&before), corner(&report));
        if !level && (after_um.is_nan() || after_um > BETTER * before_um) {
            let error = LevelError::NotLevelled {
                before_um,
                after_um,
            };
            return Err(error.into());
        }
        let (start, here) = (self.start.unwrap_or_default(), scope.gate().position()?);
        let turned = |axis: Axis| Some((here.si(axis)? - start.si(axis)?).to_degrees());
        let lever = |axis: Axis| here.si(axis).map(|_| 1e3 * self.levers[number(axis)].m());
        Ok(Progress::Done(LevelReport {
            before,
            levelled: Some(Levelled {
                after: report,
                level,
                turned_deg: AXES.map(turned),
                lever_um_per_mrad: AXES.map(lever),
                rounds: self.rounds,
            }),
            can_tip: true,
        }))
    }

    /// The turns that take the slope away, as far as the limits allow.
    fn turns(&self, scope: &Instrument, axes: &[Axis]) -> Result<Vec<(Axis, f64)>, ServoError> {
        let g = self.slope;
        let column = |k: usize| [self.response.0[0][k], self.response.0[1][k]];
        let by = match axes {
            [axis] => {
                let (k, mut by) = (number(*axis), [0.0; 2]);
                let [a, b] = column(k);
                by[k] = -(a * g[0] + b * g[1]) / (a * a + b * b);
                by
            }
            _ => match self.response.inverse() {
                Some(m) => [0, 1].map(|k| -(m.0[k][0] * g[0] + m.0[k][1] * g[1])),
                None => [0.0; 2],
            },
        };
        let largest = by[0].abs().max(by[1].abs());
        let share = DAMPED.min(1e-3 * MOST_MRAD / largest.max(1e-12));
        let goals = scope.gate().goals()?;
        let allowed = |share: f64| {
            let mut to = StagePose::default();
            for axis in axes {
                let here = goals.here.si(*axis).unwrap_or(f64::NAN);
                to = to.with_si(*axis, here + share * by[number(*axis)]);
            }
            goals.allow(&to)
        };
        // As far as the stage tips.
        let shares = (0..4).map(|k| share * 0.5f64.powi(k));
        let share = shares.into_iter().find(|s| allowed(*s)).unwrap_or(0.0);
        let turns = axes.iter().map(|a| (*a, share * by[number(*a)]));
        Ok(turns.filter(|(_, by)| by.abs() >= LEAST_RAD).collect())
    }

    /// To where it stood before anything was turned.
    fn go_home(&self, scope: &Instrument) -> Result<(), ServoError> {
        let Some(start) = self.start else {
            return Ok(());
        };
        let axes = AXES.into_iter().filter(|axis| start.si(*axis).is_some());
        // The last that was tried first.
        let tipped: Vec<(Axis, Lever, Bounds)> = axes
            .rev()
            .map(|axis| (axis, self.levers[number(axis)], self.bounds(scope, axis)))
            .collect();
        tip_back(scope, &tipped, &start, self.z_um)?;
        // Where it was in focus meanwhile it is no more.
        match self.focus_before {
            Some(z) => scope.focus_found(&self.objective.id, z),
            None => scope.forget_focus(&self.objective.id),
        }
        Ok(())
    }
}

fn number(axis: Axis) -> usize {
    usize::from(axis == Axis::Ry)
}

/// The larger standard deviation of the slope, mrad.
fn sigma_mrad(tilt: &Tilt) -> f64 {
    let [x, y] = tilt.slope_um_per_mm;
    x.sigma.max(y.sigma)
}

impl Procedure for Level {
    type Output = LevelReport;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<LevelReport>, ServoError> {
        let ended = match self.work(scope, sink) {
            // What was not seen, or not allowed, leaves a stage that can go back; a stop or a fault leaves it where it is.
            Err(error) if matches!(error.kind(), ErrorKind::Answer | ErrorKind::Refusal) => {
                self.go_home(scope).and(Err(error))
            }
            ended => ended,
        };
        withdrawn(scope, ended)
    }
}
