//! The last of a focus: the stage arrives at the peak, and a look there tells whether it did.
//!
//! Each arrival scatters, by more than a high aperture bears, and no stage says by how much: what it reports is where it was sent. So the
//! frame at the final height is held against the sharpest one that was seen near it. Where it is less sharp, the stage arrives again.

use super::peak::Peak;
use super::point::Point;
use super::search::Decision;
use super::state::{Focus, Step, depth_of_field_um};
use crate::ServoError;
use scopeservo_scope::Instrument;

/// How arrivals scatter as long as nothing else is known, in depths of field: who has an objective has a stage that is fit for it.
const USUAL: f64 = 0.1;
/// From here on the scatter counts, in depths of field: one look near the top cannot tell how sharp that is.
const SCATTERS: f64 = 0.08;
/// So often the stage arrives then, at least.
const LOOKS: u8 = 2;
/// An arrival is good enough within this share of the depth of field; each further one that is not makes that larger by this factor.
const CLOSE: f64 = 0.09;
const CLOSE_GROWS: f64 = 1.15;
/// So often the stage arrives, at most.
const ARRIVALS: u8 = 8;
/// Where the scatter does not count, an arrival is refused that is off by so many standard deviations.
const FOR_SURE: f64 = 4.0;
/// A peak at which no look is as sharp as this share of the sharpest is somewhere else: at the sharpest, where that is seen again.
const REACHED: f64 = 0.5;

impl Focus {
    /// How arrivals scatter as long as nothing else is known, um.
    pub(super) fn usual_um(&self) -> f64 {
        USUAL * depth_of_field_um(&self.objective)
    }

    /// Goes to the peak, and looks there.
    pub(super) fn arrive(
        &mut self,
        scope: &Instrument,
        peak: Peak,
        level: usize,
    ) -> Result<Decision, ServoError> {
        if !self.plan(scope, &[peak.z_um])? {
            return self.refuted(scope);
        }
        self.step = Step::Arrival {
            peak,
            level,
            count: 0,
        };
        Ok(Decision::Look)
    }

    /// After a look at the peak: is it as sharp as it should be?
    pub(super) fn arrived(
        &mut self,
        scope: &Instrument,
        peak: Peak,
        level: usize,
        count: u8,
    ) -> Result<Decision, ServoError> {
        let count = count + 1;
        let depth_um = depth_of_field_um(&self.objective);
        let curve = self.curve(level);
        let near = curve.within(peak.z_um, 2.0 * peak.width_um);
        let seen = self.last_um.and_then(|z| last_at(&near, z));
        let Some(seen) = seen else {
            return self.refuted(scope);
        };
        let top = near.iter().map(|p| p.value).fold(0.0, f64::max);
        let [off_um2, sigma_um2] = peak.off_um2(&seen, top);
        let scatters = peak.scatter_um > SCATTERS * depth_um;
        let close_um = CLOSE * CLOSE_GROWS.powi(i32::from(count) - 1) * depth_um;
        // A peak that is much narrower than the looks are apart is fitted badly.
        let sharpest_um = near.iter().max_by(|a, b| a.value.total_cmp(&b.value));
        let sharpest_um = sharpest_um.map_or(peak.z_um, |p| p.z_um);
        if seen.value < REACHED * top && count >= LOOKS && peak.z_um != sharpest_um {
            let z_um = sharpest_um;
            return self.arrive(scope, Peak { z_um, ..peak }, level);
        }
        let is_good = match scatters {
            true => count >= LOOKS && off_um2 <= close_um.powi(2),
            false => off_um2 <= close_um.powi(2) + FOR_SURE * sigma_um2,
        };
        if is_good || count >= ARRIVALS {
            if seen.value < REACHED * top {
                return self.refuted(scope);
            }
            let expected_um2 = peak.sigma_um.powi(2) + peak.scatter_um.powi(2);
            // What a single look tells is less than what the fit does where the scatter is small.
            let by_look = off_um2.max(0.0) + sigma_um2;
            return Ok(Decision::There(match is_good {
                true => expected_um2.min(by_look).sqrt(),
                false => expected_um2.max(by_look).sqrt(),
            }));
        }
        match self.plan(scope, &[peak.z_um])? {
            false => self.refuted(scope),
            true => {
                self.step = Step::Arrival { peak, level, count };
                Ok(Decision::Look)
            }
        }
    }
}

/// The last of some samples at a height.
fn last_at(points: &[Point], z_um: f64) -> Option<Point> {
    points.iter().rev().find(|p| p.z_um == z_um).copied()
}
