//! Noise without a period: every value is a hash of its place and a seed.

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

/// Length of a vector of moderate size.
#[inline(always)]
pub(super) fn norm(x: f32, y: f32) -> f32 {
    (x * x + y * y).sqrt()
}

/// Largest whole number not above `x`. The library's `floor` is a call on the oldest x86-64.
#[inline(always)]
fn floor_i64(x: f64) -> i64 {
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

/// Gradient noise (Perlin, *Improving Noise*, SIGGRAPH 2002) of wavelength `wave_um`, about -1 to 1, standard deviation
/// about 0.35. The lattice is turned by an angle of its own for every seed.
pub(super) fn gradient(seed: u64, wave_um: f64, u: f64, v: f64) -> f32 {
    let (sin, cos) = turn(seed);
    let (x, y) = ((u * cos - v * sin) / wave_um, (u * sin + v * cos) / wave_um);
    let (i, j) = (floor_i64(x), floor_i64(y));
    let (fx, fy) = ((x - i as f64) as f32, (y - j as f64) as f32);
    let corner = |di: i64, dj: i64| {
        // Sixteen directions are enough to hide the lattice.
        let h = hash(seed, i + di, j + dj);
        let [gx, gy] = DIRECTIONS[(h >> 28) as usize];
        gx * (fx - di as f32) + gy * (fy - dj as f32)
    };
    let fade = |t: f32| t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let (sx, sy) = (fade(fx), fade(fy));
    1.5 * mix(
        mix(corner(0, 0), corner(1, 0), sx),
        mix(corner(0, 1), corner(1, 1), sx),
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
#[inline]
pub(super) fn strands(seed: u64, w: f32, x: f32, y: f32) -> f32 {
    let (k, i, j) = (floor_i32(w), floor_i32(x), floor_i32(y));
    let ease = |t: f32| t * t * (3.0 - 2.0 * t);
    let (tw, tx, ty) = (ease(w - k as f32), ease(x - i as f32), ease(y - j as f32));
    let at = |dk: i32, di: i32, dj: i32| {
        let mut h = (seed as u32)
            .wrapping_add(((k + dk) as u32).wrapping_mul(0x9E37_79B1))
            .wrapping_add(((i + di) as u32).wrapping_mul(0x85EB_CA77))
            .wrapping_add(((j + dj) as u32).wrapping_mul(0xC2B2_AE3D));
        h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
        h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
        h ^= h >> 15;
        (h as i32) as f32 * (1.0 / 2_147_483_648.0)
    };
    let plane = |dk| {
        mix(
            mix(at(dk, 0, 0), at(dk, 1, 0), tx),
            mix(at(dk, 0, 1), at(dk, 1, 1), tx),
            ty,
        )
    };
    mix(plane(0), plane(1), tw)
}

/// Value noise on every sample of a window, smoothly interpolated between nodes `pitch` samples apart; -1 to 1.
/// Column 0, row 0 of the window is sample (`i0`, `j0`) of the world.
pub(super) fn lattice(seed: u64, pitch: usize, i0: i64, j0: i64, w: usize, h: usize) -> Vec<f32> {
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
    // Interpolated along the rows first, at the nodes' own rows.
    let mut across = vec![0.0; rows * w];
    let mut nodes = vec![0.0; columns];
    for (r, line) in across.chunks_exact_mut(w).enumerate() {
        for (c, node) in nodes.iter_mut().enumerate() {
            *node = 2.0 * unit(hash(seed, a0 + c as i64 - 1, b0 + r as i64 - 1)) - 1.0;
        }
        let (mut node, mut k) = (0, off_i);
        for out in line {
            let [wa, wb, wc] = weights[k];
            *out = wa * nodes[node] + wb * nodes[node + 1] + wc * nodes[node + 2];
            k += 1;
            if k == pitch {
                (k, node) = (0, node + 1);
            }
        }
    }
    // A B-spline of white nodes keeps little variance; this brings the standard deviation to about 0.5.
    const GAIN: f32 = 1.6;
    let mut out = vec![0.0; w * h];
    for (j, line) in out.chunks_exact_mut(w).enumerate() {
        let (node, k) = ((j + off_j) / pitch, (j + off_j) % pitch);
        let [wa, wb, wc] = weights[k].map(|v| GAIN * v);
        let rows = &across[node * w..(node + 3) * w];
        let (a, b, c) = (&rows[..w], &rows[w..2 * w], &rows[2 * w..]);
        for (i, o) in line.iter_mut().enumerate() {
            *o = wa * a[i] + wb * b[i] + wc * c[i];
        }
    }
    out
}
