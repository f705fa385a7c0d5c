//! Cells: where they are and what each looks like. No two are alike.
//!
//! Places are a hard-core thinning of random candidates (Matern 1960, type II, run twice to fill the gaps): a candidate
//! stays if none of higher rank is nearer than their mean radius. The rule is local, so any window finds the same cells.

use super::grid::PlanGrid;
use super::noise::{Dice, hash, smoothstep};
use super::plan::SAMPLE_UM;
use std::ops::Range;

/// Side of a bin of candidates, micrometres.
const BIN_UM: f64 = 8.0;
/// Candidates per bin.
const PER_BIN: i64 = 4;
/// Largest exclusion radius, micrometres.
const MAX_RADIUS_UM: f64 = 9.0;
/// How far a cell paints, micrometres.
pub(super) const REACH_UM: f64 = 15.0;
/// How far the plan must be known around a window: a cell's reach and three steps of the thinning.
pub(super) const MARGIN_UM: f64 = THINNING_UM + 4.0;
/// How far candidates matter.
const THINNING_UM: f64 = REACH_UM + 3.0 * MAX_RADIUS_UM;

/// What a cell is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Epithelial,
    Fibroblast,
    Lymphocyte,
    RedCell,
}

/// One cell, ready to paint. Lengths in micrometres; `u`, `v` are multiples of 1/256 so that distances are exact.
#[derive(Clone, Debug)]
pub(super) struct Cell {
    pub(super) kind: Kind,
    pub(super) u: f64,
    pub(super) v: f64,
    /// Direction of the long axes of nucleus and body (cos, sin).
    pub(super) axis: [f32; 2],
    /// How much longer than wide the body is.
    pub(super) stretch: f32,
    /// Staining of the body.
    pub(super) eosin: f32,
    pub(super) basophil: f32,
    /// Half axes of the nucleus; zero for none.
    pub(super) nucleus: [f32; 2],
    /// Curvature of a spindle: how far its ends bend aside, as a share of its half length.
    pub(super) bend: f32,
    /// Offset of the nucleus from the cell's place.
    pub(super) offset: [f32; 2],
    pub(super) hematoxylin: f32,
    /// Contrast of chromatin, and darkness of the nuclear rim.
    pub(super) chromatin: f32,
    pub(super) rim: f32,
    /// Nucleolus: offset within the nucleus and radius; radius zero for none.
    pub(super) nucleolus: [f32; 3],
    /// Radius of a pale halo or vacuole; zero for none.
    pub(super) hole: f32,
}

struct Candidate {
    u: f64,
    v: f64,
    rank: u32,
    kind: Kind,
    radius: f32,
    state: State,
}

/// Candidates in square bins, row by row.
struct Bins {
    across: usize,
    /// The first candidate of each bin, and the number of all.
    starts: Vec<usize>,
    candidates: Vec<Candidate>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Waiting,
    Kept,
    Dropped,
}

/// Every cell that paints into the window of samples `i0..i0 + w`, `j0..j0 + h`, in an order of its own.
pub(super) fn cells_near(
    seed: u64,
    plan: &PlanGrid,
    [i0, j0]: [i64; 2],
    [w, h]: [usize; 2],
) -> Vec<Cell> {
    let (u0, v0) = (i0 as f64 * SAMPLE_UM, j0 as f64 * SAMPLE_UM);
    let (u1, v1) = (u0 + w as f64 * SAMPLE_UM, v0 + h as f64 * SAMPLE_UM);
    let m = THINNING_UM;
    let bin = |x: f64| (x / BIN_UM).floor() as i64;
    let (a0, a1, b0, b1) = (bin(u0 - m), bin(u1 + m), bin(v0 - m), bin(v1 + m));
    let span = [u0 - m, u1 + m, v0 - m, v1 + m];
    let mut bins = Bins {
        across: (a1 - a0 + 1) as usize,
        starts: vec![0],
        candidates: Vec::new(),
    };
    for b in b0..=b1 {
        for a in a0..=a1 {
            let found = (0..PER_BIN).filter_map(|k| candidate(seed, plan, span, [a, b, k]));
            bins.candidates.extend(found);
            bins.starts.push(bins.candidates.len());
        }
    }
    for _ in 0..2 {
        bins.thin();
    }
    let near = |c: &&Candidate| {
        c.state == State::Kept
            && c.u > u0 - REACH_UM
            && c.u < u1 + REACH_UM
            && c.v > v0 - REACH_UM
            && c.v < v1 + REACH_UM
    };
    bins.candidates
        .iter()
        .filter(near)
        .map(|c| dress(seed, plan, c))
        .collect()
}

/// Candidate `k` of bin `a`, `b`, if it lies in the span and its place can hold a cell.
fn candidate(seed: u64, plan: &PlanGrid, span: [f64; 4], [a, b, k]: [i64; 3]) -> Option<Candidate> {
    let mut dice = Dice::new(seed ^ 0xCE11, a, PER_BIN * b + k);
    let snap = |x: f64| (x * 256.0).round() / 256.0;
    let u = snap((a as f64 + f64::from(dice.next())) * BIN_UM);
    let v = snap((b as f64 + f64::from(dice.next())) * BIN_UM);
    if u < span[0] || u > span[1] || v < span[2] || v > span[3] {
        return None;
    }
    let p = plan.at(u, v);
    if p.cleft - p.crack.abs() > -2.0 || p.fat > -0.5 {
        return None;
    }
    let (kind, radius) = if p.vessel > 2.0 {
        // Some vessels are full of blood, some empty: the plan's tone at the place decides softly.
        let full = smoothstep(-0.3, 0.3, p.tone + 0.3);
        dice.chance(0.25 + 0.75 * full)
            .then_some((Kind::RedCell, 4.0))?
    } else if p.vessel > -1.0 || p.lumen > -0.5 {
        return None;
    } else if p.depth > 1.5 {
        let mature = smoothstep(15.0, 70.0, p.depth);
        if p.gland > 0.5 {
            // Tall cells stand on the base with their nuclei in one or two rows; bridges and thick walls have more.
            let basal = smoothstep(15.0, 8.0, p.depth).max(smoothstep(-9.0, -16.0, p.lumen));
            dice.chance(0.1 + 0.9 * basal)
                .then_some((Kind::Epithelial, 5.4))?
        } else {
            let crowd = 0.9 * p.tone.clamp(-1.0, 1.0);
            (Kind::Epithelial, 6.1 + 2.6 * mature - crowd + dice.next())
        }
    } else if p.depth < -1.0 {
        let lymph = p.inflamed * smoothstep(-2.0, -7.0, p.depth);
        if dice.chance(0.04 + 0.9 * lymph) {
            (Kind::Lymphocyte, 4.4 + 1.6 * dice.next())
        } else {
            dice.chance(0.13 + 0.1 * p.loose)
                .then_some((Kind::Fibroblast, 8.0 + dice.next()))?
        }
    } else {
        return None;
    };
    Some(Candidate {
        u,
        v,
        rank: hash(seed ^ 0x4A4B, a, PER_BIN * b + k),
        kind,
        radius: radius.min(MAX_RADIUS_UM as f32),
        state: State::Waiting,
    })
}

impl Bins {
    fn bin(&self, bin: usize) -> Range<usize> {
        self.starts[bin]..self.starts[bin + 1]
    }

    /// The candidates, row by row, of the bins that may hold a close one: mean radii reach at most 9 um, two bins.
    fn around(&self, bin: usize) -> impl Iterator<Item = Range<usize>> {
        let (x, y) = (bin % self.across, bin / self.across);
        let (first, last) = (x.saturating_sub(2), (x + 3).min(self.across));
        let down = (self.starts.len() - 1) / self.across;
        (y.saturating_sub(2)..(y + 3).min(down)).map(move |row| {
            let row = row * self.across;
            self.starts[row + first]..self.starts[row + last]
        })
    }

    /// One round: a waiting candidate near a kept one is dropped; one that outranks all waiting ones around it is kept.
    fn thin(&mut self) {
        let close = |a: &Candidate, b: &Candidate| {
            let (dx, dy, r) = (a.u - b.u, a.v - b.v, f64::from(0.5 * (a.radius + b.radius)));
            dx * dx + dy * dy < r * r
        };
        let waiting = |c: &Candidate| c.state == State::Waiting;
        let (mut kept, mut dropped) = (Vec::new(), Vec::new());
        for bin in 0..self.starts.len() - 1 {
            for k in self.bin(bin) {
                let c = &self.candidates[k];
                let beats = |o: &Candidate| waiting(o) && o.rank > c.rank && close(c, o);
                let beaten = || {
                    self.around(bin)
                        .any(|near| self.candidates[near].iter().any(beats))
                };
                if waiting(c) && !beaten() {
                    kept.push((bin, k));
                }
            }
        }
        for &(_, k) in &kept {
            self.candidates[k].state = State::Kept;
        }
        for &(bin, k) in &kept {
            let c = &self.candidates[k];
            for n in self.around(bin).flatten() {
                let o = &self.candidates[n];
                if waiting(o) && close(c, o) {
                    dropped.push(n);
                }
            }
        }
        for n in dropped {
            self.candidates[n].state = State::Dropped;
        }
    }
}

/// Half a turn: any direction.
const ANY: f32 = std::f32::consts::PI;

/// A direction near another.
fn spin(d: &mut Dice, axis: [f32; 2], spread: f32) -> [f32; 2] {
    let (sin, cos) = (spread * (d.next() + d.next() - 1.0)).sin_cos();
    [axis[0] * cos - axis[1] * sin, axis[0] * sin + axis[1] * cos]
}

fn across([x, y]: [f32; 2]) -> [f32; 2] {
    [-y, x]
}

/// An epithelial cell of a gland stands on its wall.
fn of_a_gland(cell: &mut Cell, d: &mut Dice, rise: [f32; 2]) {
    cell.axis = spin(d, rise, 0.35);
    cell.stretch = d.range(1.5, 2.3);
    let b = d.range(2.0, 2.8);
    cell.nucleus = [b * d.range(1.25, 1.9), b];
    cell.hematoxylin = d.range(0.85, 1.5);
    cell.eosin = d.range(0.75, 1.15);
    cell.basophil = d.range(0.05, 0.22);
}

/// An epithelial cell of a layer lies flatter the more mature it is.
fn of_a_layer(cell: &mut Cell, d: &mut Dice, flat: [f32; 2], depth: f32) {
    let mature = smoothstep(15.0, 70.0, depth);
    cell.axis = spin(d, across(flat), ANY * (1.0 - 0.75 * mature));
    cell.stretch = 1.0 + d.range(0.1, 0.45) + 1.1 * mature * d.next();
    let b = d.range(2.0, 3.3) * (1.0 - 0.22 * mature);
    cell.nucleus = [b * d.range(1.05, 1.6), b];
    cell.hematoxylin = d.range(0.6, 1.35) * (1.0 - 0.2 * mature);
    cell.eosin = d.range(0.72, 1.18) * (1.0 + 0.1 * mature);
    cell.basophil = d.range(0.04, 0.22) * (1.0 - 0.85 * mature);
    if d.chance(0.03 + 0.22 * mature) {
        cell.hole = d.range(2.4, 5.2);
        cell.nucleus = cell.nucleus.map(|r| 0.75 * r);
        cell.offset = [d.range(-1.6, 1.6), d.range(-1.6, 1.6)];
        if d.chance(0.45) {
            cell.nucleus = [0.0; 2];
        }
    }
}

fn dress(seed: u64, plan: &PlanGrid, c: &Candidate) -> Cell {
    let p = plan.at(c.u, c.v);
    let key = |x: f64| (x * 256.0) as i64;
    let mut d = Dice::new(seed ^ 0xD4E55, key(c.u), key(c.v));
    let mut cell = Cell {
        kind: c.kind,
        u: c.u,
        v: c.v,
        axis: [1.0, 0.0],
        stretch: 1.0,
        eosin: 1.0,
        basophil: 0.0,
        nucleus: [0.0; 2],
        bend: 0.0,
        offset: [0.0; 2],
        hematoxylin: 0.0,
        chromatin: 0.3,
        rim: 0.3,
        nucleolus: [0.0; 3],
        hole: 0.0,
    };
    match c.kind {
        Kind::Epithelial if p.gland > 0.5 => {
            of_a_gland(&mut cell, &mut d, plan.rise(c.u, c.v, |p| p.depth));
        }
        Kind::Epithelial => {
            of_a_layer(&mut cell, &mut d, plan.rise(c.u, c.v, |p| p.depth), p.depth);
        }
        Kind::Fibroblast => {
            cell.axis = spin(&mut d, across(plan.rise(c.u, c.v, |p| p.flow)), 0.5);
            let b = d.range(0.9, 1.9);
            cell.nucleus = [b * d.range(2.8, 6.0), b];
            cell.hematoxylin = d.range(0.6, 1.3);
            cell.bend = d.range(-0.3, 0.3);
        }
        Kind::Lymphocyte => {
            cell.axis = spin(&mut d, [1.0, 0.0], ANY);
            let b = d.range(2.3, 3.2);
            cell.nucleus = [b * d.range(1.0, 1.3), b];
            cell.hematoxylin = d.range(1.05, 1.75);
            cell.eosin = d.range(0.2, 0.5);
            cell.basophil = d.range(0.1, 0.3);
        }
        Kind::RedCell => {
            cell.axis = spin(&mut d, [1.0, 0.0], ANY);
            cell.stretch = d.range(1.0, 1.25);
            cell.eosin = d.range(0.7, 1.15);
            cell.hole = d.range(2.6, 3.3);
        }
    }
    cell.chromatin = d.range(0.3, 0.95);
    cell.rim = d.range(0.05, 0.6);
    if matches!(cell.kind, Kind::Epithelial) && d.chance(0.55) {
        let (x, y) = (d.range(-0.45, 0.45), d.range(-0.45, 0.45));
        cell.nucleolus = [
            x * cell.nucleus[0],
            y * cell.nucleus[1],
            d.range(0.45, 0.95),
        ];
    }
    cell
}
