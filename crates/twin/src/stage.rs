//! The stage as a function of time: what it says (encoder) and where it really is (truth).
//!
//! The history is a list of segments, each a pure function of time; nothing runs in the background, so a virtual and a
//! real clock give the same motion.

use crate::seeds;
use crate::stage_config::{StageConfig, coarse_si};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use scopeservo_scope::{Axis, Motion, ScopeError, StagePose};
use std::f64::consts::TAU;

/// SI values of the six axes in the order of [`Axis::ALL`].
pub(crate) type Six = [f64; 6];

pub(crate) fn index(axis: Axis) -> usize {
    axis as usize
}

/// A stretch of time in which one rule tells where the stage is.
#[derive(Debug, Clone)]
struct Segment {
    start: f64,
    /// End of travel; `start` for a stage at rest.
    arrive: f64,
    settled: f64,
    /// Time to full speed, s.
    ramp: f64,
    /// Commanded places.
    from: Six,
    to: Six,
    /// True minus commanded.
    from_error: Six,
    to_error: Six,
    /// Reported minus commanded, at rest.
    encoder: Six,
    phase: [f64; 3],
    ended: Motion,
}

impl Segment {
    fn share(&self, t: f64) -> f64 {
        let whole = self.arrive - self.start;
        if t >= self.arrive || whole <= 0.0 {
            return 1.0;
        }
        trapezoid((t - self.start).max(0.0), whole, self.ramp.min(0.5 * whole))
    }
    fn commanded(&self, t: f64) -> Six {
        let s = self.share(t);
        // At the end exactly the goal, not a rounding of it.
        std::array::from_fn(|i| {
            if s >= 1.0 {
                self.to[i]
            } else {
                self.from[i] + s * (self.to[i] - self.from[i])
            }
        })
    }
    fn error(&self, t: f64) -> Six {
        let s = self.share(t);
        std::array::from_fn(|i| self.from_error[i] + s * (self.to_error[i] - self.from_error[i]))
    }
}

/// Share of the way after `t` of `whole` seconds with constant acceleration during `ramp` at either end.
fn trapezoid(t: f64, whole: f64, ramp: f64) -> f64 {
    if ramp <= 0.0 {
        return t / whole;
    }
    let top = 1.0 / (whole - ramp);
    if t < ramp {
        0.5 * top * t * t / ramp
    } else if t <= whole - ramp {
        top * (t - 0.5 * ramp)
    } else {
        let left = whole - t;
        1.0 - 0.5 * top * left * left / ramp
    }
}

/// Longest history kept, s: longer than any exposure with its delays.
const HISTORY_S: f64 = 30.0;

/// The stage, as far as the laws of motion go.
pub(crate) struct StageState {
    config: StageConfig,
    segments: Vec<Segment>,
    rng: Pcg64Mcg,
    /// -1 or +1: where each axis last came from.
    direction: Six,
    backlash: Six,
    lost: Six,
    stuck: [Option<f64>; 6],
    walls: [Option<[f64; 2]>; 6],
    /// For each axis that is moved, another and how far it goes along.
    along: [Option<(usize, f64)>; 6],
    misreported: Six,
    /// What moves of x and y do, and of the rotation, in place of what they are told.
    goes: ([[f64; 2]; 2], f64),
    /// How far that has led astray.
    astray: Six,
    ignores_stop: bool,
    drift_rate: [f64; 3],
    drift_before: [f64; 3],
    drift_since: f64,
}

impl StageState {
    pub(crate) fn new(config: StageConfig, seed: u64, now: f64) -> Self {
        let mut here = [0.0; 6];
        let mut backlash = [0.0; 6];
        for a in &config.axes {
            here[index(a.axis)] = 0.5 * (a.travel[0] + a.travel[1]) * coarse_si(a.axis);
            backlash[index(a.axis)] = a.backlash * 1e-6;
        }
        let drift_rate = config.drift_um_per_s.map(|v| v * 1e-6);
        let mut stage = Self {
            config,
            segments: Vec::new(),
            rng: seeds::rng(seed, seeds::STAGE, 0),
            direction: [1.0; 6],
            backlash,
            lost: [0.0; 6],
            stuck: [None; 6],
            walls: [None; 6],
            along: [None; 6],
            misreported: [0.0; 6],
            goes: ([[1.0, 0.0], [0.0, 1.0]], 1.0),
            astray: [0.0; 6],
            ignores_stop: false,
            drift_rate,
            drift_before: [0.0; 3],
            drift_since: now,
        };
        let error = stage.draw_error(&[0.0; 6], &[true; 6]);
        stage.segments.push(Segment {
            start: now,
            arrive: now,
            settled: now,
            ramp: 0.0,
            from: here,
            to: here,
            from_error: error,
            to_error: error,
            encoder: [0.0; 6],
            phase: [0.0; 3],
            ended: Motion::Settled,
        });
        stage
    }

    /// True minus commanded after an arrival of the axes that `moved`.
    fn draw_error(&mut self, before: &Six, moved: &[bool; 6]) -> Six {
        let mut error = *before;
        for a in &self.config.axes {
            let i = index(a.axis);
            let drawn: f64 = self.rng.random_range(-1.0..1.0);
            if moved[i] {
                error[i] = self.astray[i] + a.repeatability * 1e-6 * drawn
                    - 0.5 * self.direction[i] * self.backlash[i];
            }
        }
        error
    }

    fn draw_encoder(&mut self, before: &Six, moved: &[bool; 6]) -> Six {
        let mut encoder = *before;
        for a in &self.config.axes {
            let drawn: f64 = self.rng.random_range(-1.0..1.0);
            if moved[index(a.axis)] {
                encoder[index(a.axis)] = a.encoder_error * 1e-6 * drawn;
            }
        }
        encoder
    }

    fn last(&self) -> &Segment {
        // There is always one: the start.
        &self.segments[self.segments.len() - 1]
    }

    fn at(&self, t: f64) -> &Segment {
        self.segments
            .iter()
            .rev()
            .find(|s| s.start <= t)
            .unwrap_or(&self.segments[0])
    }

    pub(crate) fn motion(&self, now: f64) -> Motion {
        let last = self.last();
        if now < last.settled {
            Motion::Moving
        } else {
            last.ended
        }
    }

    /// What the stage says.
    pub(crate) fn reported(&self, now: f64) -> StagePose {
        let last = self.last();
        let commanded = last.commanded(now);
        let mut pose = StagePose::default();
        for a in &self.config.axes {
            let i = index(a.axis);
            let said = commanded[i] + last.encoder[i] + self.misreported[i];
            pose = pose.with_si(a.axis, said);
        }
        pose
    }

    /// Where the stage really is. Missing axes are zero.
    pub(crate) fn truth(&self, t: f64) -> Six {
        let segment = self.at(t);
        let (commanded, error) = (segment.commanded(t), segment.error(t));
        let shake = self.shake(segment, t);
        let mut pose = [0.0; 6];
        for i in 0..6 {
            pose[i] = self.stuck[i].unwrap_or(commanded[i] + error[i] + self.lost[i]);
        }
        for i in 0..3 {
            pose[i] +=
                shake[i] + self.drift_before[i] + self.drift_rate[i] * (t - self.drift_since);
        }
        pose
    }

    fn shake(&self, segment: &Segment, t: f64) -> [f64; 3] {
        let ambient = self.config.ambient_um * 1e-6;
        let mut shake = [
            ambient * (TAU * 23.0 * t).sin(),
            ambient * (TAU * 31.0 * t + 1.0).sin(),
            0.5 * ambient * (TAU * 17.0 * t + 2.0).sin(),
        ];
        // A quarter of the settling time takes the ringing to 2 % when the stage calls itself settled.
        let tau = 0.25 * self.config.settle_s;
        let ring = if segment.settled <= segment.start {
            0.0
        } else if t < segment.arrive {
            1.0
        } else if tau > 0.0 {
            (-(t - segment.arrive) / tau).exp()
        } else {
            0.0
        };
        let moving = ring * self.config.vibration_um * 1e-6;
        for (i, (share, hz)) in [(1.0, 61.0), (0.8, 83.0), (0.3, 47.0)]
            .into_iter()
            .enumerate()
        {
            shake[i] += moving * share * (TAU * hz * t + segment.phase[i]).sin();
        }
        shake
    }

    pub(crate) fn start_move(&mut self, to: &StagePose, now: f64) -> Result<(), ScopeError> {
        self.start_move_at(to, f64::INFINITY, now)
    }

    /// The same with no linear axis faster than this, m/s.
    pub(crate) fn start_move_at(
        &mut self,
        to: &StagePose,
        m_per_s: f64,
        now: f64,
    ) -> Result<(), ScopeError> {
        self.config.info().check_goal(to)?;
        if self.motion(now) == Motion::Moving {
            return Err(ScopeError::Busy { device: "stage" });
        }
        let (from, from_error) = (self.last().commanded(now), self.last().error(now));
        let encoder = self.last().encoder;
        let mut goal = from;
        let mut moved = [false; 6];
        let mut whole: f64 = 0.0;
        for a in &self.config.axes {
            let i = index(a.axis);
            goal[i] = to.si(a.axis).unwrap_or(goal[i]);
            if let (true, Some((other, si))) = (goal[i] != from[i], self.along[i]) {
                goal[other] += si;
            }
        }
        for a in &self.config.axes {
            let i = index(a.axis);
            if let Some([low, high]) = self.walls[i] {
                // What stands beyond an obstacle already can still come back.
                goal[i] = goal[i].clamp(low.min(from[i]), high.max(from[i]));
            }
            if goal[i] != from[i] {
                moved[i] = true;
                self.direction[i] = (goal[i] - from[i]).signum();
                let usual = a.speed * coarse_si(a.axis);
                let speed = match a.axis.is_rotation() {
                    true => usual,
                    false => usual.min(m_per_s),
                };
                whole = whole.max((goal[i] - from[i]).abs() / speed);
            }
        }
        let any = moved.contains(&true);
        let scattered = if self.config.parallel {
            [any; 6]
        } else {
            moved
        };
        let way = std::array::from_fn(|i| goal[i] - from[i]);
        let scattered = self.go_astray(&way, scattered);
        let to_error = self.draw_error(&from_error, &scattered);
        let encoder = self.draw_encoder(&encoder, &scattered);
        let phase = std::array::from_fn(|_| self.rng.random_range(0.0..TAU));
        // Full speed over the whole way, plus the ramps; short ways never reach full speed.
        let ramp = self.config.ramp_s;
        let travel = if whole >= ramp {
            whole + ramp
        } else {
            2.0 * (whole * ramp).sqrt()
        };
        let arrive = now + if any { travel } else { 0.0 };
        self.push(Segment {
            start: now,
            arrive,
            settled: if any {
                arrive + self.config.settle_s
            } else {
                now
            },
            ramp,
            from,
            to: goal,
            from_error,
            to_error,
            encoder,
            phase,
            ended: Motion::Settled,
        });
        Ok(())
    }

    pub(crate) fn stop(&mut self, now: f64) {
        if !self.ignores_stop {
            self.halt(now);
        }
    }

    /// Stops, whatever it obeys.
    pub(crate) fn halt(&mut self, now: f64) {
        if self.motion(now) != Motion::Moving {
            return;
        }
        let last = self.last();
        let (here, error) = (last.commanded(now), last.error(now));
        let (encoder, phase) = (last.encoder, last.phase);
        self.push(Segment {
            start: now,
            arrive: now,
            settled: now,
            ramp: 0.0,
            from: here,
            to: here,
            from_error: error,
            to_error: error,
            encoder,
            phase,
            ended: Motion::Stopped,
        });
    }

    fn push(&mut self, segment: Segment) {
        let old = segment.start - HISTORY_S;
        // A segment may go once its successor began before the history.
        while self.segments.len() > 1 && self.segments[1].start < old {
            self.segments.remove(0);
        }
        self.segments.push(segment);
    }

    pub(crate) fn lose_steps(&mut self, axis: Axis, si: f64) {
        self.lost[index(axis)] += si;
    }

    pub(crate) fn stick(&mut self, axis: Axis, stuck: bool, now: f64) {
        let i = index(axis);
        self.stuck[i] = None;
        if stuck {
            let (c, e) = (self.last().commanded(now), self.last().error(now));
            self.stuck[i] = Some(c[i] + e[i] + self.lost[i]);
        }
    }

    pub(crate) fn set_wall(&mut self, axis: Axis, between: Option<[f64; 2]>) {
        // What does not rise is no obstacle.
        let rises = |w: &[f64; 2]| w[0] <= w[1];
        self.walls[index(axis)] = between.filter(rises);
    }

    pub(crate) fn take_along(&mut self, axis: Axis, along: Axis, si: f64) {
        let has = self.config.has(along) && axis != along && si != 0.0;
        self.along[index(axis)] = has.then_some((index(along), si));
    }

    pub(crate) fn go(&mut self, xy: [[f64; 2]; 2], rz: f64) {
        self.goes = (xy, rz);
    }

    /// A move leads elsewhere than it is told; also which axes then scatter.
    fn go_astray(&mut self, way: &Six, mut scattered: [bool; 6]) -> [bool; 6] {
        let (map, turns) = self.goes;
        let [x, y, turn] = [Axis::X, Axis::Y, Axis::Rz].map(|axis| way[index(axis)]);
        let really = [0, 1].map(|k| map[k][0] * x + map[k][1] * y);
        for (axis, off) in [
            (Axis::X, really[0] - x),
            (Axis::Y, really[1] - y),
            (Axis::Rz, (turns - 1.0) * turn),
        ] {
            self.astray[index(axis)] += off;
            scattered[index(axis)] |= off != 0.0;
        }
        scattered
    }

    pub(crate) fn misreport(&mut self, axis: Axis, si: f64) {
        self.misreported[index(axis)] = si;
    }

    pub(crate) fn ignore_stops(&mut self, ignores: bool) {
        self.ignores_stop = ignores;
    }

    pub(crate) fn set_backlash(&mut self, axis: Axis, si: f64) {
        self.backlash[index(axis)] = si;
    }

    pub(crate) fn set_ambient(&mut self, um: f64) {
        self.config.ambient_um = um;
    }

    pub(crate) fn set_drift(&mut self, um_per_s: [f64; 3], now: f64) {
        for i in 0..3 {
            self.drift_before[i] += self.drift_rate[i] * (now - self.drift_since);
        }
        self.drift_since = now;
        self.drift_rate = um_per_s.map(|v| v * 1e-6);
    }
}

#[cfg(test)]
#[path = "stage_tests.rs"]
mod tests;
