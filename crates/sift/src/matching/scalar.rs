//! The search as it is defined, pair by pair: the oracle of the kernels.

use rayon::prelude::*;

use super::gate::{Gate, Place};
use super::nearest::{Found, NEVER, Nearest};
use crate::{Descriptor, Features};

/// Query features per parallel task.
const TASK: usize = 128;

/// Dot product; the bounds of [`Descriptor`] let it fit.
///
/// A function of its own: inlined into the search it is not vectorised, which takes five times as long.
#[inline(never)]
fn dot(a: &Descriptor, b: &Descriptor) -> u16 {
    let product = |(&a, &b): (&u8, &u8)| u16::from(a) * u16::from(b);
    a.components().iter().zip(b.components()).map(product).sum()
}

pub(super) fn search(query: &Features, train: &Features, gate: &Gate) -> Found {
    let places: Vec<Place> = train.keypoints.iter().map(|k| gate.place(k)).collect();
    let norms_sq: Vec<u32> = train.descriptors.iter().map(Descriptor::norm_sq).collect();
    let task = |queries: usize| {
        let queries = queries..(queries + TASK).min(query.len());
        let mut found = Found {
            forward: vec![Nearest::NONE; queries.len()],
            backward: vec![NEVER; train.len()],
        };
        for (i, forward) in queries.zip(&mut found.forward) {
            let window = gate.window(&query.keypoints[i]);
            let query_norm_sq = query.descriptors[i].norm_sq();
            for (j, backward) in found.backward.iter_mut().enumerate() {
                if window.admits(places[j]) {
                    let dot = dot(&query.descriptors[i], &train.descriptors[j]);
                    let first_sq = query_norm_sq + norms_sq[j] - 2 * u32::from(dot);
                    forward.see(Nearest {
                        index: j,
                        first_sq,
                        second_sq: u32::MAX,
                    });
                    *backward = (*backward).min((first_sq, i));
                }
            }
        }
        found
    };
    let starts: Vec<usize> = (0..query.len()).step_by(TASK).collect();
    let tasks: Vec<Found> = starts.into_par_iter().map(task).collect();
    let mut found = Found {
        forward: Vec::with_capacity(query.len()),
        backward: vec![NEVER; train.len()],
    };
    for task in tasks {
        found.forward.extend(task.forward);
        for (all, later) in found.backward.iter_mut().zip(task.backward) {
            *all = (*all).min(later);
        }
    }
    found
}
