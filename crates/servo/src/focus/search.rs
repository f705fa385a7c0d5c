//! Which height to look at next.

use super::curve::Curve;
use super::peak::Peak;
use super::point::Point;
use super::state::{Focus, Step, depth_of_field_um, height};
use crate::ServoError;
use scopeservo_scope::{Axis, Instrument, ScopeError, StagePose};

/// So far the stage goes back before it comes from the side away from the specimen, um: farther than the backlash of usual drives.
pub(super) const TAKES_UP_UM: f64 = 10.0;
/// Steps towards a height that rises, and around a peak that is looked at closer, in widths of a level.
const CLIMB: f64 = 1.0;
pub(super) const CLOSER: f64 = 0.8;
/// Steps of the last pass, in widths of the finest level, and how many samples it has at first.
const FINE: f64 = 0.6;
const FINE_SAMPLES: i32 = 5;
/// So often the last pass is continued where the peak lies at its end.
const CONTINUED: u8 = 8;
/// And so often where it was expected.
const EXPECTED: u8 = 2;
/// A peak that a level shows is looked at again on one that is finer by so many.
pub(super) const FINER: usize = 2;
/// So often a level is looked at.
pub(super) const TIMES: u8 = 3;
/// Where nothing is seen at all, the heights come no closer together than so many in the range.
const MOST_HEIGHTS: f64 = 40.0;
/// A height is not looked at again where a sample lies nearer than this share of the step.
const SEEN: f64 = 0.3;
/// A peak known worse than to this share of the depth of field is looked at once more between the samples.
const KNOWN: f64 = 0.09;
/// About so far from a peak some image must have been taken, in widths of the finest level, and within these shares of that.
const FAR: f64 = 8.0;
const FAR_BETWEEN: [f64; 2] = [0.6, 1.4];
/// It is less sharp there by this factor at least, or what was found is no focus: the light's fall towards the border, or the steps of a
/// camera without noise, make tops that are much wider.
const FALLS: f64 = 1.25;
/// After so many peaks that were none there is nothing.
const REFUTED: usize = 5;
/// A fit that explains less than this of what it was made of is none.
const GOOD: f64 = 0.6;

pub(super) enum Decision {
    Look,
    Nothing,
    /// The focus, where the stage stands; with the standard deviation of that, um.
    There(f64),
}

impl Focus {
    /// Where the focus begins, and what it looks at first.
    pub(super) fn begin(&mut self, scope: &Instrument) -> Result<(), ServoError> {
        let here = scope.gate().position()?;
        // A stage that stands outside is told so, and not that it sees no focus.
        scope.gate().check(&here)?;
        let z = here.z.ok_or(ScopeError::NoSuchAxis { axis: Axis::Z })?.um();
        self.start_um = Some(z);
        let coarsest = self.levels() - 1;
        self.spaced_by = coarsest;
        self.outwards_um = self.rings(scope, z)?;
        if self.outwards_um.is_empty() {
            return Ok(());
        }
        let known = scope
            .focus_positions()
            .get(&self.objective.id)
            .map(|z| z.um());
        let known = if self.here { Some(z) } else { known };
        let near = self.width_um(coarsest.min(FINER));
        let predicted = scope.predicted_focus(&self.objective.id).map(|z| z.um());
        let within = |z_um: &f64| (z_um - z).abs() <= self.options.half_range_um;
        let expected = match known {
            Some(known) => Some(known).filter(|known| (known - z).abs() <= near),
            None => predicted.filter(within),
        };
        if let Some(expected) = expected {
            self.fine(scope, expected, true)?;
        }
        // Where nothing is expected, or it lies beyond the bounds.
        if self.plan_um.is_empty() {
            self.step = Step::Outwards;
            self.look_farther();
        }
        Ok(())
    }

    /// Heights from the start outwards, one width of a level apart, the safe side first; none near to where it was looked already.
    fn rings(&self, scope: &Instrument, start_um: f64) -> Result<Vec<f64>, ServoError> {
        let half = self.options.half_range_um;
        let step = self.width_um(self.spaced_by).min(half);
        let away = scope.gate().info().positive_z.away(0.0, 1.0);
        let mut all = vec![start_um];
        for k in 1..=(half / step).ceil() as i32 {
            let way = (f64::from(k) * step).min(half);
            let nearer = way.min(self.options.nearest_um);
            all.extend([start_um + away * way, start_um - away * nearer]);
        }
        // Towards the specimen all that go past the bound end at it.
        let mut each: Vec<f64> = Vec::new();
        all.retain(|z| {
            let new = !each.contains(z);
            each.push(*z);
            new
        });
        let seen = |z: f64| {
            self.samples
                .iter()
                .any(|s| (s.z_um - z).abs() < SEEN * step)
        };
        all.retain(|&z| !seen(z));
        self.allowed(scope, &all)
    }

    /// Those of some heights that the stage may go to, and that are not beyond the bound.
    fn allowed(&self, scope: &Instrument, heights: &[f64]) -> Result<Vec<f64>, ServoError> {
        let start = self.start_um.unwrap_or(f64::NAN);
        let nearer = |z: f64| scope.gate().info().positive_z.nearer_by(z, start);
        let bound = self.options.nearest_um + 1e-6;
        let within: Vec<f64> = heights
            .iter()
            .copied()
            .filter(|&z| nearer(z) <= bound)
            .collect();
        let places: Vec<StagePose> = within.iter().map(|&z| height(z)).collect();
        let allowed = scope.gate().allowed(&places)?;
        let both = within.into_iter().zip(allowed);
        Ok(both
            .filter_map(|(z, allowed)| allowed.then_some(z))
            .collect())
    }

    /// Plans the samples of a pass, in order from the side away from the specimen. Returns whether all of them are allowed.
    pub(super) fn plan(&mut self, scope: &Instrument, heights: &[f64]) -> Result<bool, ServoError> {
        let mut plan = self.allowed(scope, heights)?;
        let side = scope.gate().info().positive_z;
        plan.sort_by(|a, b| side.nearer_by(*a, 0.0).total_cmp(&side.nearer_by(*b, 0.0)));
        let all = plan.len() == heights.len();
        self.plan_um = plan;
        Ok(all)
    }

    /// Decides on what was seen so far.
    pub(super) fn decide(&mut self, scope: &Instrument) -> Result<Decision, ServoError> {
        match self.step {
            Step::Outwards => self.outwards(scope),
            Step::Swept { level, times } => self.after_sweep(scope, level, times),
            Step::Closer { level, times } => self.closer(scope, level, times),
            Step::Fine {
                continued,
                expected,
            } => self.ended(scope, continued, expected),
            Step::Arrival { peak, level, count } => self.arrived(scope, peak, level, count),
        }
    }

    /// Looks for a level that shows a peak, or which way is up.
    pub(super) fn outwards(&mut self, scope: &Instrument) -> Result<Decision, ServoError> {
        let contrast = self.contrast();
        let curves: Vec<Curve> = (0..self.levels()).map(|level| self.curve(level)).collect();
        let refuted = |z: f64| self.refuted_um.iter().any(|[a, b]| (*a..=*b).contains(&z));
        let peak = |(level, curve): (usize, &Curve)| {
            let best = curve.bracketed(contrast)?;
            (!refuted(curve.0[best].z_um)).then_some((level, best))
        };
        // The coarsest level sees farthest between the samples.
        if let Some((level, best)) = curves.iter().enumerate().rev().find_map(peak) {
            return self.approach(scope, level, &curves[level], best, 0);
        }
        let rise = |(level, curve): (usize, &Curve)| Some((level, curve.rises_at(contrast)?));
        // The coarsest level that tells makes the longest step.
        if let Some((level, way)) = curves.iter().enumerate().rev().find_map(rise) {
            let points = &curves[level].0;
            let end = if way < 0.0 {
                points[0]
            } else {
                points[points.len() - 1]
            };
            let next = end.z_um + way * CLIMB * self.width_um(level);
            if self.within_range(next) && self.plan(scope, &[next])? {
                self.outwards_um
                    .retain(|z| (z - next) * way > 0.0 || (z - end.z_um) * way < 0.0);
                return Ok(Decision::Look);
            }
            // It rises towards where the stage may not go; elsewhere there may be more.
        }
        // A weak stain shows nothing as far away as a coarse level sees: closer together then.
        while self.outwards_um.is_empty() {
            let finer = self.spaced_by.saturating_sub(1);
            let heights = 2.0 * self.options.half_range_um / self.width_um(finer);
            let worth = finer >= FINER && heights <= MOST_HEIGHTS;
            let Some(start) = self.start_um.filter(|_| worth) else {
                return Ok(Decision::Nothing);
            };
            self.spaced_by = finer;
            self.outwards_um = self.rings(scope, start)?;
        }
        self.look_farther();
        Ok(Decision::Look)
    }

    fn within_range(&self, z_um: f64) -> bool {
        let way = self.start_um.map_or(0.0, |start| (z_um - start).abs());
        way <= self.options.half_range_um + 1e-6
    }

    /// A level shows a peak: looks closer, or makes the last pass.
    fn approach(
        &mut self,
        scope: &Instrument,
        level: usize,
        curve: &Curve,
        best: usize,
        times: u8,
    ) -> Result<Decision, ServoError> {
        let top = curve.rough_top(best, self.usual_um());
        let is_close = curve.gap(best) <= 1.6 * self.width_um(level);
        if level <= FINER && (is_close || times >= TIMES) {
            self.fine(scope, top, false)?;
            return Ok(Decision::Look);
        }
        // A peak between samples that are too far apart for its level is looked at on that level first.
        let (finer, times) = match is_close || times >= TIMES {
            true => (level.saturating_sub(FINER), 0),
            false => (level, times + 1),
        };
        let step = CLOSER * self.width_um(finer);
        let heights: Vec<f64> = [-1.0, 0.0, 1.0]
            .iter()
            .map(|k| top + k * step)
            .filter(|z| self.samples.iter().all(|s| (s.z_um - z).abs() > 0.3 * step))
            .collect();
        self.plan(scope, &heights)?;
        self.step = Step::Closer {
            level: finer,
            times,
        };
        Ok(match self.plan_um.is_empty() {
            true => self.closer(scope, finer, times)?,
            false => Decision::Look,
        })
    }

    /// After a closer look.
    pub(super) fn closer(
        &mut self,
        scope: &Instrument,
        level: usize,
        times: u8,
    ) -> Result<Decision, ServoError> {
        let curve = self.curve(level);
        let Some(best) = curve.bracketed(self.contrast()) else {
            // The finer level shows nothing: what the coarser one says is all there is.
            let coarser = self.curve(level + FINER);
            let top = coarser
                .best()
                .map(|best| coarser.rough_top(best, self.usual_um()));
            self.fine(scope, top.unwrap_or(f64::NAN), false)?;
            return Ok(Decision::Look);
        };
        let step = CLOSER * self.width_um(level);
        let gap = |side: f64| {
            let z = curve.0[best].z_um;
            let beside = curve.0.iter().filter(|p| (p.z_um - z) * side > 0.0);
            let nearest = beside
                .map(|p| (p.z_um - z).abs())
                .fold(f64::INFINITY, f64::min);
            (nearest > 1.6 * step).then_some(z + side * step)
        };
        let open: Vec<f64> = [-1.0, 1.0].into_iter().filter_map(gap).collect();
        if !open.is_empty() && times < TIMES && self.plan(scope, &open)? {
            let times = times + 1;
            self.step = Step::Closer { level, times };
            return Ok(Decision::Look);
        }
        self.approach(scope, level, &curve, best, times)
    }

    /// The last pass, around a height.
    pub(super) fn fine(
        &mut self,
        scope: &Instrument,
        top: f64,
        expected: bool,
    ) -> Result<(), ServoError> {
        let step = FINE * self.width_um(0);
        // Where it is expected, the looks of the arrival come on top.
        let samples = FINE_SAMPLES - i32::from(expected);
        let middle = 0.5 * f64::from(samples - 1);
        let heights: Vec<f64> = (0..samples)
            .map(|k| top + (f64::from(k) - middle) * step)
            .collect();
        self.fine_um.clear();
        self.plan(scope, &heights)?;
        // A look from where the specimen is blurred tells it from what is written onto the image.
        if self.far_from(top, 0).is_empty() {
            let far = FAR * self.width_um(0);
            let away = scope.gate().info().positive_z.away(0.0, 1.0);
            for side in [away, -away] {
                if let Some(&z) = self.allowed(scope, &[top + side * far])?.first() {
                    self.plan_um.insert(0, z);
                    self.far_first = true;
                    break;
                }
            }
        }
        self.step = Step::Fine {
            continued: 0,
            expected,
        };
        Ok(())
    }

    /// After the last pass: the peak, or more samples on the side where it seems to lie.
    fn ended(
        &mut self,
        scope: &Instrument,
        continued: u8,
        expected: bool,
    ) -> Result<Decision, ServoError> {
        let seen = (0..self.levels().min(FINER + 1)).find_map(|level| {
            let curve = self.curve(level);
            let best = curve.stands_out(self.contrast())?;
            Some((level, best, curve))
        });
        let Some((level, best, curve)) = seen else {
            return self.refuted(scope);
        };
        let top = curve.0[best].z_um;
        let (least, most) = self
            .fine_um
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), z| {
                (a.min(*z), b.max(*z))
            });
        let step = FINE * self.width_um(0);
        // Two samples on either side of the sharpest: a peak that is seen from one side only is known badly. Where it was expected, and
        // lies surely between the samples, one is enough.
        let is_between = curve.bracketed(self.contrast()).is_some();
        let wanted = if expected && continued == 0 && is_between {
            1
        } else {
            2
        };
        let reach = 2.0 * FINE * self.width_um(level) + 1e-3;
        let near: Vec<Point> = curve.within(top, reach);
        let [below, above] = [-1.0, 1.0].map(|side| {
            let beside = |p: &&Point| (p.z_um - top) * side > 0.1 * step;
            near.iter().filter(beside).count()
        });
        let missing = |seen: usize, side: f64, end: f64| {
            (1..=usize::saturating_sub(wanted, seen))
                .map(|k| end + side * k as f64 * step)
                .collect::<Vec<f64>>()
        };
        let beyond = [missing(below, -1.0, least), missing(above, 1.0, most)].concat();
        if !beyond.is_empty() {
            if expected && continued >= EXPECTED {
                // It lies elsewhere than it was.
                self.step = Step::Outwards;
                return self.outwards(scope);
            }
            // Where the stage may not go farther, what there is must do.
            self.plan(scope, &beyond)?;
            if continued < CONTINUED && !self.plan_um.is_empty() {
                self.step = Step::Fine {
                    continued: continued + 1,
                    expected,
                };
                return Ok(Decision::Look);
            }
        }
        let falls = self.falls(level, &curve.0[best]);
        if !is_between || below == 0 || above == 0 || !falls {
            return self.refuted(scope);
        }
        let ends = [top - reach, top + reach];
        let peak = Peak::of(&near, self.usual_um())
            .filter(|p| p.goodness >= GOOD && (ends[0]..=ends[1]).contains(&p.z_um));
        match peak {
            None => self.refuted(scope),
            Some(peak) if !self.is_known(&peak) && !self.looked_again => {
                self.looked_again = true;
                let half = FINE_SAMPLES / 2;
                let between = (-half..half).map(|k| (f64::from(k) + 0.5) * step);
                let heights: Vec<f64> = between.map(|off| peak.z_um + off).collect();
                self.plan(scope, &heights)?;
                match self.plan_um.is_empty() {
                    true => self.arrive(scope, peak, level),
                    false => Ok(Decision::Look),
                }
            }
            Some(peak) => self.arrive(scope, peak, level),
        }
    }

    /// The samples of a level that are about as far from a height as a specimen is blurred for sure.
    fn far_from(&self, z_um: f64, level: usize) -> Vec<Point> {
        let far = FAR * self.width_um(0);
        let [least, most] = FAR_BETWEEN.map(|share| share * far);
        let mut near = self.curve(level).within(z_um, most);
        near.retain(|p| (p.z_um - z_um).abs() >= least);
        near
    }

    /// Whether the sharpest of a level is as narrow as a focus. Where the stage may not go to see it, it is believed.
    fn falls(&self, level: usize, top: &Point) -> bool {
        let order = self.options.measure.measure().order();
        let mut far = self.far_from(top.z_um, level);
        if far.is_empty() {
            // The top moved while it was looked at: what lies farther away tells as well.
            let least = FAR_BETWEEN[0] * FAR * self.width_um(0);
            far = self.curve(level).0;
            far.retain(|p| (p.z_um - top.z_um).abs() >= least);
        }
        let least = far
            .iter()
            .map(|p| p.value.max(p.sigma))
            .fold(f64::INFINITY, f64::min);
        far.is_empty() || top.value > FALLS.powi(order) * least
    }

    fn is_known(&self, peak: &Peak) -> bool {
        peak.sigma_um <= KNOWN * depth_of_field_um(&self.objective)
    }

    /// The last pass showed no peak: what led there was none, and the search goes on elsewhere.
    pub(super) fn refuted(&mut self, scope: &Instrument) -> Result<Decision, ServoError> {
        let of = |f: fn(f64, f64) -> f64, none: f64| self.fine_um.iter().copied().fold(none, f);
        let about = 2.0 * self.width_um(0);
        let range = [
            of(f64::min, f64::INFINITY) - about,
            of(f64::max, f64::NEG_INFINITY) + about,
        ];
        self.refuted_um.push(range);
        if self.refuted_um.len() > REFUTED {
            return Ok(Decision::Nothing);
        }
        self.step = Step::Outwards;
        self.outwards(scope)
    }
}
