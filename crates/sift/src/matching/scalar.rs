//! The search as it is defined, pair by pair: the oracle of the kernels.

use rayon::prelude::*;

use super::{Found, Gate, Nearest};
use crate::{Descriptor, Features};

/// Query features per parallel task.
const TASK: usize = 128;

/// A function of its own: inlined into the search it is not vectorised, which takes five times as long.
#[inline(never)]
fn distance_sq(a: &Descriptor, b: &Descriptor) -> u32 {
    let square = |(&a, &b): (&u8, &u8)| (i32::from(a) - i32::from(b)).pow(2) as u32;
    a.components().iter().zip(b.components()).map(square).sum()
}

pub(super) fn search(query: &Features, train: &Features, gate: &Gate) -> Found {
    let task = |queries: usize| {
        let queries = queries..(queries + TASK).min(query.len());
        let mut found = Found {
            forward: vec![Nearest::NONE; queries.len()],
            backward: vec![Nearest::NONE; train.len()],
        };
        for (i, forward) in queries.zip(&mut found.forward) {
            let window = gate.window(&query.keypoints[i]);
            for (j, backward) in found.backward.iter_mut().enumerate() {
                if window.admits(gate.place(&train.keypoints[j])) {
                    let first_sq = distance_sq(&query.descriptors[i], &train.descriptors[j]);
                    let pair = |index| Nearest {
                        index,
                        first_sq,
                        second_sq: u32::MAX,
                    };
                    forward.see(pair(j));
                    backward.see(pair(i));
                }
            }
        }
        found
    };
    let starts: Vec<usize> = (0..query.len()).step_by(TASK).collect();
    let tasks: Vec<Found> = starts.into_par_iter().map(task).collect();
    let mut found = Found {
        forward: Vec::with_capacity(query.len()),
        backward: vec![Nearest::NONE; train.len()],
    };
    for task in tasks {
        found.forward.extend(task.forward);
        for (all, later) in found.backward.iter_mut().zip(task.backward) {
            all.see(later);
        }
    }
    found
}
