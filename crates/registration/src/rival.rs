//! Is there another transform that says as much? Specimens that repeat themselves (wafers, grids, films, two equal cells) agree with
//! more than one, and which of them the search found is chance.
//!
//! [`find_rivals`] looks for other transforms. What the ratio test threw away is what it needs: features that look like a matched
//! one and lie elsewhere, in the target (it holds what is in view twice) and in the view (that holds the target twice). [`undecided`](crate::undecided) then
//! lets the pixels speak.

use crate::corners::{centre, corners};
use crate::correspondences::point;
use crate::named::{NAMED, Named, Side, look_alikes};
use crate::prior::wrap;
use crate::significance::log10_nfa;
use crate::{Estimate, Options, Prior, Registration};
use scopeservo_features::Features;
use scopeservo_geometry::{
    Affine2, Correspondence, OrientedProblem, RansacOptions, Vec2, affine_robust, lo_ransac,
    similarity_robust,
};
use serde::{Deserialize, Serialize};

/// A rival that explains this share of the places that lie in the other image under it is significant.
const RIVAL_SHARE: f64 = 0.3;
/// Under a rival at least this share of those asked lie there.
const RIVAL_OVERLAP: f64 = 0.2;
/// Fewer places than these, at least or as a share of those asked, are not even worth a look at the pixels.
const LEAST_PLACES: usize = 3;
const LEAST_SHARE: f64 = 0.08;
/// Transforms are looked for so often at most, each time among the places that those before leave.
const ROUNDS: usize = 6;
/// The commonest shifts are looked at, so many of them each time.
const SHIFTS: usize = 6;
/// How far the shift of a rival is from a multiple of a pixel's place on the sensor to be taken for fixed to it, px and rad.
const FIXED: [f64; 2] = [3.0, 0.01];

/// Another transform that explains the view.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rival {
    /// Pixel of the target from pixel of the view.
    pub target_from_view: Affine2,
    /// How far the view's centre lands from where the first transform takes it, target pixels.
    pub shift_px: Vec2,
    /// How far it is turned against the first one, radians.
    pub turn_rad: f64,
    /// Places asked that it explains.
    pub places: usize,
    /// Places asked.
    pub asked: usize,
    /// Whether these alone are more than chance makes.
    pub significant: bool,
}

impl Rival {
    /// What `other` is beside `first`, told at a place of the view: so many of the places asked agree with it. `None` for a mirror.
    pub(crate) fn beside(
        first: &Affine2,
        other: &Affine2,
        at: Vec2,
        [places, asked]: [usize; 2],
    ) -> Option<Self> {
        let (a, b) = (first.apply(at), other.apply(at));
        let angle = |t: &Affine2| t.linear.rotation_angle();
        Some(Self {
            target_from_view: *other,
            shift_px: [b[0] - a[0], b[1] - a[1]],
            turn_rad: wrap(angle(other)? - angle(first)?),
            places,
            asked,
            significant: false,
        })
    }
}

/// Other transforms that some of the inliers have features for, the most places first. `without_identity`: what stays where it is
/// on the sensor is no rival, since it is known not to be the specimen.
pub fn find_rivals(
    view: &Features,
    target: &Features,
    answer: &Registration,
    prior: &Prior,
    options: &Options,
    without_identity: bool,
) -> Vec<Rival> {
    let Some(first) = answer.found() else {
        return Vec::new();
    };
    let coarse_px = first.target_from_view.linear.det().abs().sqrt().max(1.0);
    let threshold = options.threshold_px * coarse_px;
    let (asked, named) = look_alikes(view, target, answer, &first.target_from_view, threshold);
    let allowed = |t: &Affine2| {
        prior.allows(t)
            && differs(view, first, t, threshold)
            && !(without_identity && stays(view, t))
    };
    let counts =
        |r: &Rival| r.places >= LEAST_PLACES && r.places as f64 >= LEAST_SHARE * r.asked as f64;
    let mut told: Vec<Rival> = Vec::new();
    // What many places name hides what few do: what is explained is put aside, and the rest asked again.
    let mut left: Vec<&Named> = named.iter().collect();
    for _ in 0..ROUNDS {
        let mut candidates = shifts(first, &left, threshold);
        candidates.extend(turned(&left, &allowed, options.seed, threshold));
        let rated = candidates
            .into_iter()
            .filter_map(|t| rate(view, target, first, &asked, &named, t, threshold));
        let mut rivals: Vec<Rival> = rated
            .filter(|r| allowed(&r.target_from_view) && counts(r))
            .collect();
        rivals.sort_by_key(|r| std::cmp::Reverse(r.places));
        let before = told.len();
        for rival in rivals {
            // Each once.
            let off = |o: &Rival| {
                let d = [0, 1].map(|k| o.shift_px[k] - rival.shift_px[k]);
                f64::hypot(d[0], d[1]) + (o.turn_rad - rival.turn_rad).abs() * view.width as f64
            };
            if told.iter().all(|o| off(o) > 2.0 * threshold) {
                told.push(Rival {
                    significant: rival.places >= least_places(&rival, target, threshold, options),
                    ..rival
                });
            }
        }
        if told.len() == before {
            break;
        }
        let explained = |n: &&Named| {
            let found = told[before..].iter();
            found
                .map(|r| &r.target_from_view)
                .any(|t| agrees(t, n, threshold))
        };
        left.retain(|n| !explained(n));
    }
    told.sort_by_key(|r| std::cmp::Reverse(r.places));
    told
}

/// The first transform, shifted by each of a target's periods, either way: rivals that need no feature to be thought of.
pub fn shifted(first: &Estimate, periods_px: &[Vec2]) -> Vec<Rival> {
    let both = periods_px.iter().flat_map(|p| [*p, p.map(|v| -v)]);
    both.map(|shift_px| {
        let t = first.target_from_view;
        Rival {
            target_from_view: Affine2 {
                offset: [t.offset[0] + shift_px[0], t.offset[1] + shift_px[1]],
                ..t
            },
            shift_px,
            turn_rad: 0.0,
            places: 0,
            asked: 0,
            significant: false,
        }
    })
    .collect()
}

/// The first transform, shifted as most of the others named are: their commonest shifts.
fn shifts(first: &Estimate, named: &[&Named], threshold: f64) -> Vec<Affine2> {
    let shift = |n: &&Named| {
        let here = first.target_from_view.apply(n.pair.p_in_a);
        [n.pair.p_in_b[0] - here[0], n.pair.p_in_b[1] - here[1]]
    };
    let all: Vec<Vec2> = named.iter().map(shift).collect();
    let mut cells = std::collections::BTreeMap::<[i64; 2], usize>::new();
    let cell = |s: &Vec2| s.map(|v| (v / threshold).floor() as i64);
    for s in &all {
        *cells.entry(cell(s)).or_default() += 1;
    }
    // Counted with their neighbours: a shift on the edge of two cells is one shift.
    let around = |c: &[i64; 2]| -> usize {
        let near = (-1..=1).flat_map(|i| (-1..=1).map(move |j| [c[0] + i, c[1] + j]));
        near.filter_map(|c| cells.get(&c)).sum()
    };
    let mut counted: Vec<(usize, [i64; 2])> = cells.keys().map(|c| (around(c), *c)).collect();
    counted.sort_by_key(|&(count, cell)| (std::cmp::Reverse(count), cell));
    let mut commonest: Vec<[i64; 2]> = Vec::new();
    for (_, c) in counted {
        let beside = |o: &[i64; 2]| (0..2).all(|k| (o[k] - c[k]).abs() <= 1);
        if commonest.len() < SHIFTS && !commonest.iter().any(beside) {
            commonest.push(c);
        }
    }
    commonest
        .iter()
        .map(|c| {
            let mut at = c.map(|v| (v as f64 + 0.5) * threshold);
            for radius in [2.0, 1.0, 1.0] {
                let near: Vec<&Vec2> = all
                    .iter()
                    .filter(|s| f64::hypot(s[0] - at[0], s[1] - at[1]) <= radius * threshold)
                    .collect();
                if near.is_empty() {
                    break;
                }
                let n = near.len() as f64;
                at = [0, 1].map(|k| near.iter().map(|s| s[k]).sum::<f64>() / n);
            }
            let t = first.target_from_view;
            Affine2 {
                offset: [t.offset[0] + at[0], t.offset[1] + at[1]],
                ..t
            }
        })
        .collect()
}

/// A transform of any angle that the others named agree on.
fn turned(
    named: &[&Named],
    allowed: &dyn Fn(&Affine2) -> bool,
    seed: u64,
    threshold: f64,
) -> Option<Affine2> {
    let pairs: Vec<Correspondence> = named.iter().map(|n| n.pair).collect();
    let shapes: Vec<[f64; 4]> = named.iter().map(|n| n.shape).collect();
    let options = RansacOptions {
        threshold,
        seed,
        max_samples: 600,
        ..RansacOptions::default()
    };
    let fit = lo_ransac(&OrientedProblem::new(&pairs, &shapes, &allowed), &options)?;
    Some(fit.model)
}

fn agrees(t: &Affine2, n: &Named, threshold: f64) -> bool {
    let q = t.apply(n.pair.p_in_a);
    f64::hypot(q[0] - n.pair.p_in_b[0], q[1] - n.pair.p_in_b[1]) <= threshold
}

/// How many of the places asked a transform explains, fitted to them.
fn rate(
    view: &Features,
    target: &Features,
    first: &Estimate,
    asked: &[[usize; 2]],
    named: &[Named],
    rough: Affine2,
    threshold: f64,
) -> Option<Rival> {
    let near = |t: &Affine2| -> Vec<Correspondence> {
        let near = named.iter().filter(|n| agrees(t, n, threshold));
        near.map(|n| n.pair).collect()
    };
    // A turned lattice of pixels that are not square is no similarity, and few places bend an affine transform.
    let similar = similarity_robust(&near(&rough));
    let affine = |t: Affine2| affine_robust(&near(&t));
    let bent = similar.and_then(affine).and_then(affine);
    let explained = |t: &Affine2, side: Side| {
        let of = named
            .iter()
            .filter(|n| n.side == side && agrees(t, n, threshold));
        let mut explained: Vec<usize> = of.map(|n| n.asked).collect();
        explained.dedup();
        explained.len()
    };
    let count = |t: &Affine2| explained(t, Side::Target).max(explained(t, Side::View));
    // Few places bend a fit: then the shape of the first transform is the better one.
    let (places, transform) = [Some(rough), similar, bent]
        .into_iter()
        .flatten()
        .map(|t| (count(&t), t))
        .reduce(|a, b| if b.0 > a.0 { b } else { a })?;
    // Those that lie in the other image at all.
    let back = transform.inverse()?;
    let lies_in = |p: Vec2, f: &Features| {
        (0.0..f.width as f64).contains(&p[0]) && (0.0..f.height as f64).contains(&p[1])
    };
    let in_target = explained(&transform, Side::Target) == places;
    let inside = asked
        .iter()
        .filter(|[q, t]| match in_target {
            true => lies_in(transform.apply(point(&view.keypoints[*q])), target),
            false => lies_in(back.apply(point(&target.keypoints[*t])), view),
        })
        .count();
    if (inside as f64) < RIVAL_OVERLAP * asked.len() as f64 {
        return None;
    }
    let middle = centre([view.width, view.height]);
    let counts = [places, inside];
    Rival::beside(&first.target_from_view, &transform, middle, counts)
}

/// Explaining fewer places than this proves nothing: chance makes a shift that so many agree on.
fn least_places(rival: &Rival, target: &Features, threshold: f64, options: &Options) -> usize {
    let area = (target.width * target.height) as f64;
    let chance = NAMED as f64 * std::f64::consts::PI * threshold * threshold / area;
    let limit = options.false_alarms.log10();
    let by_chance = (2..=rival.asked)
        .find(|&k| log10_nfa(1, rival.asked, k, chance) < limit)
        .unwrap_or(usize::MAX);
    by_chance.max((RIVAL_SHARE * rival.asked as f64).ceil() as usize)
}

/// Whether two transforms take some corner of the view to different places.
fn differs(view: &Features, first: &Estimate, other: &Affine2, threshold: f64) -> bool {
    corners([view.width, view.height]).into_iter().any(|p| {
        let (a, b) = (first.target_from_view.apply(p), other.apply(p));
        f64::hypot(a[0] - b[0], a[1] - b[1]) > 2.0 * threshold
    })
}

/// Whether a transform leaves everything where it is on the sensor.
fn stays(view: &Features, transform: &Affine2) -> bool {
    let c = centre([view.width, view.height]);
    let q = transform.apply(c);
    let turn = transform.linear.rotation_angle().unwrap_or(f64::NAN);
    f64::hypot(q[0] - c[0], q[1] - c[1]) < FIXED[0] && turn.abs() < FIXED[1]
}
