//! What counts as there: the method's own tolerance, what a user asked for, and what a stage can do.

use super::scatter::Spread;
use crate::{LimitedBy, PoseError, ServoEnd, ServoOptions, ServoResult};
use scopeservo_registration::Estimate;
use std::f64::consts::SQRT_2;

/// What the test goes by.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Criteria<'a> {
    pub(crate) options: &'a ServoOptions,
    /// Whether passing means arrival: the target's own objective is active.
    pub(crate) is_arrival: bool,
    /// Whether the view is to be turned: the stage can do that, as far as it takes.
    pub(crate) turns: bool,
    pub(crate) view_um_per_px: f64,
    pub(crate) target_um_per_px: f64,
    /// How arrivals of this stage scatter: the view's distance from its goal, root mean square, um, and its angle, standard deviation, deg. `None`
    /// where nothing but the tolerance counts.
    pub(crate) scatter: Option<[f64; 2]>,
    /// So many frames were as near as this stage can bring the view, or as was asked for, and not within the method's tolerance.
    pub(crate) nearly: usize,
}

/// After so many arrivals that were as good as the stage can make them, the next is good enough.
const NEARLY: usize = 3;
/// Where that is not what was asked for, chance has so many tries.
const TRIES: usize = 10;
/// What is known so many times worse than the tolerance asks for is no arrival, whatever the stage can do.
const KNOWN: f64 = 2.5;
/// What is within so many standard deviations is as good as it gets.
const NEARLY_SIGMAS: f64 = 2.0;

/// A stage that scatters more than so many times what is known of it, or than the tolerance, does not work as it is to.
const SCATTERS: f64 = 3.0;

/// How far off a view is, um and deg, and the standard deviations of one coordinate and of the angle.
#[derive(Debug, Clone, Copy)]
struct Off {
    by: [f64; 2],
    sigma: [f64; 2],
}

impl From<&ServoResult> for Off {
    fn from(result: &ServoResult) -> Self {
        Self {
            by: [result.error.distance_um(), result.error.angle_deg().abs()],
            sigma: [result.sigma_um / SQRT_2, result.sigma_deg],
        }
    }
}

impl Criteria<'_> {
    /// Within `position_px` pixels of the present view and, where the stage turns, within `angle_deg` times the ratio of view pixel
    /// to target pixel, and within what was asked for. With the target's own objective, where passing means arrival, the error must be
    /// inside by `sure_sigmas` standard deviations. Where a stage has not come so near in some arrivals, what was asked for is enough,
    /// and as near as the stage can where nothing was.
    pub(crate) fn passes(&self, error: &PoseError, estimate: &Estimate) -> bool {
        let off = self.off(error, estimate);
        self.is_within(&off) || self.nearly >= NEARLY && self.is_enough(&off)
    }

    /// Whether it is not within the method's tolerance, and as near as it can be, or as was asked for.
    pub(crate) fn only_nearly(&self, error: &PoseError, estimate: &Estimate) -> bool {
        let off = self.off(error, estimate);
        !self.is_within(&off) && (self.is_enough(&off) || self.is_nearly(&off))
    }

    /// The end of a loop whose stage has come as near as it can, and not as near as was asked for, time and again.
    pub(crate) fn falls_short(&self, result: &ServoResult) -> Option<ServoEnd> {
        let [stage_um, stage_deg] = self.scatter?;
        let off = Off::from(result);
        let short = self.nearly >= TRIES && self.is_nearly(&off) && !self.is_enough(&off);
        let last = ServoResult {
            limited_by: self.limited_by(result, |k| self.asked(k).unwrap_or(f64::INFINITY)),
            ..result.clone()
        };
        short.then_some(ServoEnd::OutsideTolerance {
            last,
            asked_um: self.options.within_um,
            asked_deg: self.options.within_deg,
            stage_um: NEARLY_SIGMAS * stage_um,
            stage_deg: NEARLY_SIGMAS * stage_deg,
        })
    }

    /// Whether a stage may scatter so much: about the goal, and not far more than is known of it.
    pub(crate) fn may_scatter(&self, spread: &Spread) -> bool {
        let most = |k: usize| {
            let known = self.scatter.map_or(0.0, |scatter| scatter[k]);
            SCATTERS * known.max(self.tolerance(k))
        };
        spread.is_about_the_goal([0, 1].map(|k| self.tolerance(k)), self.turns)
            && spread.um <= most(0)
            && (!self.turns || spread.deg <= most(1))
    }

    /// The end of a loop whose moves come no nearer.
    pub(crate) fn scattered(&self, spread: &Spread, last: &ServoResult) -> ServoEnd {
        match spread.is_about_the_goal([0, 1].map(|k| self.tolerance(k)), self.turns) {
            true => ServoEnd::OutsideTolerance {
                last: ServoResult {
                    limited_by: Some(LimitedBy::Repeatability),
                    ..last.clone()
                },
                asked_um: self.options.within_um,
                asked_deg: self.options.within_deg,
                stage_um: NEARLY_SIGMAS * spread.um,
                stage_deg: NEARLY_SIGMAS * spread.deg,
            },
            false => ServoEnd::IterationLimit(last.clone()),
        }
    }

    /// The same where moves were seen to come no nearer than this.
    pub(crate) fn scattering(self, spread: Option<&Spread>) -> Self {
        let Some((spread, known)) = spread.zip(self.scatter) else {
            return self;
        };
        Self {
            scatter: Some([known[0].max(spread.um), known[1].max(spread.deg)]),
            nearly: self.nearly.max(NEARLY),
            ..self
        }
    }

    /// What kept the view from coming nearer, where that is not surely within the method's tolerance.
    pub(crate) fn limit(&self, result: &ServoResult) -> Option<LimitedBy> {
        let limit = || self.limited_by(result, |k| self.tolerance(k));
        (self.nearly >= NEARLY).then(limit).flatten()
    }

    fn limited_by(
        &self,
        result: &ServoResult,
        tolerance: impl Fn(usize) -> f64,
    ) -> Option<LimitedBy> {
        let off = Off::from(result);
        let all = |sigmas: f64| {
            let within = |k: usize| off.by[k] + sigmas * off.sigma[k] <= tolerance(k);
            self.counting().all(within)
        };
        match all(0.0) {
            true if all(self.sure()) => None,
            true => Some(LimitedBy::Measurement),
            false => Some(LimitedBy::Repeatability),
        }
    }

    fn off(&self, error: &PoseError, estimate: &Estimate) -> Off {
        let sigma_um = estimate.sigma_px * self.target_um_per_px;
        Off {
            by: [error.distance_um(), error.angle_deg().abs()],
            sigma: [sigma_um, estimate.sigma_angle_rad.to_degrees()],
        }
    }

    /// What counts of place and angle.
    fn counting(&self) -> std::ops::Range<usize> {
        0..if self.turns { 2 } else { 1 }
    }

    /// Standard deviations by which it must be inside.
    fn sure(&self) -> f64 {
        match self.is_arrival {
            true => self.options.sure_sigmas,
            false => 0.0,
        }
    }

    /// The method's own tolerance, um or deg.
    pub(super) fn tolerance(&self, k: usize) -> f64 {
        let coarseness = (self.view_um_per_px / self.target_um_per_px).max(1.0);
        let own = [
            self.options.position_px * self.view_um_per_px,
            self.options.angle_deg * coarseness,
        ];
        own[k]
    }

    /// What was asked for.
    fn asked(&self, k: usize) -> Option<f64> {
        let asked = [self.options.within_um, self.options.within_deg];
        asked[k].filter(|_| self.is_arrival)
    }

    fn is_within(&self, off: &Off) -> bool {
        let within = |k: usize| {
            let tolerance = self.tolerance(k);
            let tolerance = self
                .asked(k)
                .map_or(tolerance, |asked| asked.min(tolerance));
            off.by[k] + self.sure() * off.sigma[k] <= tolerance
        };
        self.counting().all(within)
    }

    /// As near as was asked for, and where nothing was as near as it can be.
    fn is_enough(&self, off: &Off) -> bool {
        self.is_arrival
            && self.counting().all(|k| match self.asked(k) {
                Some(asked) => off.by[k] + self.sure() * off.sigma[k] <= asked,
                None => self.is_nearly_in(off, k),
            })
    }

    /// As near as this stage can bring the view and these images can tell.
    fn is_nearly(&self, off: &Off) -> bool {
        self.is_arrival && self.counting().all(|k| self.is_nearly_in(off, k))
    }

    fn is_nearly_in(&self, off: &Off, k: usize) -> bool {
        let Some(scatter) = self.scatter else {
            return false;
        };
        // That of the distance.
        let sigma = [SQRT_2, 1.0][k] * off.sigma[k];
        let tolerance = self.tolerance(k);
        self.options.sure_sigmas * sigma <= KNOWN * tolerance
            && off.by[k] <= (NEARLY_SIGMAS * f64::hypot(scatter[k], sigma)).max(tolerance)
    }

    pub(crate) fn diverged(&self, error: &PoseError, first: &PoseError) -> bool {
        let grown = |now: f64, first: f64, least: f64| {
            now.abs() > least && now.abs() > self.options.divergence_factor * first.abs()
        };
        let far = 10.0 * self.view_um_per_px * 1e-6;
        let distance_m = |e: &PoseError| e.distance_um() * 1e-6;
        grown(distance_m(error), distance_m(first), far)
            || self.turns && grown(error.angle_deg(), first.angle_deg(), 0.5)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn criteria(options: &ServoOptions) -> Criteria<'_> {
        Criteria {
            options,
            is_arrival: true,
            turns: true,
            view_um_per_px: 0.5,
            target_um_per_px: 0.5,
            scatter: None,
            nearly: 0,
        }
    }

    fn error(x_um: f64, angle_deg: f64) -> PoseError {
        PoseError {
            t_m: [x_um * 1e-6, 0.0],
            theta_rad: angle_deg.to_radians(),
        }
    }

    fn known_to(sigma_px: f64) -> Estimate {
        Estimate {
            sigma_px,
            ..Estimate::at_rest()
        }
    }

    #[test]
    fn passing_needs_both_limits_and_two_sigmas_where_it_means_arrival() {
        let options = ServoOptions::default();
        let mut test = criteria(&options);
        let inside = error(0.39, 0.009);
        assert!(test.passes(&inside, &known_to(0.0)));
        assert!(!test.passes(&inside, &known_to(0.02)), "not for sure");
        let turned = error(0.1, 0.011);
        assert!(!test.passes(&turned, &known_to(0.0)));
        test.turns = false;
        assert!(test.passes(&turned, &known_to(0.0)));
        test.is_arrival = false;
        assert!(test.passes(&inside, &known_to(0.02)), "on the way");
    }

    #[test]
    fn what_a_user_asks_for_is_kept_and_chance_has_some_tries() {
        let strict = ServoOptions {
            within_um: Some(0.2),
            ..ServoOptions::default()
        };
        let mut test = Criteria {
            scatter: Some([2.0, 0.001]),
            ..criteria(&strict)
        };
        let (here, near) = (known_to(0.01), error(0.3, 0.0));
        assert!(test.passes(&error(0.18, 0.0), &here) && !test.passes(&near, &here));
        // The stage cannot do better, and three times as near as it can is no arrival where more was asked for.
        test.nearly = 9;
        assert!(!test.passes(&near, &here) && test.only_nearly(&near, &here));
        let result = |error| ServoResult {
            iterations: 1,
            inliers: 50,
            error,
            sigma_um: 0.01,
            sigma_deg: 0.001,
            limited_by: None,
            angle_is_left: false,
        };
        assert_eq!(test.falls_short(&result(near)), None);
        test.nearly = 10;
        let Some(ServoEnd::OutsideTolerance { last, stage_um, .. }) =
            test.falls_short(&result(near))
        else {
            panic!("goes on for ever")
        };
        assert_eq!(
            (last.limited_by, stage_um),
            (Some(LimitedBy::Repeatability), 4.0)
        );
        assert_eq!(test.falls_short(&result(error(0.1, 0.0))), None);
        // Far beside what the stage can do is something else.
        assert_eq!(test.falls_short(&result(error(9.0, 0.0))), None);
    }

    #[test]
    fn less_than_the_method_asks_for_is_taken_where_a_user_said_so_and_nothing_nearer_came() {
        let loose = ServoOptions {
            within_um: Some(5.0),
            ..ServoOptions::default()
        };
        // A stage of which nobody knows how it scatters.
        let mut test = criteria(&loose);
        let here = known_to(0.01);
        let off = error(3.0, 0.005);
        assert!(
            !test.passes(&off, &here),
            "one more move may bring it nearer"
        );
        test.turns = false;
        assert!(test.only_nearly(&off, &here));
        test.nearly = 3;
        assert!(test.passes(&off, &here) && !test.passes(&error(5.1, 0.0), &here));
        test.is_arrival = false;
        assert!(
            !test.passes(&off, &here),
            "that is for the target's own objective"
        );
    }
}
