//! The plan on its grid, kept for the windows beside.

use super::noise::{floor_i64, norm};
use super::plan::{PITCH, Plan, SAMPLE_UM, STEP_UM, plans};
use scopeservo_slide::cache::Lru;
use std::sync::Arc;

/// Nodes along the side of a square that is made at once.
const SIDE: i64 = 16;
/// Squares kept, bytes: a square of about 2 mm.
const CACHE_BYTES: usize = 16 << 20;

/// The plan of a seed, made where it is looked at and kept as long as there is room.
#[derive(Debug)]
pub(super) struct Plans {
    pub(super) seed: u64,
    squares: Lru<[i64; 2], Vec<Plan>>,
}

impl Plans {
    pub(super) fn new(seed: u64) -> Self {
        Self {
            seed,
            squares: Lru::new(CACHE_BYTES),
        }
    }

    /// The nodes of a square, row by row.
    fn square(&self, [a, b]: [i64; 2]) -> Arc<Vec<Plan>> {
        self.squares.get(&[a, b]).unwrap_or_else(|| {
            let side = |k: i64| k * SIDE..(k + 1) * SIDE;
            let made = Arc::new(plans(self.seed, side(a), side(b)));
            let bytes = size_of_val(made.as_slice());
            self.squares.put([a, b], Arc::clone(&made), bytes);
            made
        })
    }
}

/// The plan on a grid that covers a window and what reaches into it.
pub(super) struct PlanGrid {
    /// Grid node of the first entry.
    i0: i64,
    j0: i64,
    columns: usize,
    nodes: Vec<Plan>,
}

impl PlanGrid {
    /// Covers samples `i0..i0 + w`, `j0..j0 + h` and `margin_um` around.
    pub(super) fn new(
        plans: &Plans,
        [i0, j0]: [i64; 2],
        [w, h]: [usize; 2],
        margin_um: f64,
    ) -> Self {
        let m = (margin_um / SAMPLE_UM).ceil() as i64;
        let squares = |first: i64, n: usize| {
            let last = (first + n as i64 + m).div_euclid(PITCH) + 1;
            (first - m).div_euclid(PITCH * SIDE)..last.div_euclid(SIDE) + 1
        };
        let (across, down) = (squares(i0, w), squares(j0, h));
        let count = across.clone().count() * down.clone().count() * (SIDE * SIDE) as usize;
        let mut nodes = Vec::with_capacity(count);
        for b in down.clone() {
            let row: Vec<_> = across.clone().map(|a| plans.square([a, b])).collect();
            for k in 0..SIDE as usize {
                for square in &row {
                    nodes.extend_from_slice(&square[k * SIDE as usize..][..SIDE as usize]);
                }
            }
        }
        Self {
            i0: across.start * SIDE,
            j0: down.start * SIDE,
            columns: ((across.end - across.start) * SIDE) as usize,
            nodes,
        }
    }

    /// The plan at a place, micrometres.
    pub(super) fn at(&self, u: f64, v: f64) -> Plan {
        let (x, y) = (u / STEP_UM, v / STEP_UM);
        let (i, j) = (floor_i64(x), floor_i64(y));
        let (tx, ty) = ((x - i as f64) as f32, (y - j as f64) as f32);
        let at = (j - self.j0) as usize * self.columns + (i - self.i0) as usize;
        let n = &self.nodes;
        let upper = Plan::mix(&n[at], &n[at + 1], tx);
        let lower = Plan::mix(&n[at + self.columns], &n[at + self.columns + 1], tx);
        Plan::mix(&upper, &lower, ty)
    }

    /// Direction of the steepest rise of a field, as (cos, sin); (1, 0) where it is flat.
    pub(super) fn rise(&self, u: f64, v: f64, field: impl Fn(&Plan) -> f32) -> [f32; 2] {
        let e = 2.0;
        let gx = field(&self.at(u + e, v)) - field(&self.at(u - e, v));
        let gy = field(&self.at(u, v + e)) - field(&self.at(u, v - e));
        let n = norm(gx, gy);
        if n < 1e-6 {
            [1.0, 0.0]
        } else {
            [gx / n, gy / n]
        }
    }

    /// The plans of a row of samples where it crosses the grid's columns, from sample column `i0` on, a multiple of
    /// [`PITCH`].
    pub(super) fn row(&self, i0: i64, j: i64, out: &mut [Plan]) {
        let (b, ty) = (
            j.div_euclid(PITCH),
            (j.rem_euclid(PITCH) as f32 + 0.5) / PITCH as f32,
        );
        let at = (b - self.j0) as usize * self.columns + (i0.div_euclid(PITCH) - self.i0) as usize;
        let (upper, lower) = (&self.nodes[at..], &self.nodes[at + self.columns..]);
        for (out, (a, b)) in out.iter_mut().zip(upper.iter().zip(lower)) {
            *out = Plan::mix(a, b, ty);
        }
    }

    /// The least and the largest `flow` at the nodes around a window.
    pub(super) fn flows(&self, [i0, j0]: [i64; 2], [w, h]: [usize; 2]) -> [f32; 2] {
        let around = |first: i64, n: usize, from: i64| {
            let last = (first + n as i64).div_euclid(PITCH) + 1;
            (first.div_euclid(PITCH) - from) as usize..=(last - from) as usize
        };
        let (columns, rows) = (around(i0, w, self.i0), around(j0, h, self.j0));
        let mut ends = [f32::INFINITY, f32::NEG_INFINITY];
        for line in self
            .nodes
            .chunks_exact(self.columns)
            .skip(*rows.start())
            .take(rows.count())
        {
            for plan in &line[columns.clone()] {
                ends = [ends[0].min(plan.flow), ends[1].max(plan.flow)];
            }
        }
        ends
    }
}
