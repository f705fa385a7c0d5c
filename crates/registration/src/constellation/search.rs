//! Transforms that two places of the target and two of the view propose.

use super::judge::Judge;
use super::places::{LEAST_PLACES, Place, distance_sq};
use crate::prior::wrap;
use scopeservo_geometry::{Affine2, Similarity, Vec2};

/// Pairs of the target's places that propose: of the strongest few, the farthest apart first.
const STRONGEST: usize = 14;
const PAIRS: usize = 40;
/// Nearer together than this they do not tell the angle, pixels of the view.
const LEAST_APART_PX: f64 = 12.0;
/// What two places may be off by together, pixels of the view.
const OFF_PX: f64 = 1.5;
/// So many are judged in full.
const JUDGED: usize = 60;
/// Least share of the target's places in view that agree with what is judged.
const SHARE: f64 = 0.45;

/// What is to be judged.
pub(super) struct Proposals {
    /// View from target.
    pub(super) transforms: Vec<Affine2>,
    /// How many there were to choose from.
    pub(super) tried: f64,
}

/// Those that most of the target's places agree with.
pub(super) fn proposals(judge: &Judge<'_>) -> Proposals {
    let mut tried = 0.0;
    let mut all: Vec<(usize, Affine2)> = Vec::new();
    for [i, j] in pairs(judge) {
        let ends = (&judge.target.all[i], &judge.target.all[j]);
        let (a, b) = ends;
        let apart = distance(a.at, b.at) / judge.scale.ratio;
        let slack = apart * judge.scale.tolerance + OFF_PX;
        let long_sq = (apart - slack).max(0.0).powi(2)..=(apart + slack).powi(2);
        let (first, second) = (judge.those(i), judge.those(j));
        for v in first {
            for &w in &second {
                if !long_sq.contains(&distance_sq(v.at, w.at)) {
                    continue;
                }
                let Some(transform) = through(ends, (v, w), judge) else {
                    continue;
                };
                tried += 1.0;
                let agree = judge.counted(&transform, SHARE);
                if let Some(agree) = agree.filter(|n| *n >= LEAST_PLACES) {
                    all.push((agree, transform));
                }
            }
        }
    }
    // A stable sort: of equals the first stays the first.
    all.sort_by_key(|(agree, _)| std::cmp::Reverse(*agree));
    all.truncate(JUDGED);
    Proposals {
        transforms: all.into_iter().map(|(_, t)| t).collect(),
        tried,
    }
}

/// Pairs of the target's strongest places, the farthest apart first.
fn pairs(judge: &Judge<'_>) -> Vec<[usize; 2]> {
    let strongest = judge.target.all.len().min(STRONGEST);
    let apart = |[i, j]: &[usize; 2]| distance(judge.target.all[*i].at, judge.target.all[*j].at);
    let mut pairs: Vec<[usize; 2]> = (0..strongest)
        .flat_map(|i| (i + 1..strongest).map(move |j| [i, j]))
        .collect();
    pairs.retain(|pair| apart(pair) >= LEAST_APART_PX * judge.scale.ratio);
    pairs.sort_by(|p, q| apart(q).total_cmp(&apart(p)));
    pairs.truncate(PAIRS);
    pairs
}

fn distance(a: Vec2, b: Vec2) -> f64 {
    distance_sq(a, b).sqrt()
}

/// The view from the target, of the scale that is known, by the middle and the direction of two places; `None` where the angle is none that may be.
fn through(
    (a, b): (&Place, &Place),
    (v, w): (&Place, &Place),
    judge: &Judge<'_>,
) -> Option<Affine2> {
    let angle = |p: Vec2, q: Vec2| (q[1] - p[1]).atan2(q[0] - p[0]);
    let turn = angle(v.at, w.at) - angle(a.at, b.at);
    let apart = distance(a.at, b.at) / judge.scale.ratio;
    // From view to target it is the other way round.
    let known = judge.prior.rotation;
    let slack = OFF_PX / apart;
    if known.is_some_and(|r| wrap(-turn - r.angle_rad).abs() > r.tolerance_rad + slack) {
        return None;
    }
    let turned = Affine2::from(Similarity {
        scale: 1.0 / judge.scale.ratio,
        angle_rad: turn,
        offset: [0.0; 2],
    });
    let middle = |p: Vec2, q: Vec2| [0, 1].map(|k| 0.5 * (p[k] + q[k]));
    let (from, to) = (turned.apply(middle(a.at, b.at)), middle(v.at, w.at));
    Some(Affine2 {
        offset: [to[0] - from[0], to[1] - from[1]],
        ..turned
    })
}
