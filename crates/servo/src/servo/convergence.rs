//! The convergence test: when a loop has arrived, and when it gives up.

use super::criteria::Criteria;
use super::scatter::{Scatter, Spread};
use crate::proof::Drift;
use crate::{PoseError, ServoEnd, ServoError, ServoOptions, ServoResult};
use scopeservo_registration::NotFound;
use scopeservo_scope::Instrument;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Interval of looking for a stop while waiting.
const POLL: Duration = Duration::from_millis(20);

/// The error in one frame, how well it is known, and when.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Measured {
    pub(crate) error: PoseError,
    /// Standard deviation of its distance by the registration, um.
    pub(crate) sigma_um: f64,
    /// Standard deviation of its angle, degrees.
    pub(crate) sigma_deg: f64,
    pub(crate) inliers: usize,
    /// When the frame was exposed, on the instrument's clock.
    pub(crate) time_s: f64,
}

/// What the test says of a frame.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Standing {
    /// Not there: the stage moves.
    Outside,
    /// To be confirmed by the next frame from the same place.
    Inside,
    /// Not there, like the moves before, which came no nearer; with the end that this is where nothing is left to try.
    Scattered(Spread, ServoEnd),
    /// The loop is over.
    Ended(ServoEnd),
}

/// What the frames of a loop have shown so far.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Convergence {
    pub(crate) iteration: usize,
    /// The error from which divergence counts.
    first: Option<PoseError>,
    /// Frames in a row that passed.
    passed: Vec<Measured>,
    drift: Drift,
    /// Frames after a move that were only nearly there.
    #[serde(default)]
    pub(crate) nearly: usize,
    /// The last frame, while nothing moved since.
    resting: Option<Measured>,
    /// Frames since the last move, where all of them passed.
    #[serde(default)]
    rested: Vec<Measured>,
    /// Frames that did not confirm one from the same place.
    #[serde(default)]
    shaken: u8,
    /// A drift is waited for until then, on the instrument's clock.
    #[serde(default)]
    pub(crate) settles_until_s: Option<f64>,
    /// How moves end.
    #[serde(default)]
    pub(crate) scatter: Scatter,
    /// Frames to be looked at before the next move; `None` until moves come no nearer.
    #[serde(default)]
    rests: Option<u8>,
    /// Moves come no nearer than this.
    #[serde(default)]
    pub(crate) spread: Option<Spread>,
}

/// So many frames show whether what comes no nearer drifts.
const RESTS: u8 = 3;
/// A view that passed in so many frames from one place, and is not steady enough to be confirmed, shakes: it is where it is on average.
const SHAKES: usize = 8;
/// So many frames that did not confirm the one before show that it may.
const SHAKEN: u8 = 2;
/// While a drift is waited for it is looked at so many times more seldom.
const SELDOM: f64 = 2.0;

impl Convergence {
    /// Whether the target was seen at all.
    pub(crate) fn seen(&self) -> bool {
        self.first.is_some()
    }

    /// Waits until the next frame may confirm the last one: what drifts is seen to.
    pub(crate) fn rest(
        &mut self,
        criteria: &Criteria<'_>,
        scope: &Instrument,
    ) -> Result<(), ServoError> {
        let Some(before) = self.resting.filter(|_| criteria.is_arrival) else {
            return Ok(());
        };
        let times = self.settles_until_s.map_or(1.0, |_| SELDOM);
        let rest_s = times * criteria.options.confirmation_s;
        let until = before.time_s + rest_s;
        loop {
            let left = until - scope.clock().now().seconds();
            // A clock that was started anew after a kill knows nothing of the frame before.
            if left > rest_s {
                self.passed.clear();
                (self.resting, self.drift) = (None, Drift::default());
                return Ok(());
            }
            // What is left of rounding is no time: a clock may not even move by it.
            if left < 1e-6 {
                return Ok(());
            }
            scope.clock().sleep(POLL.min(Duration::from_secs_f64(left)));
            scope.check_cancel()?;
        }
    }

    /// Takes a frame that passes, or does not.
    pub(crate) fn take(
        &mut self,
        criteria: &Criteria<'_>,
        now: Measured,
        passes: bool,
    ) -> Standing {
        let moved = self.resting.is_none();
        if let Some(um_per_s) = self.drifts(criteria, now) {
            let last = self.result(now);
            return Standing::Ended(ServoEnd::Drifting { um_per_s, last });
        }
        let first = *self.first.get_or_insert(now.error);
        // What was suspected to drift is confirmed anew.
        if !passes || self.drift.suspected() {
            let contradicts = !std::mem::take(&mut self.passed).is_empty();
            self.shaken = self.shaken.saturating_add(u8::from(contradicts));
        }
        match passes {
            true => {
                self.passed.push(now);
                self.rested.push(now);
            }
            false => self.rested.clear(),
        }
        if self.shakes(criteria) {
            self.passed = std::mem::take(&mut self.rested);
        }
        if moved && criteria.is_arrival {
            self.scatter.take(now.error);
        }
        // Of what shakes two frames alike are chance, and many tell by how much.
        let shakes = self.spread.is_some() || self.settles_until_s.is_some();
        let needed = match shakes || self.shaken >= SHAKEN {
            true => SHAKES,
            false => criteria.options.confirmations.max(1),
        };
        if self.passed.len() >= needed {
            let error = mean(&self.passed);
            let result = self.result(Measured { error, ..now });
            Standing::Ended(ServoEnd::Converged(ServoResult {
                limited_by: criteria.limit(&result),
                angle_is_left: !criteria.turns,
                ..result
            }))
        } else if let Some(end) = criteria.falls_short(&self.result(now)) {
            Standing::Ended(end)
        } else if criteria.diverged(&now.error, &first) {
            Standing::Ended(ServoEnd::Diverged(self.result(now)))
        } else if self.iteration + 1 >= criteria.options.max_iterations {
            Standing::Ended(ServoEnd::IterationLimit(self.result(now)))
        } else if passes {
            Standing::Inside
        } else {
            self.outside(criteria, now)
        }
    }

    /// Whether the view shakes about a place that rests.
    fn shakes(&self, criteria: &Criteria<'_>) -> bool {
        if self.rested.len() < SHAKES.max(criteria.options.confirmations) {
            return false;
        }
        let (early, late) = self.rested.split_at(self.rested.len() / 2);
        let (a, b) = (mean(early).t_um(), mean(late).t_um());
        let time = |all: &[Measured]| all.iter().map(|m| m.time_s).sum::<f64>() / all.len() as f64;
        let tolerance_um = criteria.options.position_px * criteria.view_um_per_px;
        f64::hypot(a[0] - b[0], a[1] - b[1]) <= 0.5 * tolerance_um * (time(late) - time(early))
    }

    /// Not there: whether moves still come nearer. Where they do not, a drift may be why, and is looked for first.
    fn outside(&mut self, criteria: &Criteria<'_>, now: Measured) -> Standing {
        let tolerance = [0, 1].map(|k| criteria.tolerance(k));
        let stays = self.scatter.stays(tolerance);
        let stays = stays.filter(|_| criteria.scatter.is_some());
        match (stays, self.rests) {
            (_, Some(left @ 1..)) => {
                self.rests = Some(left - 1);
                Standing::Inside
            }
            (None, _) => Standing::Outside,
            (Some(_), None) => {
                self.rests = Some(RESTS);
                Standing::Inside
            }
            (Some(spread), Some(_)) => {
                let end = criteria.scattered(&spread, &self.result(now));
                Standing::Scattered(spread, end)
            }
        }
    }

    /// How fast the view drifts, when it does for sure: it changed since the last frame, and nothing moved.
    fn drifts(&mut self, criteria: &Criteria<'_>, now: Measured) -> Option<f64> {
        if !criteria.is_arrival {
            return None;
        }
        let before = self.resting.replace(now)?;
        let way_um = [0, 1].map(|k| now.error.t_um()[k] - before.error.t_um()[k]);
        let tolerance_um = criteria.options.position_px * criteria.view_um_per_px;
        self.drift.take(
            way_um,
            now.time_s - before.time_s,
            f64::hypot(now.sigma_um, before.sigma_um),
            tolerance_um,
        )
    }

    /// Takes a lost frame, the `lost`-th in a row.
    pub(crate) fn lose(
        &mut self,
        options: &ServoOptions,
        lost: usize,
        reason: &NotFound,
    ) -> Option<ServoEnd> {
        self.confirm_anew();
        self.iteration += 1;
        let over = lost >= options.max_lost.max(1) || self.iteration >= options.max_iterations;
        over.then(|| ServoEnd::Lost(reason.clone()))
    }

    /// Takes a frame that will not be believed, and is looked at again; tells when no iteration is left.
    pub(crate) fn disbelieve(&mut self, options: &ServoOptions, now: Measured) -> Option<ServoEnd> {
        self.passed.clear();
        self.iteration += 1;
        let over = self.iteration >= options.max_iterations;
        over.then(|| ServoEnd::Unproven(self.result(now)))
    }

    /// The stage moves: the next frame confirms nothing.
    pub(crate) fn moving(&mut self) {
        self.resting = None;
        self.rested.clear();
    }

    /// No frame so far confirms the next one.
    pub(crate) fn confirm_anew(&mut self) {
        self.passed.clear();
        self.rested.clear();
        self.resting = None;
    }

    /// Nothing that another process saw confirms what this one sees, whose clock is another.
    pub(crate) fn go_on_after_a_kill(&mut self) {
        self.confirm_anew();
        self.drift = Drift::default();
    }

    /// Divergence counts from the next frame on.
    pub(crate) fn begin_anew(&mut self) {
        self.first = None;
        self.scatter.clear();
    }

    /// What is known with the frame `now`.
    pub(crate) fn result(&self, now: Measured) -> ServoResult {
        ServoResult {
            iterations: self.iteration + 1,
            inliers: now.inliers,
            error: now.error,
            sigma_um: f64::hypot(now.sigma_um, scatter_um(&self.passed)),
            sigma_deg: now.sigma_deg,
            limited_by: None,
            angle_is_left: false,
        }
    }
}

fn mean(frames: &[Measured]) -> PoseError {
    PoseError::mean(frames.iter().map(|m| m.error))
}

/// Root mean square distance of the errors from their mean, um; zero for fewer than two.
fn scatter_um(frames: &[Measured]) -> f64 {
    if frames.len() < 2 {
        return 0.0;
    }
    let middle = mean(frames);
    let off_sq = |m: &Measured| {
        (m.error.t_m[0] - middle.t_m[0]).powi(2) + (m.error.t_m[1] - middle.t_m[1]).powi(2)
    };
    let sum_sq: f64 = frames.iter().map(off_sq).sum();
    (sum_sq / (frames.len() - 1) as f64).sqrt() * 1e6
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::servo::criteria::tests::criteria;

    fn at(x_um: f64, y_um: f64, angle_deg: f64, time_s: f64) -> Measured {
        Measured {
            error: PoseError {
                t_m: [x_um * 1e-6, y_um * 1e-6],
                theta_rad: angle_deg.to_radians(),
            },
            sigma_um: 0.01,
            sigma_deg: 0.001,
            inliers: 50,
            time_s,
        }
    }

    #[test]
    fn scatter_is_the_spread_of_confirming_frames() {
        assert_eq!(scatter_um(&[at(3.0, 4.0, 0.0, 0.0)]), 0.0);
        let two = scatter_um(&[at(0.3, 0.4, 0.0, 0.0), at(0.0, 0.0, 0.0, 0.0)]);
        assert!((two - 0.5 / 2f64.sqrt()).abs() < 1e-12, "{two}");
    }

    /// A slide that was put in end for end is half a turn off, and not none.
    #[test]
    fn the_mean_of_angles_of_either_sign_at_half_a_turn_is_half_a_turn() {
        for degs in [&[179.997, -179.996][..], &[-179.999, 179.998, -179.997]] {
            let frames: Vec<Measured> = degs.iter().map(|d| at(0.1, 0.0, *d, 0.0)).collect();
            let told = mean(&frames);
            assert!(180.0 - told.angle_deg().abs() < 0.003, "{degs:?}: {told:?}");
            assert!((told.t_um()[0] - 0.1).abs() < 1e-9);
        }
        let plain = mean(&[at(0.0, 0.0, 0.3, 0.0), at(0.0, 0.0, -0.1, 0.0)]);
        assert!((plain.angle_deg() - 0.1).abs() < 1e-9);
    }

    #[test]
    fn two_frames_in_a_row_that_pass_converge_on_their_mean() {
        let options = ServoOptions::default();
        let (test, mut state) = (criteria(&options), Convergence::default());
        assert_eq!(
            state.take(&test, at(30.0, 0.0, 0.1, 0.0), false),
            Standing::Outside
        );
        state.moving();
        assert_eq!(
            state.take(&test, at(0.2, 0.0, 0.0, 1.0), true),
            Standing::Inside
        );
        assert_eq!(
            state.take(&test, at(0.5, 0.0, 0.0, 1.5), false),
            Standing::Outside
        );
        state.moving();
        assert_eq!(
            state.take(&test, at(0.2, 0.0, 0.0, 2.0), true),
            Standing::Inside
        );
        let Standing::Ended(ServoEnd::Converged(result)) =
            state.take(&test, at(0.22, 0.0, 0.0, 2.5), true)
        else {
            panic!("not converged")
        };
        assert!((result.error.distance_um() - 0.21).abs() < 1e-9);
    }

    /// Its clock is another, and may be ahead of the one before.
    #[test]
    fn what_one_process_saw_confirms_nothing_of_another() {
        let options = ServoOptions::default();
        let test = criteria(&options);
        let mut state = Convergence::default();
        let inside = |state: &mut Convergence, time_s| {
            state.take(&test, at(0.2, 0.0, 0.0, time_s), true) == Standing::Inside
        };
        assert!(inside(&mut state, 40.0));
        state.go_on_after_a_kill();
        assert!(inside(&mut state, 300.0), "confirmed by what was before");
        assert!(!inside(&mut state, 300.5), "its own");
    }

    #[test]
    fn growth_the_iteration_limit_and_a_drift_end_a_loop() {
        let options = ServoOptions {
            max_iterations: 2,
            ..ServoOptions::default()
        };
        let test = criteria(&options);
        let begun = || {
            let mut state = Convergence::default();
            state.take(&test, at(10.0, 0.0, 0.1, 0.0), false);
            state.moving();
            state
        };
        let ended = |mut state: Convergence, now| state.take(&test, now, false);
        for far in [at(31.0, 0.0, 0.1, 1.0), at(1.0, 0.0, 0.6, 1.0)] {
            let end = ended(begun(), far);
            assert!(
                matches!(end, Standing::Ended(ServoEnd::Diverged(_))),
                "{end:?}"
            );
        }
        let mut late = begun();
        late.iteration = 1;
        let end = ended(late, at(9.0, 0.0, 0.1, 1.0));
        assert!(
            matches!(end, Standing::Ended(ServoEnd::IterationLimit(_))),
            "{end:?}"
        );
        let looks = |um_per_look: f64| {
            let mut drifting = Convergence::default();
            drifting.take(&test, at(0.0, 0.0, 0.0, 0.0), false);
            drifting.take(&test, at(um_per_look, 0.0, 0.0, 0.5), false);
            drifting.take(&test, at(2.0 * um_per_look, 0.0, 0.0, 1.0), false)
        };
        // Half the tolerance in a second is no drift.
        assert_eq!(looks(0.09), Standing::Outside);
        let end = looks(0.3);
        assert!(
            matches!(end, Standing::Ended(ServoEnd::Drifting { .. })),
            "{end:?}"
        );
    }

    #[test]
    fn frames_in_a_row_that_are_lost_end_a_loop() {
        let options = ServoOptions::default();
        let reason = NotFound::NoAgreement { matches: 7 };
        let mut state = Convergence::default();
        assert_eq!(state.lose(&options, 2, &reason), None);
        assert!(state.lose(&options, 3, &reason).is_some());
        state.iteration = 63;
        assert!(state.lose(&options, 1, &reason).is_some());
    }
}
