//! The search with vectors: a lane per train feature, so that no sum ever runs across a vector.
//!
//! Distance and index are one number. For a query q and a train feature t with index j, `|t|^2 - 2 q t` lies within 2^16 of 0,
//! and so the key `(|t|^2 - 2 q t) * 2^15 + j` fits 32 bits: the least key is the nearest, of equal ones that with the lowest
//! index, whatever the order in which they are seen. `|q|^2` is the same for all and added at the end. The nearest query of a
//! train feature has the key `(|q|^2 - 2 q t) * 2^15 + i`. Both are a label, known before, less the dot product times 2^16.
//!
//! Because order does not matter, a gate may sort both sides by sigma and angle, which leaves out most blocks as a whole. Features
//! that it never compares, bright and dark ones, are searched apart.

use std::f32::consts::TAU;
use std::ops::Range;

use fearless_simd::prelude::*;
use rayon::prelude::*;

use super::dots::{Dots, Lanes};
use super::gate::{Gate, Place, Window};
use super::nearest::{Found, NEVER, NOTHING, Nearest};
use crate::{Descriptor, Features, Keypoint};

/// Bits of a key that hold the index.
const INDEX_BITS: u32 = 15;

/// Greatest number of features on a side for which keys have room; more are searched piece by piece.
pub(super) const CHUNK: usize = (1 << INDEX_BITS) - 1;

/// Key of nothing: the one that [`CHUNK`] keeps from occurring.
const NONE: i32 = i32::MAX;

/// Blocks of train features that stay in the first cache while the queries of a task pass.
const TILE: usize = 8;

/// Groups of queries per parallel task.
const TASK: usize = 16;

/// Features of similar sigma that a gate sorts by angle.
const STRIP: usize = 256;

/// Components four by four, as the lanes of a vector hold them.
type Quads = [i32; 32];

/// `G` vectors of train features.
struct Block<D: Dots, const G: usize> {
    quads: [[Lanes<D>; G]; 32],
    /// Keys of a dot product of 0.
    labels: [Lanes<D>; G],
    sigma: [Floats<D>; G],
    angle: [Floats<D>; G],
    bounds: Bounds,
}

type Floats<D> = <<D as Dots>::S as fearless_simd::Simd>::f32s;

struct Query {
    quads: Quads,
    /// Key of a dot product of 0.
    label: i32,
    window: Window,
}

/// Ranges of sigma and angle: of the places of a block, or of the windows of a group of queries.
#[derive(Clone, Copy)]
struct Bounds {
    sigma: (f32, f32),
    angle: (f32, f32),
}

impl Bounds {
    const EMPTY: Self = Self {
        sigma: (f32::INFINITY, f32::NEG_INFINITY),
        angle: (f32::INFINITY, f32::NEG_INFINITY),
    };

    /// Widened by two ranges; what is not a number is never admitted and may be left out.
    fn with(self, sigma: (f32, f32), angle: f32) -> Self {
        let join = |a: (f32, f32), b: (f32, f32)| (a.0.min(b.0), a.1.max(b.1));
        Self {
            sigma: join(self.sigma, sigma),
            angle: join(self.angle, (angle, angle)),
        }
    }

    /// Whether a place within `self` may be admitted by one of the `windows`, whose angles may be `off`.
    #[inline(always)]
    fn meet(&self, windows: &Self, off: f32) -> bool {
        // Angles lie in [-pi, pi]; the margin is far above rounding.
        let off = off + 1e-3;
        let low = self.angle.0 - windows.angle.1 - off;
        let high = self.angle.1 - windows.angle.0 + off;
        let turn = low < 0.0 && high > 0.0 || high > TAU || low < -TAU;
        turn && self.sigma.1 > windows.sigma.0 && self.sigma.0 < windows.sigma.1
    }
}

/// Some features of a side, in the order in which the kernel takes them.
struct Side<'a> {
    keypoints: &'a [Keypoint],
    descriptors: &'a [Descriptor],
    order: Vec<usize>,
}

impl<'a> Side<'a> {
    fn of(
        features: &'a Features,
        range: Range<usize>,
        gate: &Gate,
        is_member: fn(&Keypoint) -> bool,
    ) -> Self {
        let keypoints = &features.keypoints[range.clone()];
        let members = (0..keypoints.len()).filter(|&i| is_member(&keypoints[i]));
        let mut order: Vec<usize> = members.collect();
        let mut strip = order.len().max(1);
        if gate.sigma_ratio.is_some() {
            order.sort_unstable_by(|&i, &j| keypoints[i].sigma.total_cmp(&keypoints[j].sigma));
            strip = STRIP;
        }
        if gate.turn_rad.is_some() {
            for strip in order.chunks_mut(strip) {
                strip.sort_unstable_by(|&i, &j| keypoints[i].angle.total_cmp(&keypoints[j].angle));
            }
        }
        Self {
            keypoints,
            descriptors: &features.descriptors[range],
            order,
        }
    }

    #[inline(always)]
    fn label(&self, index: usize) -> i32 {
        (self.descriptors[index].norm_sq() << INDEX_BITS) as i32 + index as i32
    }

    #[inline(always)]
    fn quads(&self, index: usize) -> Quads {
        let (quads, _) = self.descriptors[index].components().as_chunks::<4>();
        std::array::from_fn(|k| i32::from_ne_bytes(quads[k]))
    }

    /// As queries, filled up to a multiple of `group` with some that nothing is near to.
    #[inline(always)]
    fn queries(&self, gate: &Gate, group: usize) -> Vec<Query> {
        let mut queries: Vec<Query> = Vec::with_capacity(self.order.len() + group);
        for &index in &self.order {
            queries.push(Query {
                quads: self.quads(index),
                label: self.label(index),
                window: gate.window(&self.keypoints[index]),
            });
        }
        if let Some(&Query { window, .. }) = queries.last() {
            let whole = queries.len().next_multiple_of(group);
            queries.resize_with(whole, || Query {
                quads: [0; 32],
                label: NONE,
                window,
            });
        }
        queries
    }

    /// As train features, the last block filled up likewise.
    #[inline(always)]
    fn blocks<D: Dots, const G: usize>(&self, d: D, gate: &Gate) -> Vec<Block<D, G>> {
        let lanes = Lanes::<D>::LEN;
        let mut blocks = Vec::with_capacity(self.order.len().div_ceil(G * lanes));
        for members in self.order.chunks(G * lanes) {
            let s = d.simd();
            let mut block: Block<D, G> = Block {
                quads: [[Lanes::<D>::splat(s, 0); G]; 32],
                labels: [Lanes::<D>::splat(s, NONE); G],
                sigma: [Floats::<D>::splat(s, 0.0); G],
                angle: [Floats::<D>::splat(s, 0.0); G],
                bounds: Bounds::EMPTY,
            };
            for (at, &index) in members.iter().enumerate() {
                let (g, lane) = (at / lanes, at % lanes);
                let Place { sigma, angle, .. } = gate.place(&self.keypoints[index]);
                for (row, quad) in block.quads.iter_mut().zip(self.quads(index)) {
                    row[g][lane] = quad;
                }
                block.labels[g][lane] = self.label(index);
                block.sigma[g][lane] = sigma;
                block.angle[g][lane] = angle;
                block.bounds = block.bounds.with((sigma, sigma), angle);
            }
            blocks.push(block);
        }
        blocks
    }
}

/// What some of the queries found, as keys.
struct Task<D: Dots, const G: usize> {
    /// Nearest and second nearest, by query and lane.
    forward: Vec<[Lanes<D>; 2]>,
    /// By block.
    backward: Vec<[Lanes<D>; G]>,
}

#[inline(always)]
fn task<D: Dots, const Q: usize, const G: usize, const GATED: bool>(
    d: D,
    queries: &[Query],
    blocks: &[Block<D, G>],
) -> Task<D, G> {
    let s = d.simd();
    let none = Lanes::<D>::splat(s, NONE);
    let mut forward = vec![[none; 2]; queries.len()];
    let mut backward = vec![[none; G]; blocks.len()];
    let (groups, _) = queries.as_chunks::<Q>();
    let mut bounds = [Bounds::EMPTY; TASK];
    if GATED {
        for (bounds, group) in bounds.iter_mut().zip(groups) {
            for q in group {
                let w = q.window;
                *bounds = bounds.with((w.above, w.below), w.angle);
            }
        }
    }
    for (tile, backward) in blocks.chunks(TILE).zip(backward.chunks_mut(TILE)) {
        let (forward, _) = forward.as_chunks_mut::<Q>();
        for ((group, forward), bounds) in groups.iter().zip(forward).zip(&bounds) {
            for (block, backward) in tile.iter().zip(&mut *backward) {
                if GATED && !block.bounds.meet(bounds, group[0].window.off) {
                    continue;
                }
                let mut sums = [[d.zero(); G]; Q];
                for (k, train) in block.quads.iter().enumerate() {
                    for i in 0..Q {
                        let query = Lanes::<D>::splat(s, group[i].quads[k]);
                        for g in 0..G {
                            sums[i][g] = d.add(sums[i][g], train[g], query);
                        }
                    }
                }
                for i in 0..Q {
                    let q = &group[i];
                    let [mut first, mut second] = forward[i];
                    for g in 0..G {
                        let total = d.total_shl_16(sums[i][g]);
                        let mut key = block.labels[g] - total;
                        let mut back = Lanes::<D>::splat(s, q.label) - total;
                        if GATED {
                            let (sigma, angle, w) = (block.sigma[g], block.angle[g], &q.window);
                            // The steps of `Window::admits`.
                            let off = (angle - w.angle).abs();
                            let off = off.min(Floats::<D>::splat(s, TAU) - off);
                            let admitted = sigma.simd_gt(w.above)
                                & sigma.simd_lt(w.below)
                                & off.simd_lt(w.off);
                            key = admitted.select(key, none);
                            back = admitted.select(back, none);
                        }
                        second = second.min(first.max(key));
                        first = first.min(key);
                        backward[g] = backward[g].min(back);
                    }
                    forward[i] = [first, second];
                }
            }
        }
    }
    Task { forward, backward }
}

/// A key with the squared length of the one who asked.
fn decode(key: i32, norm_sq: u32) -> (usize, u32) {
    if key == NONE {
        return (NOTHING, u32::MAX);
    }
    let index = key as u32 & ((1 << INDEX_BITS) - 1);
    (
        index as usize,
        norm_sq.wrapping_add_signed(key >> INDEX_BITS),
    )
}

/// The search with train features in blocks of `G` vectors, `Q` queries at a time, in pieces of at most `chunk <= CHUNK`.
pub(super) fn search<D: Dots, const Q: usize, const G: usize>(
    d: D,
    query: &Features,
    train: &Features,
    gate: &Gate,
    chunk: usize,
) -> Found {
    let mut found = Found {
        forward: vec![Nearest::NONE; query.len()],
        backward: vec![NEVER; train.len()],
    };
    let pieces = |n: usize| (0..n).step_by(chunk).map(move |a| a..(a + chunk).min(n));
    for &is_member in gate.groups() {
        for trains in pieces(train.len()) {
            let train = Side::of(train, trains.clone(), gate, is_member);
            let blocks: Vec<Block<D, G>> = d.run(
                #[inline(always)]
                || train.blocks(d, gate),
            );
            for queries in pieces(query.len()) {
                let query = Side::of(query, queries.clone(), gate, is_member);
                let all = d.run(
                    #[inline(always)]
                    || query.queries(gate, Q),
                );
                let tasks: Vec<Task<D, G>> = all
                    .par_chunks(Q * TASK)
                    .map(|some| {
                        d.run(
                            #[inline(always)]
                            || match gate.is_unbounded() {
                                true => task::<D, Q, G, false>(d, some, &blocks),
                                false => task::<D, Q, G, true>(d, some, &blocks),
                            },
                        )
                    })
                    .collect();
                let forward = tasks.iter().flat_map(|t| &t.forward);
                for (&index, [first, second]) in query.order.iter().zip(forward) {
                    let mut keys = [NONE; 2];
                    for &key in first.as_slice().iter().chain(second.as_slice()) {
                        keys = [keys[0].min(key), keys[1].min(keys[0].max(key))];
                    }
                    let norm_sq = query.descriptors[index].norm_sq();
                    let (nearest, first_sq) = decode(keys[0], norm_sq);
                    found.forward[queries.start + index].see(Nearest {
                        index: nearest.saturating_add(trains.start),
                        first_sq,
                        second_sq: decode(keys[1], norm_sq).1,
                    });
                }
                let mut backward = vec![[Lanes::<D>::splat(d.simd(), NONE); G]; blocks.len()];
                for task in &tasks {
                    for (all, new) in backward.iter_mut().zip(&task.backward) {
                        for g in 0..G {
                            all[g] = all[g].min(new[g]);
                        }
                    }
                }
                let backward = backward.iter().flatten().flat_map(|v| v.as_slice());
                for (&index, &key) in train.order.iter().zip(backward) {
                    let (nearest, distance_sq) = decode(key, train.descriptors[index].norm_sq());
                    let all = &mut found.backward[trains.start + index];
                    *all = (*all).min((distance_sq, nearest.saturating_add(queries.start)));
                }
            }
        }
    }
    found
}
