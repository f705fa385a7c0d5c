//! Evidence for a transform that does not stand on the features it was made of: blocks of pixels, each asked whether it lies where it should.
//!
//! A block agrees when of all places near the one that the transform says it correlates most there. What a wrong transform makes agree by
//! chance was measured: `cargo run --release -p scopeservo-studies --example pixels -- null`.

use super::Pictures;
use super::blocks::{Block, spread, structured};
use super::matched::{Matched, Softer};
use crate::significance::log10_nfa;
use scopeservo_geometry::{Affine2, Vec2};
use serde::{Deserialize, Serialize};

/// Side of a block, pixels of the coarser image.
const SIDE: usize = 24;
/// Places tried lie up to so far from where a block should be, pixels of the coarser image,
const AROUND: usize = 6;
/// and within so far of it is there.
const THERE: usize = 1;
/// A block's pixels are compared in steps of this: they are blurred.
const STEP: usize = 2;
/// Both are blurred by 1 2 1 along rows and columns so often: noise and what is not quite in focus count less.
const BLURS: usize = 2;
/// A block that correlates less than this agrees with nothing.
const LEAST_CORRELATION: f64 = 0.5;
/// Of the blocks under a wrong transform this share agrees at most: 0.5 % of all, 2.4 % of a pair's.
const CHANCE: f64 = 0.02;
/// It is evidence where so many agreeing blocks would come up by chance less than once in a million times,
const AGREES: f64 = -6.0;
/// and evidence against a transform where they come up each time: out of focus by 6 px a right one still has ten times as many,
const CONTRADICTS: f64 = 0.0;
/// of at least so many.
const LEAST_BLOCKS: usize = 10;
/// Blocks without features are also those that something covers. Where this share of all blocks agrees, with features or without, they are no
/// evidence against a transform: under a wrong one a fortieth does,
const SEEN: f64 = 0.5;
/// nor where this share does, all in one place, as what covers the rest leaves it: of those beside a block that agrees so many do. What is fixed to
/// the camera lies scattered.
const SEEN_IN_ONE_PLACE: f64 = 0.35;
const BESIDE_AGREE: f64 = 0.8;
/// So many are beside a block.
const BESIDE: usize = 4;

/// What the pixels say of a transform.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Judgement {
    /// More blocks agree than chance would have.
    Agrees,
    /// There are enough blocks, and no more agree than by chance.
    Contradicts,
    /// Too few blocks have structure, or too few agree for either.
    CannotTell,
}

/// A block and whether it lies where it should.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Witness {
    /// Its middle, pixels of the view.
    pub in_view: Vec2,
    /// Whether it agrees.
    pub agrees: bool,
    /// How well it correlates where it should lie.
    pub correlation: f64,
}

/// Evidence for or against a transform.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evidence {
    /// What it comes to.
    pub judgement: Judgement,
    /// Blocks that have structure and were asked.
    pub asked: usize,
    /// Those that agree.
    pub agree: usize,
    /// Whether only blocks were asked on which no feature of the fit lies.
    pub held_out: bool,
    /// log10 of how often so many agree by chance; `None` where none does.
    pub log10_chance: Option<f64>,
    /// The share of the structure that agrees, by the energy of its gradients.
    pub share: f64,
    /// Side of a block, pixels of the view.
    pub side_px: f64,
    /// All of them.
    pub blocks: Vec<Witness>,
}

/// Asks the pixels about a transform. `fitted`: where in the view the features lie that it was made of. Blocks without any of them are asked
/// alone where there are enough.
pub fn weigh(pictures: &Pictures<'_>, target_from_view: &Affine2, fitted: &[Vec2]) -> Evidence {
    let scale = target_from_view.linear.det().abs().sqrt();
    let side_px = SIDE as f64 * (1.0 / scale).max(1.0);
    let asked = asked(pictures, target_from_view);
    let covered = is_covered(&asked);
    let (free, used): (Vec<_>, Vec<_>) = asked.into_iter().partition(|(witness, _)| {
        let near = |p: &Vec2| {
            let off = [0, 1].map(|k| (p[k] - witness.in_view[k]).abs());
            off[0].max(off[1]) <= side_px / 2.0
        };
        !fitted.iter().any(near)
    });
    let held_out = free.len() >= LEAST_BLOCKS;
    let counted = match held_out {
        true => free,
        false => free.into_iter().chain(used).collect(),
    };
    let agree = counted.iter().filter(|(w, _)| w.agrees).count();
    let energy = |all: &mut dyn Iterator<Item = &(Witness, f64)>| all.map(|w| w.1).sum::<f64>();
    let agreeing = energy(&mut counted.iter().filter(|(w, _)| w.agrees));
    let log10_chance = (agree > 0).then(|| log10_nfa(0, counted.len(), agree, CHANCE));
    Evidence {
        judgement: match judgement(counted.len(), log10_chance) {
            Judgement::Contradicts if covered => Judgement::CannotTell,
            judgement => judgement,
        },
        asked: counted.len(),
        agree,
        held_out,
        log10_chance,
        share: agreeing / energy(&mut counted.iter()).max(f64::MIN_POSITIVE),
        side_px,
        blocks: counted.into_iter().map(|(witness, _)| witness).collect(),
    }
}

/// Whether blocks that do not agree may be covered by something.
fn is_covered(asked: &[(Witness, f64)]) -> bool {
    let agree: Vec<&Witness> = asked.iter().map(|a| &a.0).filter(|w| w.agrees).collect();
    let share = agree.len() as f64 / asked.len().max(1) as f64;
    if !(SEEN_IN_ONE_PLACE..SEEN).contains(&share) {
        return share >= SEEN;
    }
    let beside = |of: &Witness| {
        let far = |w: &Witness| {
            let off = [0, 1].map(|k| w.in_view[k] - of.in_view[k]);
            off[0].hypot(off[1])
        };
        let mut all: Vec<(f64, bool)> = asked.iter().map(|(w, _)| (far(w), w.agrees)).collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        // The nearest is the block itself.
        let others = all.iter().skip(1).take(BESIDE);
        others.filter(|(_, agrees)| *agrees).count()
    };
    let all: usize = agree.iter().map(|w| beside(w)).sum();
    all as f64 >= BESIDE_AGREE * (BESIDE * agree.len()) as f64
}

fn judgement(asked: usize, log10_chance: Option<f64>) -> Judgement {
    let log10_chance = log10_chance.unwrap_or(f64::INFINITY);
    match asked {
        _ if log10_chance < AGREES => Judgement::Agrees,
        LEAST_BLOCKS.. if log10_chance > CONTRADICTS => Judgement::Contradicts,
        _ => Judgement::CannotTell,
    }
}

/// All blocks, each with its structure.
fn asked(pictures: &Pictures<'_>, target_from_view: &Affine2) -> Vec<(Witness, f64)> {
    let Some(matched) = Matched::new(pictures, target_from_view, Softer::default()) else {
        return Vec::new();
    };
    let Some(at) = matched.looked_from_fixed(target_from_view) else {
        return Vec::new();
    };
    let mut window = Window::default();
    spread(&structured(&matched, &at, SIDE, AROUND + BLURS))
        .iter()
        .filter_map(|block| Some((window.ask(&matched, &at, block)?, block.energy)))
        .collect()
}

/// What lies around a block in the finer image, on the grid of the coarser one.
#[derive(Default)]
struct Window {
    value: Vec<f32>,
    /// The block itself, with what its blur reaches.
    own: Vec<f32>,
    /// Of the block's pixels that count: where they lie in the window, and their values.
    index: Vec<usize>,
    block: Vec<f32>,
}

/// Sides of the window and of the block, with what their blur reaches.
const WIDE: usize = SIDE + 2 * (AROUND + BLURS);
const OWN: usize = SIDE + 2 * BLURS;

impl Window {
    /// `None` where nothing of it counts.
    fn ask(&mut self, matched: &Matched<'_>, at: &Affine2, block: &Block) -> Option<Witness> {
        let [x, y] = block.corner;
        let [[along_x, _], [along_y, _]] = at.linear.0;
        self.value.resize(WIDE * WIDE, 0.0);
        let [left, top] = [x, y].map(|v| v as f64 - (AROUND + BLURS) as f64);
        for (row, values) in self.value.chunks_exact_mut(WIDE).enumerate() {
            let from = at.apply([left, top + row as f64]);
            matched.looked.along(from, [along_x, along_y], values);
        }
        soften(&mut self.value, WIDE);
        self.own.clear();
        for row in y - BLURS..y - BLURS + OWN {
            let columns = x - BLURS..x - BLURS + OWN;
            self.own
                .extend(columns.map(|column| matched.fixed.on_pixel(column, row)[0]));
        }
        soften(&mut self.own, OWN);
        self.index.clear();
        self.block.clear();
        for row in (0..SIDE).step_by(STEP) {
            for column in (0..SIDE).step_by(STEP) {
                let p = [(x + column) as f64, (y + row) as f64];
                if !matched.is_masked() || matched.counts(p, at.apply(p)) {
                    self.index.push((row + BLURS) * WIDE + column + BLURS);
                    self.block
                        .push(self.own[(row + BLURS) * OWN + column + BLURS]);
                }
            }
        }
        let n = self.block.len() as f32;
        let mean = self.block.iter().sum::<f32>() / n;
        self.block.iter_mut().for_each(|v| *v -= mean);
        let energy: f32 = self.block.iter().map(|v| v * v).sum();
        if energy <= 0.0 || !energy.is_finite() {
            return None;
        }
        let middle = block.middle(SIDE);
        let here = self.correlation(energy, [AROUND; 2]);
        Some(Witness {
            in_view: matched.in_view(middle, at.apply(middle)),
            agrees: self.is_there(energy),
            correlation: f64::from(here),
        })
    }

    /// Whether of all places it correlates most where it should lie.
    fn is_there(&self, energy: f32) -> bool {
        let (mut there, mut elsewhere) = (-1.0f32, -1.0f32);
        for y in 0..=2 * AROUND {
            for x in 0..=2 * AROUND {
                let correlation = self.correlation(energy, [x, y]);
                let near = x.abs_diff(AROUND).max(y.abs_diff(AROUND)) <= THERE;
                let best = if near { &mut there } else { &mut elsewhere };
                *best = best.max(correlation);
            }
        }
        there > elsewhere && f64::from(there) >= LEAST_CORRELATION
    }

    /// With what lies so far right of and below the window's corner.
    fn correlation(&self, energy: f32, [x, y]: [usize; 2]) -> f32 {
        let values = &self.value[y * WIDE + x..];
        let (mut sum, mut square, mut product) = (0.0f32, 0.0f32, 0.0f32);
        let first = values[0];
        for (&k, b) in self.index.iter().zip(&self.block) {
            let v = values[k] - first;
            sum += v;
            square += v * v;
            product += v * b;
        }
        let variance = square - sum * sum / self.index.len() as f32;
        match variance > 1e-12 {
            true => product / (variance * energy).sqrt(),
            false => 0.0,
        }
    }
}

/// Blurs a square by 1 2 1 along rows and columns; its edge is left as it is.
fn soften(values: &mut [f32], side: usize) {
    let blur = |a: f32, b: f32, c: f32| 0.25 * (a + c) + 0.5 * b;
    for _ in 0..BLURS {
        for row in values.chunks_exact_mut(side) {
            let mut before = row[0];
            for x in 1..side - 1 {
                let here = row[x];
                row[x] = blur(before, here, row[x + 1]);
                before = here;
            }
        }
        let mut before = values[..side].to_vec();
        for y in 1..side - 1 {
            for x in 0..side {
                let (k, here) = (y * side + x, values[y * side + x]);
                values[k] = blur(before[x], here, values[k + side]);
                before[x] = here;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_blocks_tell_nothing_and_many_decide() {
        let of = |asked, agree| {
            let chance = (agree > 0).then(|| log10_nfa(0, asked, agree, CHANCE));
            judgement(asked, chance)
        };
        assert_eq!(of(0, 0), Judgement::CannotTell);
        assert_eq!(of(5, 0), Judgement::CannotTell);
        assert_eq!(of(40, 0), Judgement::Contradicts);
        assert_eq!(of(40, 2), Judgement::Contradicts);
        assert_eq!(of(40, 5), Judgement::CannotTell);
        assert_eq!(of(40, 24), Judgement::Agrees);
        assert_eq!(of(12, 11), Judgement::Agrees);
    }
}
