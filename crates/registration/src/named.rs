//! What looks like the places that two images share: features that lie elsewhere, in the target or in the view.

use crate::Registration;
use crate::correspondences::point;
use crate::prior::coherence;
use crate::significance::unique_places;
use scopeservo_features::{Features, Keypoint};
use scopeservo_geometry::{Affine2, Correspondence, Vec2};

/// Inliers of the view that are asked for others like theirs.
const ASKED: usize = 300;
/// Others that each of them names: the nearest, so that of a lattice's many periods the shortest is seen.
pub(crate) const NAMED: usize = 8;
/// A descriptor is alike when its distance is at most this many times what the matched ones have.
const ALIKE: f32 = 2.0;
/// Pixels, of the coarser image, that a place must lie from the matched one to be another.
const ELSEWHERE_PX: f64 = 6.0;
/// A pair of keypoints may scale by so much less or more than the whole image.
const SCALE_SLACK: f64 = 1.6;

/// Where others are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    Target,
    View,
}

/// A place of the view and one of the target that look alike.
pub(crate) struct Named {
    pub(crate) side: Side,
    pub(crate) asked: usize,
    pub(crate) pair: Correspondence,
    pub(crate) shape: [f64; 4],
}

/// The places asked, as pairs of features, and what looks like each of them and lies elsewhere.
pub(crate) fn look_alikes(
    view: &Features,
    target: &Features,
    answer: &Registration,
    first: &Affine2,
    threshold: f64,
) -> (Vec<[usize; 2]>, Vec<Named>) {
    let asked = asked(view, target, answer, first, threshold);
    let Some(view_from_target) = first.inverse() else {
        return (asked, Vec::new());
    };
    let scale = first.linear.det().abs().sqrt();
    let coarse_px = scale.max(1.0);
    let limits = alike_limits(view, target, &asked);
    let (in_target, in_view) = (ELSEWHERE_PX * coarse_px, ELSEWHERE_PX * coarse_px / scale);
    let mut named = Vec::new();
    for (k, (&[query, train], &limit)) in asked.iter().zip(&limits).enumerate() {
        let (v, t) = (&view.keypoints[query], &target.keypoints[train]);
        let there = first.apply(point(v));
        let like = |other| distance_sq(view, query, target, other) <= limit;
        for other in others(target, v, scale, there, in_target, like) {
            named.push(name(Side::Target, k, v, &target.keypoints[other]));
        }
        let here = view_from_target.apply(point(t));
        let like = |other| distance_sq(view, other, target, train) <= limit;
        for other in others(view, t, 1.0 / scale, here, in_view, like) {
            named.push(name(Side::View, k, &view.keypoints[other], t));
        }
    }
    (asked, named)
}

/// Pairs of places that are alike where the first transform takes one to the other, spread over the image: places that lie together would vote
/// together. Those that were matched are the ones without a twin, as the ratio test leaves no others; so what lies and looks as it should is
/// asked as well.
fn asked(
    view: &Features,
    target: &Features,
    answer: &Registration,
    first: &Affine2,
    threshold: f64,
) -> Vec<[usize; 2]> {
    let mut all = answer.agreeing.clone();
    let limit = usual(view, target, &all) * ALIKE * ALIKE;
    let coherent = coherence(first);
    let mut by_row: Vec<usize> = (0..target.len()).collect();
    by_row.sort_by(|&a, &b| target.keypoints[a].y.total_cmp(&target.keypoints[b].y));
    for (query, v) in view.keypoints.iter().enumerate() {
        let there = first.apply(point(v));
        let from =
            by_row.partition_point(|&t| f64::from(target.keypoints[t].y) < there[1] - threshold);
        let near = by_row[from..]
            .iter()
            .copied()
            .take_while(|&t| f64::from(target.keypoints[t].y) <= there[1] + threshold);
        let alike = near.filter(|&t| {
            let k = &target.keypoints[t];
            let shape = [v.sigma, k.sigma, v.angle, k.angle].map(f64::from);
            v.bright == k.bright
                && f64::hypot(f64::from(k.x) - there[0], f64::from(k.y) - there[1]) <= threshold
                && coherent(&shape)
        });
        let likest = alike
            .map(|t| (distance_sq(view, query, target, t), t))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        all.extend(likest.filter(|l| l.0 <= limit).map(|l| [query, l.1]));
    }
    let points: Vec<(Vec2, Vec2)> = all
        .iter()
        .map(|&[q, t]| (point(&view.keypoints[q]), point(&target.keypoints[t])))
        .collect();
    let apart: Vec<[usize; 2]> = unique_places(&points, 4.0, threshold)
        .into_iter()
        .map(|k| all[k])
        .collect();
    let every = apart.len().div_ceil(ASKED).max(1);
    apart.into_iter().step_by(every).collect()
}

/// The squared distance that pairs have in the median.
fn usual(view: &Features, target: &Features, pairs: &[[usize; 2]]) -> f32 {
    let mut own: Vec<f32> = pairs
        .iter()
        .map(|&[q, t]| distance_sq(view, q, target, t))
        .collect();
    own.sort_by(f32::total_cmp);
    own.get(own.len() / 2).copied().unwrap_or(0.0)
}

/// What cannot be compared is nowhere alike.
fn distance_sq(view: &Features, query: usize, target: &Features, train: usize) -> f32 {
    let (of, others) = (&view.descriptors, &target.descriptors);
    of.distance_sq(query, others, train)
        .map_or(f32::INFINITY, |sq| sq as f32)
}

/// Up to which squared distance a descriptor looks like each of those asked.
fn alike_limits(view: &Features, target: &Features, asked: &[[usize; 2]]) -> Vec<f32> {
    let usual = usual(view, target, asked);
    let own = asked.iter().map(|&[q, t]| distance_sq(view, q, target, t));
    own.map(|d| ALIKE * ALIKE * d.max(usual)).collect()
}

/// The nearest features that look like `asked`, a keypoint of the other image, and lie elsewhere than `here`.
fn others(
    among: &Features,
    asked: &Keypoint,
    scale: f64,
    here: Vec2,
    elsewhere: f64,
    like: impl Fn(usize) -> bool,
) -> Vec<usize> {
    let size = scale * f64::from(asked.sigma);
    let sizes = (size / SCALE_SLACK) as f32..(size * SCALE_SLACK) as f32;
    let mut found: Vec<(f64, usize)> = Vec::new();
    for (other, k) in among.keypoints.iter().enumerate() {
        if k.bright != asked.bright || !sizes.contains(&k.sigma) {
            continue;
        }
        let d = [f64::from(k.x) - here[0], f64::from(k.y) - here[1]];
        let away_sq = d[0] * d[0] + d[1] * d[1];
        if away_sq > elsewhere * elsewhere && like(other) {
            found.push((away_sq, other));
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.truncate(NAMED);
    found.into_iter().map(|f| f.1).collect()
}

fn name(side: Side, asked: usize, v: &Keypoint, t: &Keypoint) -> Named {
    Named {
        side,
        asked,
        pair: Correspondence {
            p_in_a: point(v),
            p_in_b: point(t),
            sigma: 1.0,
        },
        shape: [v.sigma, t.sigma, v.angle, t.angle].map(f64::from),
    }
}
