//! A better transform from the pixels, or the reason why there is none.

use super::Pictures;
use super::blocks::{Block, spread, structured};
use super::fit::{Look, Template, UNKNOWNS};
use super::matched::{Matched, Softer};
use super::tone::Tone;
use crate::Estimate;
use scopeservo_geometry::{
    Affine2, AffineFit, Mat2, Normal, Vec2, changes_without, covariance_of_deviations,
};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Side of the blocks, pixels of the coarser image: sharp images, and those that are softer than [`SOFT_PX`].
const SIDE: [usize; 2] = [24, 36];
const SOFT_PX: f64 = 1.5;
/// Where there are fewer blocks than this smaller ones are taken: these parts of the side.
const FEW_BLOCKS: usize = 16;
const SMALLER: [usize; 2] = [1, 2];
/// Fewer blocks than this leave the covariance open.
const LEAST_BLOCKS: usize = 6;
/// Images that correlate at least so well are equally sharp.
const ALIKE: f64 = 0.93;
/// How much softer one image may be made to be like the other, pixels, and what that must gain.
const SOFTER_PX: [f64; 3] = [1.0, 2.0, 4.0];
const SOFTER_GAINS: f64 = 0.01;
/// A start that is worse known than this, pixels, is refined in softer images first; the softest.
const ROUGH_PX: f64 = 0.5;
const SOFTEST_PX: f64 = 5.0;
/// A tone curve must lessen the residuals by this share.
const TONE_GAINS: f32 = 0.03;
/// Steps, at most, and when they end: pixels.
const STEPS: usize = 12;
const CLOSE_PX: f64 = 0.001;
/// or, within this, by what noise leaves open: in the first half of the steps and after.
const NEAR_PX: f64 = 0.02;
const CLOSE_SIGMAS: [f64; 2] = [0.1, 0.5];
/// How far a refinement may lead from its start: so many of the start's standard deviations, and so many pixels besides.
const SIGMAS: f64 = 5.0;
const BESIDES_PX: f64 = 0.5;
/// The least share of the structure that must follow,
const LEAST_SHARE: f64 = 0.25;
/// and correlate no worse than before, but for this.
const NO_WORSE: f64 = 0.002;
/// What no block shows, for all share it, pixels: how the images were sampled. Less than was ever measured.
const SYSTEMATIC_PX: f64 = 0.001;

/// A transform that the pixels agree on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Refined {
    /// With the covariance of leaving out each block in turn.
    pub estimate: Estimate,
    /// Blocks that it stands on.
    pub blocks: usize,
    /// Steps that it took.
    pub steps: usize,
    /// How well all blocks correlate, by their structure.
    pub correlation: f64,
}

/// Why the start is left as it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Error)]
#[serde(tag = "code", rename_all = "snake_case")]
pub enum Abstained {
    /// Too few blocks have structure in both images.
    #[error("{blocks} blocks have structure, {needed} are needed")]
    TooLittleTexture {
        /// Blocks with structure.
        blocks: usize,
        /// Needed.
        needed: usize,
    },
    /// Most of the structure does not follow.
    #[error("{:.0} % of the structure follows, {:.0} % are needed", 100.0 * share, 100.0 * LEAST_SHARE)]
    Disagrees {
        /// The share of the structure that follows.
        share: f64,
    },
    /// No rest was found.
    #[error("no rest after {steps} steps")]
    DidNotConverge {
        /// Steps.
        steps: usize,
    },
    /// It led farther than the start allows.
    #[error("it leads {by_px:.2} target px away, and the start allows {allowed_px:.2}")]
    MovedTooFar {
        /// How far, target px.
        by_px: f64,
        /// How far it may, target px.
        allowed_px: f64,
    },
    /// It is not better known than the start was, or correlates worse.
    #[error("the pixels know it no better: {sigma_px:.3} target px")]
    NoBetter {
        /// Its standard deviation, target px.
        sigma_px: f64,
    },
}

/// Refines `start`, which must be right within a pixel or a few of its own standard deviations.
///
/// # Errors
/// Why the start is to be kept.
pub fn refine(pictures: &Pictures<'_>, start: &Estimate) -> Result<Refined, Abstained> {
    let rough = like_similar(start, pictures);
    let coarse_px = rough.linear.det().abs().sqrt().max(1.0);
    let (mut descent, softer) = sharp_alike(pictures, &rough)?;
    let unsure_px = 2.0 * start.corner_sigma_px / coarse_px;
    if unsure_px > ROUGH_PX {
        let more = |px: f64| px.max(unsure_px.min(SOFTEST_PX));
        let first = Softer {
            fixed_px: more(softer.fixed_px),
            looked_px: more(softer.looked_px),
        };
        // What only softer images show is no result.
        let at = Descent::of(pictures, &rough, first)?.run(false)?;
        descent = Descent::of(pictures, &at.target_from_view, softer)?;
    }
    let found = descent.run(true)?;
    judge(pictures, start, &rough, coarse_px, found)
}

/// A fit that came to rest.
struct Found {
    target_from_view: Affine2,
    parts: Vec<Normal<UNKNOWNS, 1>>,
    steps: usize,
    before: f64,
    correlation: f64,
    share: f64,
    template: Template,
    view_is_fixed: bool,
}

/// A fit under way.
struct Descent<'a> {
    matched: Matched<'a>,
    template: Template,
    at: Affine2,
    look: Look,
}

impl<'a> Descent<'a> {
    fn of(
        pictures: &Pictures<'a>,
        target_from_view: &Affine2,
        softer: Softer,
    ) -> Result<Self, Abstained> {
        let soft = softer.fixed_px.max(softer.looked_px) > SOFT_PX;
        let side = SIDE[usize::from(soft)];
        let Ready {
            matched,
            at,
            blocks,
            side,
        } = ready(pictures, target_from_view, softer, side)?;
        let template = Template::new(&matched, &at, blocks, side);
        let mut look = Look::default();
        template.look(&matched, &at, &mut look);
        Ok(Self {
            matched,
            template,
            at,
            look,
        })
    }

    /// How well the same blocks correlate in images that are matched otherwise.
    fn correlation(&self, matched: &Matched<'_>) -> f64 {
        let (blocks, side) = (self.template.blocks.clone(), self.template.side);
        let template = Template::new(matched, &self.at, blocks, side);
        let mut look = Look::default();
        template.look(matched, &self.at, &mut look);
        template.correlation(&look)
    }

    /// Steps until nothing changes; `toned`: with a tone curve, where that helps.
    fn run(mut self, toned: bool) -> Result<Found, Abstained> {
        let mut look = std::mem::take(&mut self.look);
        if toned {
            self.tone(&mut look);
        }
        let before = self.template.correlation(&look);
        let unclear = |look: &Look, template: &Template| Abstained::Disagrees {
            share: template.share(look),
        };
        for steps in 1..=STEPS {
            let step = self.template.step(&mut look);
            let step = step.ok_or_else(|| unclear(&look, &self.template))?;
            if step.parts.len() < LEAST_BLOCKS {
                return Err(unclear(&look, &self.template));
            }
            let [x, y, stretch, turn] = step.change;
            let way = self.template.way(&step.change);
            let moved = Affine2 {
                linear: Mat2::IDENTITY + way.linear,
                offset: way.offset,
            };
            let back = moved.inverse().ok_or(Abstained::DidNotConverge { steps })?;
            self.at = self.at.after(&back);
            let px = f64::hypot(x, y) + f64::hypot(stretch, turn);
            let close = CLOSE_SIGMAS[usize::from(steps > STEPS / 2)];
            if px < CLOSE_PX || px < NEAR_PX && step.sigmas < close {
                let target_from_view = self.matched.target_from_view(&self.at);
                self.template.anew(&self.matched, &self.at, &mut look);
                return Ok(Found {
                    target_from_view: target_from_view
                        .ok_or(Abstained::DidNotConverge { steps })?,
                    parts: step.parts,
                    steps,
                    before,
                    correlation: self.template.correlation(&look),
                    share: self.template.share(&look),
                    view_is_fixed: self.matched.view_is_fixed,
                    template: self.template,
                });
            }
            self.template.look(&self.matched, &self.at, &mut look);
        }
        Err(Abstained::DidNotConverge { steps: STEPS })
    }

    /// Puts a tone curve before the fit where the residuals become less by it.
    fn tone(&mut self, look: &mut Look) {
        let Some(tone) = Tone::of(&mut self.template.pairs(look)) else {
            return;
        };
        let plain = self.template.scale(look);
        let toned = self.template.toned(&tone);
        let kept = self.template.exchange(toned);
        self.template.agree(look);
        if self.template.scale(look) > (1.0 - TONE_GAINS) * plain {
            self.template.exchange(kept);
            self.template.agree(look);
        }
    }
}

/// Both images matched, the transform between them, and the blocks to look at.
struct Ready<'a> {
    matched: Matched<'a>,
    at: Affine2,
    blocks: Vec<Block>,
    side: usize,
}

fn ready<'a>(
    pictures: &Pictures<'a>,
    target_from_view: &Affine2,
    softer: Softer,
    side: usize,
) -> Result<Ready<'a>, Abstained> {
    let needed = LEAST_BLOCKS;
    let none = Abstained::TooLittleTexture { blocks: 0, needed };
    let matched = Matched::new(pictures, target_from_view, softer).ok_or(none.clone())?;
    let at = matched.looked_from_fixed(target_from_view).ok_or(none)?;
    let mut best = (Vec::new(), side);
    for side in SMALLER.map(|share| side / share) {
        let found = spread(&structured(&matched, &at, side, 1));
        if found.len() > best.0.len() {
            best = (found, side);
        }
        if best.0.len() >= FEW_BLOCKS {
            break;
        }
    }
    match best.0.len() {
        blocks if blocks < needed => Err(Abstained::TooLittleTexture { blocks, needed }),
        _ => Ok(Ready {
            matched,
            at,
            blocks: best.0,
            side: best.1,
        }),
    }
}

/// A fit at the start, both images alike: one of them made softer where that is what they differ in.
fn sharp_alike<'a>(
    pictures: &Pictures<'a>,
    target_from_view: &Affine2,
) -> Result<(Descent<'a>, Softer), Abstained> {
    let plain = Descent::of(pictures, target_from_view, Softer::default())?;
    let mut best = (plain.template.correlation(&plain.look), Softer::default());
    if best.0 >= ALIKE {
        return Ok((plain, best.1));
    }
    for fixed in [true, false] {
        for px in SOFTER_PX {
            let (fixed_px, looked_px) = if fixed { (px, 0.0) } else { (0.0, px) };
            let softer = Softer {
                fixed_px,
                looked_px,
            };
            let Some(matched) = Matched::new(pictures, target_from_view, softer) else {
                continue;
            };
            let now = plain.correlation(&matched);
            if now < best.0 + SOFTER_GAINS {
                break;
            }
            best = (now, softer);
        }
    }
    match best.1 == Softer::default() {
        true => Ok((plain, best.1)),
        false => Ok((Descent::of(pictures, target_from_view, best.1)?, best.1)),
    }
}

/// The start, as a similarity where it is not known to be none: what few places leave open of its shape is not believed.
fn like_similar(start: &Estimate, pictures: &Pictures<'_>) -> Affine2 {
    let t = start.target_from_view;
    let [[a, b], [c, d]] = t.linear.0;
    if t.linear.det() <= 0.0 {
        return t;
    }
    let (straight, oblique) = ((a - d) / 2.0, (b + c) / 2.0);
    let s = &start.covariance;
    let of_straight = (s[0][0] + s[4][4] - 2.0 * s[0][4]) / 4.0;
    let of_oblique = (s[1][1] + s[3][3] + 2.0 * s[1][3]) / 4.0;
    let is_chance = |v: f64, variance: f64| v * v <= 9.0 * variance.max(0.0);
    if !(is_chance(straight, of_straight) && is_chance(oblique, of_oblique)) {
        return t;
    }
    let linear = Mat2([
        [(a + d) / 2.0, (b - c) / 2.0],
        [(c - b) / 2.0, (a + d) / 2.0],
    ]);
    let p = best_known(start, pictures);
    let (q, turned) = (t.apply(p), linear * p);
    Affine2 {
        linear,
        offset: [q[0] - turned[0], q[1] - turned[1]],
    }
}

/// The place of the view where a transform is known best, as far as it lies in it.
fn best_known(start: &Estimate, pictures: &Pictures<'_>) -> Vec2 {
    // Of the variance, summed over both rows, the least: gradient zero.
    let s = &start.covariance;
    let at = |i: usize, j: usize| s[i][j] + s[i + 3][j + 3];
    let normal = Mat2([[at(0, 0), at(0, 1)], [at(0, 1), at(1, 1)]]);
    let size = [pictures.view.width(), pictures.view.height()];
    let middle = size.map(|side| (side as f64 - 1.0) / 2.0);
    let Some(inverse) = normal.inverse() else {
        return middle;
    };
    let p = inverse * [-at(0, 2), -at(1, 2)];
    match p.iter().all(|v| v.is_finite()) {
        true => [0, 1].map(|k| p[k].clamp(0.0, size[k] as f64 - 1.0)),
        false => middle,
    }
}

fn judge(
    pictures: &Pictures<'_>,
    start: &Estimate,
    rough: &Affine2,
    coarse_px: f64,
    found: Found,
) -> Result<Refined, Abstained> {
    let share = found.share;
    let open = || Abstained::Disagrees { share };
    if share < LEAST_SHARE {
        return Err(open());
    }
    let fit = AffineFit {
        b_from_a: found.target_from_view,
        covariance: covariance(&found).ok_or_else(open)?,
    };
    let started = AffineFit {
        b_from_a: *rough,
        covariance: start.covariance,
    };
    for corner in found.template.corners() {
        let p = match found.view_is_fixed {
            true => corner,
            false => fit.b_from_a.inverse().ok_or_else(open)?.apply(corner),
        };
        let (was, is) = (rough.apply(p), fit.b_from_a.apply(p));
        let by_px = f64::hypot(was[0] - is[0], was[1] - is[1]);
        let allowed_px = SIGMAS * started.sigma_at(p) + BESIDES_PX * coarse_px;
        if by_px > allowed_px {
            return Err(Abstained::MovedTooFar { by_px, allowed_px });
        }
    }
    let estimate = Estimate::of(&fit, [pictures.view.width(), pictures.view.height()]);
    let sigma_px = estimate.sigma_px;
    if sigma_px > start.sigma_px || found.correlation + NO_WORSE < found.before {
        return Err(Abstained::NoBetter { sigma_px });
    }
    Ok(Refined {
        estimate,
        blocks: found.parts.len(),
        steps: found.steps,
        correlation: found.correlation,
    })
}

/// Of `target_from_view`: what it would be without each block, and what all of them share.
fn covariance(found: &Found) -> Option<[[f64; 6]; 6]> {
    let without = changes_without(&found.parts)?;
    let shared = (0..UNKNOWNS).map(|k| {
        let mut change = [0.0; UNKNOWNS];
        change[k] = SYSTEMATIC_PX;
        change
    });
    let t = &found.target_from_view;
    let deviation = |change: [f64; UNKNOWNS]| {
        let way = found.template.way(&change);
        let way = match found.view_is_fixed {
            // A way in the view, seen in the target.
            true => Affine2 {
                linear: t.linear * way.linear,
                offset: t.linear * way.offset,
            },
            // A way in the target, by where that lies in the view.
            false => way.after(t),
        };
        <[[f64; 3]; 2]>::from(way)
    };
    let all = without.into_iter().map(|[change]| change).chain(shared);
    Some(covariance_of_deviations(all.map(deviation), [0.0; 2]))
}
