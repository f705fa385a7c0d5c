//! Where a target lies in a view, without features: band-passed images of equal local contrast, correlated over all places and over the
//! angles that are expected, at the scale that is known.
//!
//! The correlation proposes and blocks judge. Its highest peaks are looked at block by block: each block of the target
//! looks for itself around where a peak puts it, and what the blocks agree on is found, uncertain or chance by the same test as matches of features
//! ([`register_correspondences`]), with the same covariance. Then finer levels, and the finest that says more is the answer. What hides a part of
//! the view hides blocks, no more.
//!
//! [`register_correspondences`]: crate::register_correspondences

mod alike;
mod blocks;
mod matched;
mod plane;
mod search;

use crate::corners::centre;
use crate::{
    Correspondences, NotFound, Options, Prior, Registration, Rival, RotationPrior, ScalePrior,
    register_correspondences, shifted,
};
use matched::Matched;
use plane::Plane;
use rayon::prelude::*;
use scopeservo_geometry::{Affine2, Vec2};
use search::Peak;

pub use alike::look_alikes;
pub use plane::{Counts, Picture};

/// The longer side of a target that is searched for, samples at most;
const TARGET_SAMPLES: f64 = 120.0;
/// and that of the view.
const VIEW_SAMPLES: f64 = 400.0;
/// How far around its place each block looks: first, and when the place is known better, samples.
const REACH: [usize; 2] = [6, 3];
/// A block agrees when it lands this near, samples.
const AGREES: f64 = 2.5;
/// Larger planes than this are not made: the finest level of a large camera.
const MOST_SAMPLES: usize = 1_600_000;
/// Expected number of agreements as good between unrelated images, at most, as blocks count it: log10. Blocks of one peak are not
/// independent, as they are what made it a peak; what unrelated images reach is measured (docs/measured.md).
const LOG10_CHANCE: f64 = -18.0;
/// What is looked at more finely, and so many of these at most.
const LOG10_PROPOSED: f64 = -0.5;
const PROPOSED: usize = 3;
/// and what is another place.
const LOG10_RIVAL: f64 = -6.0;
/// A peak that is lower than this share of one that is sure is no rival.
const FAR_LOWER: f32 = 0.6;
/// Another peak is as high when it is at least this, and this share of the first: ordinary specimens are like themselves elsewhere to 0.44 at most.
const AS_HIGH: [f32; 2] = [0.45, 0.75];
/// Another place is as good when its agreement is by this share as improbable.
const AS_GOOD: f64 = 0.5;
/// Turned by more than this it is another place, radians; or shifted by so many samples.
const ELSEWHERE_RAD: f64 = 0.2;
const ELSEWHERE: f64 = 4.0;
/// What a correlation says.
#[derive(Debug, Clone, PartialEq)]
pub struct Correlation {
    /// The transform, or why there is none. Its inliers are blocks.
    pub registration: Registration,
    /// The blocks, as places of view and target that look alike.
    pub correspondences: Correspondences,
    /// Other places that look like the target, too: with any of them it is ambiguous.
    pub rivals: Vec<Rival>,
    /// The highest peak, and the highest of those elsewhere; 1 for what is the same.
    pub peaks: [f32; 2],
    /// Where the target may lie by its peaks alone, the most likely first.
    pub perhaps: Vec<Perhaps>,
}

/// Where a target may lie in a view that does not say so for sure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Perhaps {
    /// The transform, to some pixels of the view and some degrees.
    pub target_from_view: Affine2,
    /// How like the target it is: 1 for what is the same.
    pub height: f32,
}

/// Looks for a target, of which [`periods`](crate::periods) tells how it repeats itself, in a view at a known scale.
///
/// Cost at 640 x 480 pixels, two cores: see docs/measured.md.
pub fn correlate(
    view: &Picture<'_>,
    (target, periods_px): (&Picture<'_>, &[Vec2]),
    scale: ScalePrior,
    rotation: Option<RotationPrior>,
    options: &Options,
) -> Correlation {
    let levels = Levels::of(view, target, scale.ratio);
    let prior = Prior {
        scale: Some(scale),
        rotation,
        ..Prior::default()
    };
    let mut run = Run {
        view,
        target,
        periods_px,
        levels: &levels,
        planes: Vec::new(),
        prior: &prior,
        options,
        perhaps: Vec::new(),
    };
    let mut seen = run.answer().unwrap_or_else(|reason| Correlation {
        registration: Registration::not_found(reason, 0),
        correspondences: nothing(view),
        rivals: Vec::new(),
        peaks: [0.0; 2],
        perhaps: Vec::new(),
    });
    seen.perhaps = run.perhaps;
    seen
}

fn nothing(view: &Picture<'_>) -> Correspondences {
    Correspondences {
        view_size: size(view),
        target_area: 0.0,
        indices: Vec::new(),
        pairs: Vec::new(),
        shapes: Vec::new(),
    }
}

fn size(picture: &Picture<'_>) -> [usize; 2] {
    [picture.image.width(), picture.image.height()]
}

/// The most improbable agreement first; of equals the higher peak stays first.
fn sort(all: &mut [(Peak, Agreed)]) {
    all.sort_by(|a, b| a.1.log10_nfa.total_cmp(&b.1.log10_nfa));
}

/// View pixels that make a sample, from where the search is to the finest.
struct Levels {
    every: Vec<usize>,
    search: usize,
    finest: usize,
}

impl Levels {
    fn of(view: &Picture<'_>, target: &Picture<'_>, ratio: f64) -> Self {
        let [w, h] = size(view);
        let longer = |s: [usize; 2]| s[0].max(s[1]) as f64;
        // No finer than the coarser image is.
        let mut finest = (1.0 / ratio - 1e-6).ceil().max(1.0) as usize;
        while w * h / (finest * finest) > MOST_SAMPLES {
            finest += 1;
        }
        let fits = |every: usize| {
            longer(size(target)) / ratio / every as f64 <= TARGET_SAMPLES
                && w.max(h) as f64 / every as f64 <= VIEW_SAMPLES
        };
        let mut levels = vec![finest];
        while levels.last().is_some_and(|&every| !fits(every)) {
            levels.extend(levels.last().map(|every| 2 * every));
        }
        let search = levels.last().copied().unwrap_or(finest);
        levels.reverse();
        Self {
            every: levels,
            search,
            finest,
        }
    }
}

/// An agreement of blocks.
struct Agreed {
    registration: Registration,
    correspondences: Correspondences,
    /// How improbable it is, at the level that says most.
    log10_nfa: f64,
}

struct Run<'a> {
    view: &'a Picture<'a>,
    target: &'a Picture<'a>,
    periods_px: &'a [Vec2],
    levels: &'a Levels,
    /// View and target at the levels that were needed so far.
    planes: Vec<Option<(Plane, Plane)>>,
    prior: &'a Prior,
    options: &'a Options,
    /// The peaks of the correlation, the highest first.
    perhaps: Vec<Perhaps>,
}

impl Run<'_> {
    fn answer(&mut self) -> Result<Correlation, NotFound> {
        let blank = NotFound::NoAgreement { matches: 0 };
        self.make(1);
        let matched = self.at(0).ok_or_else(|| blank.clone())?;
        let angles = search::angles(&matched, self.prior.rotation);
        let peaks = search::peaks(&matched, &angles);
        let perhaps = peaks.iter().map(|peak| Perhaps {
            target_from_view: peak.target_from_view(&matched),
            height: peak.height,
        });
        self.perhaps = perhaps.collect();
        let matched = self.at(0).ok_or_else(|| blank.clone())?;
        let mut proposed = self.proposed(&matched, &peaks);
        // Of what is sparse the coarse blocks are few.
        let poor = proposed
            .first()
            .is_none_or(|(_, a)| a.log10_nfa > LOG10_CHANCE);
        self.make(if poor { 2 } else { 1 });
        if let Some(closer) = self.at(1).filter(|_| poor) {
            proposed.extend(self.proposed(&closer, &peaks[..peaks.len().min(PROPOSED)]));
        }
        sort(&mut proposed);
        proposed.truncate(PROPOSED);
        let least = proposed.first().map_or(0.0, |(_, a)| AS_GOOD * a.log10_nfa);
        proposed.retain(|(_, a)| a.log10_nfa <= least.max(LOG10_RIVAL));
        if !proposed.is_empty() {
            self.make(usize::MAX);
        }
        let mut refined: Vec<(Peak, Agreed)> = proposed
            .into_par_iter()
            .map(|(peak, agreed)| (peak, self.finer(agreed)))
            .collect();
        sort(&mut refined);
        let mut refined = refined.into_iter();
        let (peak, best) = refined.next().ok_or_else(|| blank.clone())?;
        let mut rivals = self.rivals(&best, refined.as_slice());
        // What repeats itself has other peaks that are as high, wherever its blocks land.
        let matched = self.at(0).ok_or(blank)?;
        let elsewhere: Vec<(Affine2, f32)> = peaks
            .iter()
            .map(|p| (p.target_from_view(&matched), p.height))
            .filter(|(t, _)| self.elsewhere(&best, t))
            .collect();
        let second = elsewhere.iter().map(|p| p.1).fold(0.0, f32::max);
        if rivals.is_empty() && second >= AS_HIGH[0].max(AS_HIGH[1] * peak.height) {
            let as_high = elsewhere.iter().filter(|p| p.1 == second);
            rivals.extend(as_high.filter_map(|(t, _)| self.rival(&best, t, 0)));
        }
        // Of a fine lattice all peaks are low, and blocks far from their place find another site each: its own periods tell.
        if let (true, Some(found)) = (rivals.is_empty(), best.registration.found()) {
            let all = shifted(found, self.periods_px).into_iter();
            rivals.extend(all.map(|rival| Rival {
                significant: true,
                ..rival
            }));
        }
        Ok(self.told(best, rivals, [peak.height, second]))
    }

    /// What the blocks around each peak agree on. Where the first ones do, far lower ones are not looked at.
    fn proposed(&self, matched: &Matched<'_>, peaks: &[Peak]) -> Vec<(Peak, Agreed)> {
        let look = |peak: &Peak| {
            let rough = peak.target_from_view(&self.at(0)?);
            Some((*peak, self.agreed(matched, &rough, REACH[0])?))
        };
        let (first, others) = peaks.split_at(peaks.len().min(2));
        let mut all: Vec<(Peak, Agreed)> = first.par_iter().filter_map(look).collect();
        let sure = all.iter().filter(|(_, a)| a.log10_nfa <= LOG10_CHANCE);
        let least = FAR_LOWER * sure.map(|(p, _)| p.height).fold(0.0, f32::max);
        let others = others.par_iter().filter(|p| p.height >= least);
        all.par_extend(others.filter_map(look));
        sort(&mut all);
        all
    }

    /// Those that say as much of another place.
    fn rivals(&self, best: &Agreed, others: &[(Peak, Agreed)]) -> Vec<Rival> {
        let as_good = (AS_GOOD * best.log10_nfa).min(LOG10_RIVAL);
        let others = others.iter().map(|(_, other)| other);
        let others = others.filter(|other| other.log10_nfa <= as_good);
        let rival = |other: &Agreed| {
            let t = &other.registration.found()?.target_from_view;
            let rival = self.rival(best, t, other.registration.inliers)?;
            self.elsewhere(best, t).then_some(rival)
        };
        others.filter_map(rival).collect()
    }

    /// Whether a transform puts the view at another place, or turns it.
    fn elsewhere(&self, best: &Agreed, other: &Affine2) -> bool {
        let sample_px = self.prior.scale.map_or(1.0, |s| s.ratio) * self.levels.search as f64;
        self.rival(best, other, 0).is_some_and(|rival| {
            let shift = f64::hypot(rival.shift_px[0], rival.shift_px[1]);
            shift > ELSEWHERE * sample_px || rival.turn_rad.abs() > ELSEWHERE_RAD
        })
    }

    /// Makes so many levels, counted from where the search is, if there are.
    fn make(&mut self, levels: usize) {
        let Some(scale) = self.prior.scale else {
            return;
        };
        let made = self.planes.len();
        for &every in self.levels.every.iter().take(levels).skip(made) {
            // What the view's sample covers, or a little less.
            let of_target = ((scale.ratio * every as f64 + 1e-6) as usize).max(1);
            let view = Plane::of(self.view, every);
            self.planes
                .push(view.zip(Plane::of(self.target, of_target)));
        }
    }

    /// View and target at a level that was made.
    fn at(&self, level: usize) -> Option<Matched<'_>> {
        let (view, target) = self.planes.get(level)?.as_ref()?;
        Some(Matched {
            view,
            target,
            view_size: size(self.view),
            target_size: size(self.target),
            ratio: self.prior.scale?.ratio,
        })
    }

    /// What the blocks around a transform agree on.
    fn agreed(&self, matched: &Matched<'_>, rough: &Affine2, reach: usize) -> Option<Agreed> {
        let correspondences = blocks::correspondences(matched, rough, self.levels.finest, reach)?;
        let sample_px = matched.ratio * matched.view.every as f64;
        let options = Options {
            // In pixels of the coarser image.
            threshold_px: AGREES * sample_px / matched.ratio.max(1.0),
            false_alarms: 10.0f64.powf(LOG10_PROPOSED),
            ..*self.options
        };
        // All blocks turn as they were turned to be compared: that they agree in it says nothing.
        let prior = Prior {
            rotation: Some(RotationPrior {
                angle_rad: rough.linear.rotation_angle()?,
                tolerance_rad: ELSEWHERE_RAD,
            }),
            ..*self.prior
        };
        let registration = register_correspondences(&correspondences, &prior, &options);
        Some(Agreed {
            log10_nfa: registration.log10_nfa.unwrap_or(f64::INFINITY),
            registration,
            correspondences,
        })
    }

    /// The same at finer levels, as far as they say more.
    fn finer(&self, mut best: Agreed) -> Agreed {
        let last = self.levels.every.len() - 1;
        for level in last.min(1)..=last {
            let (Some(matched), Some(found)) = (self.at(level), best.registration.found()) else {
                return best;
            };
            let was = found.sigma_px;
            let from = found.target_from_view;
            let mut again = self.agreed(&matched, &from, REACH[1]);
            if level == last
                && let Some(found) = again.as_ref().and_then(|a| a.registration.found())
            {
                // Blocks that are put where they belong are not drawn to whole samples.
                let rough = found.target_from_view;
                again = self.agreed(&matched, &rough, REACH[1]).or(again);
            }
            let sigma_px = |a: &Agreed| a.registration.found().map(|e| e.sigma_px);
            let more = |a: &Agreed| sigma_px(a).is_some_and(|is| last == 0 || is < was);
            let Some(better) = again.filter(more) else {
                return best;
            };
            best = Agreed {
                log10_nfa: better.log10_nfa.min(best.log10_nfa),
                ..better
            };
        }
        best
    }

    /// As seen from the target's centre: there it is told how far both are apart.
    fn rival(&self, best: &Agreed, other: &Affine2, places: usize) -> Option<Rival> {
        let first = &best.registration.found()?.target_from_view;
        let middle = first.inverse()?.apply(centre(size(self.target)));
        let counts = [places, best.registration.inliers];
        let rival = Rival::beside(first, other, middle, counts)?;
        Some(Rival {
            significant: true,
            ..rival
        })
    }

    fn told(&self, best: Agreed, rivals: Vec<Rival>, peaks: [f32; 2]) -> Correlation {
        let mut registration = best.registration;
        if best.log10_nfa.is_finite() {
            registration.log10_nfa = Some(best.log10_nfa);
        }
        if registration.outcome.is_ok() && best.log10_nfa > LOG10_CHANCE {
            registration.outcome = Err(NotFound::ByChance {
                inliers: registration.inliers,
                matches: registration.matches,
                log10_nfa: registration.log10_nfa,
            });
        }
        if let Ok(estimate) = &registration.outcome
            && !self.prior.allows(&estimate.target_from_view)
        {
            let matches = registration.matches;
            registration.outcome = Err(NotFound::NoAgreement { matches });
        }
        Correlation {
            registration,
            correspondences: best.correspondences,
            rivals,
            peaks,
            perhaps: Vec::new(),
        }
    }
}
