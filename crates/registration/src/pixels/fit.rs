//! One step of the inverse compositional fit, in blocks whose gain and offset are free.

use super::blocks::{Block, in_both};
use super::matched::Matched;
use super::tone::Tone;
use scopeservo_geometry::{Affine2, Mat2, Normal, Vec2, cholesky_inverse};

/// Tukey's constant: 95 % efficient where errors are normal.
const TUKEY: f32 = 4.685;
/// Standard deviation of normal errors from the median of their sizes.
const MAD: f32 = 1.4826;
/// A block that correlates less than this shows something else,
const LEAST_CORRELATION: f64 = 0.4;
/// and so does one whose gain is so many times more or less than the usual.
const GAIN: f64 = 3.0;
/// The usual residual is found from each so many-th pixel.
const EACH: usize = 5;

/// After so many steps a block that does not follow is left out for good, and so is a pixel that is clipped.
const SETTLED: usize = 3;

/// Unknowns: shift along x and y, stretch and turn, all in pixels of the coarser image; the last two at `radius` from the middle.
pub(super) const UNKNOWNS: usize = 4;

/// Blocks of the coarser image, pixel after pixel.
pub(super) struct Template {
    pub(super) blocks: Vec<Block>,
    pub(super) side: usize,
    /// What stretching and turning are about.
    pub(super) middle: Vec2,
    radius: f64,
    value: Vec<f32>,
    gradient: Vec<[f32; 2]>,
    counts: Vec<bool>,
}

/// What a block says of itself.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Agreement {
    gain: f64,
    mean: [f64; 2],
    pub(super) correlation: f64,
    /// Whether it takes part.
    pub(super) follows: bool,
}

/// The finer image, looked up for a transform.
#[derive(Default)]
pub(super) struct Look {
    value: Vec<f32>,
    weight: Vec<f32>,
    /// Which blocks lie in the image, and which pixels are masked out or clipped.
    seen: Vec<bool>,
    lost: Vec<bool>,
    pub(super) agreements: Vec<Agreement>,
    steps: usize,
    stepped: bool,
}

/// What a step says.
pub(super) struct Step {
    /// Of each block that takes part.
    pub(super) parts: Vec<Normal<UNKNOWNS, 1>>,
    /// The unknowns.
    pub(super) change: [f64; UNKNOWNS],
    /// How long the step is in standard deviations, as far as the noise of pixels tells.
    pub(super) sigmas: f64,
}

impl Template {
    pub(super) fn new(
        matched: &Matched<'_>,
        looked_from_fixed: &Affine2,
        blocks: Vec<Block>,
        side: usize,
    ) -> Self {
        let size = blocks.len() * side * side;
        let (mut value, mut gradient) = (Vec::with_capacity(size), Vec::with_capacity(size));
        let mut counts = Vec::with_capacity(size);
        for block in &blocks {
            let [x, y] = block.corner;
            for (row, column) in (y..y + side).flat_map(|r| (x..x + side).map(move |c| (r, c))) {
                let [v, gx, gy] = matched.fixed.on_pixel(column, row);
                let p = [column as f64, row as f64];
                let free = !matched.is_masked() || matched.counts(p, looked_from_fixed.apply(p));
                value.push(v);
                gradient.push([gx, gy]);
                counts.push(free && !matched.fixed.is_clipped(v));
            }
        }
        let (middle, radius) = extent(&blocks, side);
        Self {
            blocks,
            side,
            middle,
            radius,
            value,
            gradient,
            counts,
        }
    }

    fn pixels(&self, block: usize) -> std::ops::Range<usize> {
        let area = self.side * self.side;
        block * area..(block + 1) * area
    }

    /// The same as another image would show it.
    pub(super) fn toned(&self, tone: &Tone) -> (Vec<f32>, Vec<[f32; 2]>) {
        let toned = self.value.iter().map(|&v| tone.at(v));
        toned
            .zip(&self.gradient)
            .map(|([to, slope], g)| (to, g.map(|g| slope * g)))
            .unzip()
    }

    /// Takes other values and gradients, and gives its own.
    pub(super) fn exchange(
        &mut self,
        (value, gradient): (Vec<f32>, Vec<[f32; 2]>),
    ) -> (Vec<f32>, Vec<[f32; 2]>) {
        let kept = (
            std::mem::take(&mut self.value),
            std::mem::take(&mut self.gradient),
        );
        (self.value, self.gradient) = (value, gradient);
        kept
    }

    /// Looks up the finer image under a transform. Weights stay from look to look.
    pub(super) fn look(&self, matched: &Matched<'_>, looked_from_fixed: &Affine2, look: &mut Look) {
        look.value.resize(self.value.len(), 0.0);
        if look.weight.len() != self.value.len() {
            look.weight = vec![1.0; self.value.len()];
            look.lost = vec![false; self.value.len()];
        }
        look.seen.clear();
        let [[along_x, _], [along_y, _]] = looked_from_fixed.linear.0;
        for (b, block) in self.blocks.iter().enumerate() {
            let [x, y] = block.corner;
            let seen = in_both(matched, looked_from_fixed, block.corner, self.side, 0);
            look.seen.push(seen);
            if !seen {
                continue;
            }
            let range = self.pixels(b);
            let values = &mut look.value[range.clone()];
            for (row, values) in values.chunks_exact_mut(self.side).enumerate() {
                let from = looked_from_fixed.apply([x as f64, (y + row) as f64]);
                matched.looked.along(from, [along_x, along_y], values);
            }
            for k in range.filter(|_| look.steps <= SETTLED) {
                look.lost[k] = !self.counts[k] || matched.looked.is_clipped(look.value[k]);
                look.weight[k] = if look.lost[k] { 0.0 } else { look.weight[k] };
            }
        }
        self.agree(look);
    }

    /// How the blocks agree with what was looked up.
    pub(super) fn agree(&self, look: &mut Look) {
        let before = std::mem::take(&mut look.agreements);
        for (b, &seen) in look.seen.iter().enumerate() {
            let range = self.pixels(b);
            let sums = || {
                Sums::of(
                    &self.value[range.clone()],
                    &look.value[range.clone()],
                    &look.weight[range.clone()],
                )
            };
            let agreement = if seen {
                sums().agreement()
            } else {
                Agreement::default()
            };
            look.agreements.push(agreement);
        }
        follow(&self.blocks, &mut look.agreements);
        look.steps += usize::from(look.stepped);
        look.stepped = false;
        if look.steps > SETTLED {
            // Who comes and goes keeps the rest from coming to rest.
            for (now, before) in look.agreements.iter_mut().zip(before) {
                now.follows &= before.follows;
            }
        }
    }

    /// All pixels alike again, as before the first step.
    pub(super) fn anew(&self, matched: &Matched<'_>, looked_from_fixed: &Affine2, look: &mut Look) {
        look.weight.fill(1.0);
        look.steps = 0;
        self.look(matched, looked_from_fixed, look);
    }

    /// Mean correlation of all blocks by their structure.
    pub(super) fn correlation(&self, look: &Look) -> f64 {
        let both = || self.blocks.iter().zip(&look.agreements);
        let sum: f64 = both().map(|(b, a)| b.energy * a.correlation.max(0.0)).sum();
        sum / both().map(|(b, _)| b.energy).sum::<f64>()
    }

    /// The share of the structure that follows.
    pub(super) fn share(&self, look: &Look) -> f64 {
        let both = || self.blocks.iter().zip(&look.agreements);
        let sum: f64 = both()
            .filter(|(_, a)| a.follows)
            .map(|(b, _)| b.energy)
            .sum();
        sum / both().map(|(b, _)| b.energy).sum::<f64>()
    }

    /// Pairs of values where both images show the same, for a tone curve.
    pub(super) fn pairs(&self, look: &Look) -> Vec<[f32; 2]> {
        let following = (0..self.blocks.len()).filter(|&b| look.agreements[b].follows);
        let pixels = following.flat_map(|b| self.pixels(b).step_by(EACH));
        pixels
            .filter(|&k| look.weight[k] > 0.0)
            .map(|k| [self.value[k], look.value[k]])
            .collect()
    }

    /// The usual size of a residual, as a standard deviation.
    pub(super) fn scale(&self, look: &Look) -> f32 {
        let mut sizes = Vec::new();
        for (b, a) in look
            .agreements
            .iter()
            .enumerate()
            .filter(|(_, a)| a.follows)
        {
            let pixels = self.pixels(b).step_by(EACH);
            let pixels = pixels.filter(|&k| self.counts[k]);
            sizes.extend(pixels.map(|k| a.residual(self.value[k], look.value[k]).abs()));
        }
        if sizes.is_empty() {
            return 0.0;
        }
        let middle = sizes.len() / 2;
        MAD * *sizes.select_nth_unstable_by(middle, f32::total_cmp).1
    }

    /// One step. `None` when the blocks that follow do not determine it.
    pub(super) fn step(&self, look: &mut Look) -> Option<Step> {
        look.stepped = true;
        let scale = self.scale(look).max(1e-6);
        let cut = TUKEY * scale;
        let mut parts = Vec::with_capacity(self.blocks.len());
        let (mut whole, mut right) = ([[0.0; UNKNOWNS]; UNKNOWNS], [0.0; UNKNOWNS]);
        for b in 0..self.blocks.len() {
            let agreement = look.agreements[b];
            if !agreement.follows {
                continue;
            }
            for k in self.pixels(b) {
                let off = agreement.residual(self.value[k], look.value[k]) / cut;
                let inside = (1.0 - off * off).max(0.0);
                look.weight[k] = if look.lost[k] { 0.0 } else { inside * inside };
            }
            let part = self.part(b, &agreement, look);
            for (whole, part) in whole.iter_mut().flatten().zip(part.0.iter().flatten()) {
                *whole += part;
            }
            for (right, part) in right.iter_mut().zip(part.1[0]) {
                *right += part;
            }
            parts.push(part);
        }
        let inverse = cholesky_inverse(&whole)?;
        let change: [f64; UNKNOWNS] =
            inverse.map(|row| row.iter().zip(right).map(|(a, b)| a * b).sum());
        let gained: f64 = change.iter().zip(right).map(|(a, b)| a * b).sum();
        Some(Step {
            parts,
            change,
            sigmas: gained.max(0.0).sqrt() / f64::from(scale),
        })
    }

    /// A block's normal matrix and right side, its own gain and offset eliminated.
    fn part(&self, b: usize, agreement: &Agreement, look: &Look) -> Normal<UNKNOWNS, 1> {
        // Derivatives by the unknowns, by gain and by offset, and the residual.
        const ALL: usize = UNKNOWNS + 3;
        let mut sums = [[0.0f64; ALL]; ALL];
        let (gain, mean) = (agreement.gain as f32, agreement.mean[0] as f32);
        let [x, y] = self.blocks[b].corner;
        let first = self.pixels(b).start;
        let per = 1.0 / self.radius;
        for row in 0..self.side {
            let mut of_row = [[0.0f32; ALL]; ALL];
            let v = (((y + row) as f64 - self.middle[1]) * per) as f32;
            for column in 0..self.side {
                let k = first + row * self.side + column;
                let weight = look.weight[k];
                let u = (((x + column) as f64 - self.middle[0]) * per) as f32;
                let [gx, gy] = self.gradient[k].map(|g| gain * g);
                let residual = agreement.residual(self.value[k], look.value[k]);
                let all = [
                    gx,
                    gy,
                    gx * u + gy * v,
                    gy * u - gx * v,
                    self.value[k] - mean,
                    1.0,
                    residual,
                ];
                for i in 0..ALL {
                    let weighted = weight * all[i];
                    for j in i..ALL {
                        of_row[i][j] += weighted * all[j];
                    }
                }
            }
            for (sums, row) in sums.iter_mut().flatten().zip(of_row.iter().flatten()) {
                *sums += f64::from(*row);
            }
        }
        eliminate(&mut sums)
    }

    /// How far a point of the coarser image goes for a change of the unknowns: an affine map without the identity.
    pub(super) fn way(&self, change: &[f64; UNKNOWNS]) -> Affine2 {
        let [x, y, stretch, turn] = *change;
        let linear = Mat2([[stretch, -turn], [turn, stretch]]) * (1.0 / self.radius);
        let about = linear * self.middle;
        Affine2 {
            linear,
            offset: [x - about[0], y - about[1]],
        }
    }

    /// The corners of what the blocks cover.
    pub(super) fn corners(&self) -> [Vec2; 4] {
        let all = || self.blocks.iter().map(|b| b.middle(self.side));
        let [low, high] = [f64::min as fn(f64, f64) -> f64, f64::max]
            .map(|end| all().fold(self.middle, |a, b| [end(a[0], b[0]), end(a[1], b[1])]));
        [low, [high[0], low[1]], [low[0], high[1]], high]
    }
}

impl Agreement {
    fn residual(&self, fixed: f32, looked: f32) -> f32 {
        let [mean_fixed, mean_looked] = self.mean.map(|m| m as f32);
        (looked - mean_looked) - self.gain as f32 * (fixed - mean_fixed)
    }
}

/// Weighted sums of a block.
#[derive(Default)]
struct Sums {
    weight: f64,
    first: [f64; 2],
    second: [f64; 3],
}

impl Sums {
    fn of(fixed: &[f32], looked: &[f32], weights: &[f32]) -> Self {
        let mut all = Self::default();
        // Less is lost about a value that occurs.
        let (f0, l0) = (fixed[0], looked[0]);
        for ((f, l), w) in fixed.iter().zip(looked).zip(weights) {
            let [f, l, w] = [f - f0, l - l0, *w].map(f64::from);
            all.weight += w;
            all.first[0] += w * f;
            all.first[1] += w * l;
            all.second[0] += w * f * f;
            all.second[1] += w * f * l;
            all.second[2] += w * l * l;
        }
        if all.weight > 0.0 {
            let [f, l] = all.first;
            let [ff, fl, ll] = all.second;
            let w = all.weight;
            all.second = [ff - f * f / w, fl - f * l / w, ll - l * l / w];
            all.first = [f / w + f64::from(f0), l / w + f64::from(l0)];
        }
        all
    }

    fn agreement(&self) -> Agreement {
        let [ff, fl, ll] = self.second;
        if !(self.weight > 0.0 && ff > 0.0 && ll > 0.0) {
            return Agreement::default();
        }
        Agreement {
            gain: fl / ff,
            mean: self.first,
            correlation: fl / (ff * ll).sqrt(),
            follows: false,
        }
    }
}

/// Which blocks take part: those that correlate, with about the gain of the others.
fn follow(blocks: &[Block], agreements: &mut [Agreement]) {
    let mut gains: Vec<(f64, f64)> = blocks
        .iter()
        .zip(agreements.iter())
        .filter(|(_, a)| a.correlation >= LEAST_CORRELATION)
        .map(|(b, a)| (a.gain, b.energy))
        .collect();
    gains.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = gains.iter().map(|g| g.1).sum::<f64>() / 2.0;
    let mut sum = 0.0;
    let usual = gains.iter().find(|(_, energy)| {
        sum += energy;
        sum >= half
    });
    let usual = usual.map_or(1.0, |g| g.0);
    for a in agreements {
        let like = a.gain >= usual / GAIN && a.gain <= usual * GAIN;
        a.follows = a.correlation >= LEAST_CORRELATION && like;
    }
}

/// Takes gain and offset out of a block's sums (upper triangle): what they explain is left to nobody.
fn eliminate<const ALL: usize>(sums: &mut [[f64; ALL]; ALL]) -> Normal<UNKNOWNS, 1> {
    for pivot in [UNKNOWNS + 1, UNKNOWNS] {
        let d = sums[pivot][pivot];
        if d <= 0.0 {
            continue;
        }
        let column: [f64; ALL] = std::array::from_fn(|i| match i <= pivot {
            true => sums[i][pivot],
            false => sums[pivot][i],
        });
        for i in 0..ALL {
            for j in i..ALL {
                sums[i][j] -= column[i] * column[j] / d;
            }
        }
        // Done with: it takes nothing away again.
        sums[pivot].fill(0.0);
        sums.iter_mut().for_each(|row| row[pivot] = 0.0);
    }
    let normal = std::array::from_fn(|i| std::array::from_fn(|j| sums[i.min(j)][i.max(j)]));
    let right = std::array::from_fn(|i| sums[i][UNKNOWNS + 2]);
    (normal, [right])
}

/// Middle of the blocks by their structure, and how far they reach from it in the mean.
fn extent(blocks: &[Block], side: usize) -> (Vec2, f64) {
    let total: f64 = blocks.iter().map(|b| b.energy).sum();
    let middles = || blocks.iter().map(|b| (b.middle(side), b.energy / total));
    let middle = middles().fold([0.0; 2], |m, (p, w)| [m[0] + w * p[0], m[1] + w * p[1]]);
    let off_sq = |p: Vec2| (p[0] - middle[0]).powi(2) + (p[1] - middle[1]).powi(2);
    let spread: f64 = middles().map(|(p, w)| w * off_sq(p)).sum();
    (middle, spread.sqrt().max(side as f64))
}
