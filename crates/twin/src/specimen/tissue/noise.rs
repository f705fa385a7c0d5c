//! Noise without a period: every value is a hash of its place and a seed.

use std::{array, iter};

/// Mixes three numbers into 32 well-stirred bits (the finaliser of SplitMix64).
#[inline]
pub(super) fn hash(seed: u64, i: i64, j: i64) -> u32 {
    let mut z = seed
        .wrapping_add((i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15))
        .wrapping_add((j as u64).wrapping_mul(0xD1B5_4A32_D192_ED03));
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    (z >> 32) as u32
}

/// 0 to 1 from the bits of a hash.
#[inline]
pub(super) fn unit(h: u32) -> f32 {
    (h >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// A stream of numbers 0 to 1 that belongs to one thing at one place.
pub(super) struct Dice {
    seed: u64,
    count: i64,
}

impl Dice {
    pub(super) fn new(seed: u64, i: i64, j: i64) -> Self {
        let high = u64::from(hash(seed, i, j));
        let low = u64::from(hash(seed ^ 0x5851_F42D, j, i));
        Self {
            seed: high << 32 | low,
            count: 0,
        }
    }

    pub(super) fn next(&mut self) -> f32 {
        self.count += 1;
        unit(hash(self.seed, self.count, 77))
    }

    pub(super) fn range(&mut self, from: f32, to: f32) -> f32 {
        from + (to - from) * self.next()
    }

    pub(super) fn chance(&mut self, p: f32) -> bool {
        self.next() < p
    }
}

/// 0 below `a`, 1 above `b`, smooth between; falling if `a > b`.
#[inline(always)]
pub(super) fn smoothstep(a: f32, b: f32, x: f32) -> f32 {
    // The reciprocal of constant ends is a constant; a division of every sample would not be.
    let t = ((x - a) * (1.0 / (b - a))).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// The larger and the lesser of two numbers of which neither is NaN, which the library's look for.
#[inline(always)]
pub(super) fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
pub(super) fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Length of a vector of moderate size.
#[inline(always)]
pub(super) fn norm(x: f32, y: f32) -> f32 {
    (x * x + y * y).sqrt()
}

/// Largest whole number not above `x`. The library's `floor` is a call on the oldest x86-64.
#[inline(always)]
pub(super) fn floor_i64(x: f64) -> i64 {
    let k = x as i64;
    k - i64::from(x < k as f64)
}

#[inline(always)]
fn floor_i32(x: f32) -> i32 {
    let k = x as i32;
    k - i32::from(x < k as f32)
}

#[inline]
pub(super) fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// The cell of a lattice that was looked at last, and the directions at its corners. Neighbouring places mostly share it.
#[derive(Clone, Copy, Default)]
pub(super) struct Corners {
    cell: Option<[i64; 2]>,
    directions: [[f32; 2]; 4],
}

/// Gradient noise (Perlin, *Improving Noise*, SIGGRAPH 2002) of wavelength `wave_um`, about -1 to 1, standard deviation
/// about 0.35. The lattice is turned by an angle of its own for every seed. `corners` are those of the same seed.
pub(super) fn gradient(seed: u64, wave_um: f64, u: f64, v: f64, corners: &mut Corners) -> f32 {
    let (sin, cos) = turn(seed);
    let (x, y) = ((u * cos - v * sin) / wave_um, (u * sin + v * cos) / wave_um);
    let (i, j) = (floor_i64(x), floor_i64(y));
    if corners.cell != Some([i, j]) {
        // Sixteen directions are enough to hide the lattice.
        corners.directions = [[0, 0], [1, 0], [0, 1], [1, 1]]
            .map(|[di, dj]| DIRECTIONS[(hash(seed, i + di, j + dj) >> 28) as usize]);
        corners.cell = Some([i, j]);
    }
    let (fx, fy) = ((x - i as f64) as f32, (y - j as f64) as f32);
    let [a, b, c, d] = corners.directions;
    let corner = |[gx, gy]: [f32; 2], di: f32, dj: f32| gx * (fx - di) + gy * (fy - dj);
    let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (sx, sy) = (fade(fx), fade(fy));
    1.5 * mix(
        mix(corner(a, 0.0, 0.0), corner(b, 1.0, 0.0), sx),
        mix(corner(c, 0.0, 1.0), corner(d, 1.0, 1.0), sx),
        sy,
    )
}

fn turn(seed: u64) -> (f64, f64) {
    let [x, y] = DIRECTIONS[(seed % 16) as usize];
    (f64::from(y), f64::from(x))
}

/// Unit vectors every 22.5 degrees, starting off the axes.
const DIRECTIONS: [[f32; 2]; 16] = {
    const A: f32 = 0.980_785_3;
    const B: f32 = 0.831_469_6;
    const C: f32 = 0.555_570_24;
    const D: f32 = 0.195_090_32;
    [
        [A, D],
        [B, C],
        [C, B],
        [D, A],
        [-D, A],
        [-C, B],
        [-B, C],
        [-A, D],
        [-A, -D],
        [-B, -C],
        [-C, -B],
        [-D, -A],
        [D, -A],
        [C, -B],
        [B, -C],
        [A, -D],
    ]
};

/// Value noise in three coordinates given in wavelengths, -1 to 1. One of them may run fast along a field and the
/// others slowly across the plane: that draws fibres along the field's contours.
pub(super) struct Strands {
    /// Wavelengths per unit of the first coordinate.
    per_unit: f32,
    /// The first node along it, and how many there are along the first two.
    first: f32,
    count: [usize; 2],
    /// Where the columns and rows of the window lie between nodes: the node before, counted from the first, and how far.
    columns: Vec<(usize, f32)>,
    rows: Vec<(usize, f32)>,
    /// The values at a node and at those below, to the right, and below that. The first coordinate runs fastest, then
    /// the second.
    nodes: Vec<[f32; 4]>,
}

impl Strands {
    /// For a window whose columns and rows lie at `u` and `v`, rising, and a field between the two `ends`.
    pub(super) fn new(
        seed: u64,
        waves: [f32; 3],
        ends: [f32; 2],
        u: impl Iterator<Item = f32>,
        v: impl Iterator<Item = f32>,
    ) -> Self {
        let [per_unit, per_u, per_v] = waves.map(|wave| 1.0 / wave);
        let [k0, k1] = ends.map(|w| floor_i32(w * per_unit));
        let (i0, columns) = between(u.map(|u| u * per_u));
        let (j0, rows) = between(v.map(|v| v * per_v));
        let count = |places: &[(usize, f32)]| places.last().map_or(0, |p| p.0 + 1);
        let (along, across) = ((k1 - k0) as usize + 2, count(&columns));
        let nodes = (0..count(&rows))
            .flat_map(|j| (0..across).flat_map(move |i| (0..along).map(move |k| [k, i, j])))
            .map(|[k, i, j]| {
                [[0, 0], [0, 1], [1, 0], [1, 1]].map(|[di, dj]| {
                    let [i, j] =
                        [(i0, i + di), (j0, j + dj)].map(|(a, b)| a.wrapping_add(b as i32));
                    node(seed, [k0 + k as i32, i, j])
                })
            })
            .collect();
        Self {
            per_unit,
            first: k0 as f32,
            count: [along, across],
            columns,
            rows,
            nodes,
        }
    }

    /// The noise where the field has these values, from column `column` of row `row` on.
    pub(super) fn block<const N: usize>(
        &self,
        field: &[f32; N],
        column: usize,
        row: usize,
    ) -> [f32; N] {
        let [along, across] = self.count;
        let (j, ty) = self.rows[row];
        let columns = &self.columns[column..column + N];
        let w = field.map(|f| f * self.per_unit);
        let k = w.map(floor_small);
        let node = k.map(|k| bits_of_whole(k - self.first));
        // At this and the next node along the field.
        let (mut a, mut b) = ([0.0; N], [0.0; N]);
        for (s, &(i, tx)) in columns.iter().enumerate() {
            let at = (j * across + i) * along + node[s] as usize;
            let (near, far) = (self.nodes[at], self.nodes[at + 1]);
            let left = [near[0], far[0], near[1], far[1]];
            let right = [near[2], far[2], near[3], far[3]];
            let across: [f32; 4] = array::from_fn(|n| mix(left[n], right[n], tx));
            a[s] = mix(across[0], across[2], ty);
            b[s] = mix(across[1], across[3], ty);
        }
        array::from_fn(|s| mix(a[s], b[s], ease(w[s] - k[s])))
    }
}

/// The value at a node, -1 to 1.
fn node(seed: u64, [k, i, j]: [i32; 3]) -> f32 {
    let mut h = (seed as u32)
        .wrapping_add((k as u32).wrapping_mul(0x9E37_79B1))
        .wrapping_add((i as u32).wrapping_mul(0x85EB_CA77))
        .wrapping_add((j as u32).wrapping_mul(0xC2B2_AE3D));
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    h ^= h >> 15;
    (h as i32) as f32 * (1.0 / 2_147_483_648.0)
}

/// Adding this to a small number leaves the nearest whole number in the low bits. Unlike a checked conversion it can be
/// done several at once on any x86-64.
pub(super) const ROUND: f32 = 12_582_912.0;

/// Largest whole number not above a small `x`, several at once.
#[inline(always)]
fn floor_small(x: f32) -> f32 {
    let nearest = (x + ROUND) - ROUND;
    if nearest > x { nearest - 1.0 } else { nearest }
}

/// A small whole number, not negative, as an integer.
#[inline(always)]
fn bits_of_whole(x: f32) -> u32 {
    (x + ROUND).to_bits() - ROUND.to_bits()
}

#[inline(always)]
fn ease(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

/// The node before the first of these rising places, and for each the node before it, counted from there, and how far
/// it lies on the way to the next.
fn between(places: impl Iterator<Item = f32>) -> (i32, Vec<(usize, f32)>) {
    let mut places = places.peekable();
    let first = floor_i32(places.peek().copied().unwrap_or(0.0));
    let between = places.map(|x| {
        let i = floor_i32(x);
        ((i - first) as usize, ease(x - i as f32))
    });
    (first, between.collect())
}

/// More than the noise of a [`Lattice`] is anywhere, either way.
pub(super) const MOST: f32 = 1.01 * GAIN;

/// A B-spline of white nodes keeps little variance; this brings the standard deviation to about 0.5.
const GAIN: f32 = 1.6;

/// Value noise on every sample of a window, smoothly interpolated between nodes `pitch` samples apart.
pub(super) struct Lattice {
    pitch: usize,
    width: usize,
    /// Rows of the window's first sample below the first node.
    off: usize,
    weights: Vec<[f32; 3]>,
    /// Interpolated along the rows, at the nodes' own rows.
    across: Vec<f32>,
}

impl Lattice {
    /// Column 0, row 0 of the window is sample (`i0`, `j0`) of the world.
    pub(super) fn new(seed: u64, pitch: usize, [i0, j0]: [i64; 2], [w, h]: [usize; 2]) -> Self {
        let p = pitch as i64;
        let (a0, b0) = (i0.div_euclid(p), j0.div_euclid(p));
        let (off_i, off_j) = (i0.rem_euclid(p) as usize, j0.rem_euclid(p) as usize);
        // A quadratic B-spline spans three nodes; it has no axis-aligned ridges, as linear interpolation would.
        let weights: Vec<[f32; 3]> = (0..pitch)
            .map(|k| {
                let t = (k as f32 + 0.5) / pitch as f32;
                [
                    0.5 * (1.0 - t) * (1.0 - t),
                    0.75 - (t - 0.5) * (t - 0.5),
                    0.5 * t * t,
                ]
            })
            .collect();
        let (columns, rows) = (
            (off_i + w).div_ceil(pitch) + 2,
            (off_j + h).div_ceil(pitch) + 2,
        );
        let mut across = vec![0.0; rows * w];
        let mut nodes = vec![0.0; columns];
        for (r, line) in across.chunks_exact_mut(w).enumerate() {
            for (c, node) in nodes.iter_mut().enumerate() {
                *node = 2.0 * unit(hash(seed, a0 + c as i64 - 1, b0 + r as i64 - 1)) - 1.0;
            }
            let (head, tail) = line.split_at_mut((pitch - off_i).min(w));
            let spans = iter::once((head, &weights[off_i..]))
                .chain(tail.chunks_mut(pitch).map(|span| (span, &weights[..])));
            for (three, (span, weights)) in nodes.windows(3).zip(spans) {
                for (out, [wa, wb, wc]) in span.iter_mut().zip(weights) {
                    *out = wa * three[0] + wb * three[1] + wc * three[2];
                }
            }
        }
        Self {
            pitch,
            width: w,
            off: off_j,
            weights,
            across,
        }
    }

    /// The noise of `out.len() / width` rows of the window from row `first` on.
    pub(super) fn rows(&self, first: usize, out: &mut [f32]) {
        let w = self.width;
        for (j, line) in out.chunks_exact_mut(w).enumerate() {
            let j = first + j + self.off;
            let (node, k) = (j / self.pitch, j % self.pitch);
            let [wa, wb, wc] = self.weights[k].map(|v| GAIN * v);
            let rows = &self.across[node * w..(node + 3) * w];
            let (a, b, c) = (&rows[..w], &rows[w..2 * w], &rows[2 * w..]);
            for (i, o) in line.iter_mut().enumerate() {
                *o = wa * a[i] + wb * b[i] + wc * c[i];
            }
        }
    }
}
