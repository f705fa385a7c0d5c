//! Blocks of the coarser image that have structure, spread over all that both images show.

use super::matched::Matched;
use scopeservo_geometry::{Affine2, Vec2};

/// Of a region this many columns and rows of sectors give their best block each.
const SECTORS: [usize; 2] = [12, 9];
/// A block has structure when its gradients hold this many times what noise alone does to them.
const STRUCTURED: f64 = 2.0;
/// and at least this, for values from 0 to 1: less is rounding.
const LEAST: f64 = 1e-7;
/// Of a block's pixels at least this share counts.
const COUNTS: f64 = 0.15;
/// Pixels are tried for structure in steps of this.
const TRIED: usize = 3;
/// Of a large image's grid only some blocks are tried, about so many.
const MOST: usize = 1500;

/// Where a block begins, and how much structure it has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Block {
    pub(super) corner: [usize; 2],
    /// Sum of the squared gradient, without the noise's share.
    pub(super) energy: f64,
}

impl Block {
    /// Its middle.
    pub(super) fn middle(&self, side: usize) -> Vec2 {
        self.corner.map(|v| v as f64 + (side as f64 - 1.0) / 2.0)
    }
}

/// All blocks of a grid with structure that lie in both images, with a margin around them.
pub(super) fn structured(
    matched: &Matched<'_>,
    looked_from_fixed: &Affine2,
    side: usize,
    margin: usize,
) -> Vec<Block> {
    let [width, height] = matched.fixed.size();
    let noise = matched.fixed.noise_of_gradient();
    let apart = side * (width * height).div_ceil(MOST * side * side).isqrt().max(1);
    let along =
        |length: usize| (margin + 1..(length.saturating_sub(side + margin + 1))).step_by(apart);
    let mut found = Vec::new();
    for y in along(height) {
        for x in along(width) {
            let corner = [x, y];
            if !in_both(matched, looked_from_fixed, corner, side, margin) {
                continue;
            }
            let energy = energy(matched, looked_from_fixed, corner, side, noise);
            found.extend(energy.map(|energy| Block { corner, energy }));
        }
    }
    found
}

/// The best block of each sector of what they cover, in order.
pub(super) fn spread(blocks: &[Block]) -> Vec<Block> {
    if blocks.len() <= SECTORS[0] * SECTORS[1] {
        return blocks.to_vec();
    }
    let ends = |k: usize| {
        let values = || blocks.iter().map(|b| b.corner[k]);
        let (low, high) = (values().min().unwrap_or(0), values().max().unwrap_or(0));
        (low, high - low + 1)
    };
    let bounds = [ends(0), ends(1)];
    let mut best: Vec<Option<Block>> = vec![None; SECTORS[0] * SECTORS[1]];
    for block in blocks {
        let [column, row] =
            [0, 1].map(|k| (block.corner[k] - bounds[k].0) * SECTORS[k] / bounds[k].1);
        let place = &mut best[row * SECTORS[0] + column];
        if place.is_none_or(|b| block.energy > b.energy) {
            *place = Some(*block);
        }
    }
    best.into_iter().flatten().collect()
}

/// Whether a block with its margin lies in both images: a transform takes what is between its corners between theirs.
pub(super) fn in_both(
    matched: &Matched<'_>,
    looked_from_fixed: &Affine2,
    [x, y]: [usize; 2],
    side: usize,
    margin: usize,
) -> bool {
    let ends = |v: usize| [v as f64 - margin as f64, (v + side - 1 + margin) as f64];
    let ([x0, x1], [y0, y1]) = (ends(x), ends(y));
    [[x0, y0], [x1, y0], [x0, y1], [x1, y1]]
        .iter()
        .all(|&p| matched.looked.holds(looked_from_fixed.apply(p)))
}

/// How much structure a block has; `None` when too little of it counts or is more than noise.
fn energy(
    matched: &Matched<'_>,
    looked_from_fixed: &Affine2,
    [x, y]: [usize; 2],
    side: usize,
    noise: f64,
) -> Option<f64> {
    let (mut sum, mut counted, mut tried) = (0.0, 0usize, 0usize);
    for row in (y..y + side).step_by(TRIED) {
        for column in (x..x + side).step_by(TRIED) {
            tried += 1;
            let p = [column as f64, row as f64];
            if matched.is_masked() && !matched.counts(p, looked_from_fixed.apply(p)) {
                continue;
            }
            counted += 1;
            let [_, gx, gy] = matched.fixed.on_pixel(column, row).map(f64::from);
            sum += gx * gx + gy * gy;
        }
    }
    let enough = counted as f64 >= COUNTS * tried as f64;
    let structured = sum > (STRUCTURED * noise).max(LEAST) * counted as f64;
    (enough && structured).then_some(sum - noise * counted as f64)
}
