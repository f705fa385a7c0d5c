//! Similarity, gain and offset between an image and a reference, by inverse composition on chosen pixels.

use super::motion::Motion;
use scopeservo_geometry::cholesky_inverse;

/// Pixels nearer to the border are not chosen.
const BORDER: usize = 3;
/// A cell whose steepest pixel has less of a gradient than this share of the mean one has nothing in it.
const STEEP: f32 = 0.5;
/// Fewer pixels say nothing.
const LEAST_POINTS: usize = 100;
/// What is off by so many times the median deviation counts a quarter.
const ROBUST: f32 = 4.0;
/// Medians are those of every so many pixels.
const SAMPLED: usize = 4;
/// Below this, grey of 0 to 1, no deviation is large.
const LEAST_DEVIATION: f32 = 0.002;

/// What one pixel of the reference says: derivatives by `[da, db, dx, dy]`, its value, 1, room for what is left, 0.
type Row = [f32; 8];
const VALUE: usize = 4;
const LEFT: usize = 6;

/// Chosen pixels of a reference.
pub(super) struct Patch {
    size: [usize; 2],
    /// From the middle.
    points: Vec<[f32; 2]>,
    rows: Vec<Row>,
    /// What each pixel of the frame differs by; NaN where it is outside.
    left: Vec<f32>,
    /// Room for those that a median is taken of.
    sizes: Vec<f32>,
}

/// What came of it.
pub(super) struct Aligned {
    pub(super) motion: Motion,
    /// Of what is seen, each pixel counting as it agrees.
    pub(super) correlation: f64,
    /// Share of the pixels that lie in the frame.
    pub(super) seen: f64,
    /// Of `[a, b, x, y]`, pixels of the level.
    pub(super) covariance: [[f64; 4]; 4],
}

impl Patch {
    /// About `count` pixels of a reference; `None` when it has too little in it.
    pub(super) fn new(image: &[f32], size: [usize; 2], count: usize) -> Option<Self> {
        let [w, h] = size;
        let gradient = |x: usize, y: usize| {
            let at = |x: usize, y: usize| image[y * w + x];
            [
                0.5 * (at(x + 1, y) - at(x - 1, y)),
                0.5 * (at(x, y + 1) - at(x, y - 1)),
            ]
        };
        let steep = |x: usize, y: usize| {
            let [gx, gy] = gradient(x, y);
            gx * gx + gy * gy
        };
        let cell = (((w * h) as f64 / count as f64).sqrt() as usize).max(1);
        let mut chosen: Vec<([usize; 2], f32)> = Vec::new();
        for y0 in (BORDER..h - BORDER).step_by(cell) {
            for x0 in (BORDER..w - BORDER).step_by(cell) {
                let rows = y0..(y0 + cell).min(h - BORDER);
                let all = rows.flat_map(|y| (x0..(x0 + cell).min(w - BORDER)).map(move |x| [x, y]));
                let best = all
                    .map(|p| (p, steep(p[0], p[1])))
                    .reduce(|a, b| if b.1 > a.1 { b } else { a });
                chosen.extend(best);
            }
        }
        let mean = chosen.iter().map(|c| c.1).sum::<f32>() / chosen.len().max(1) as f32;
        chosen.retain(|c| c.1 >= STEEP * STEEP * mean && c.1 > 0.0);
        if chosen.len() < LEAST_POINTS {
            return None;
        }
        let middle = size.map(|n| (n as f32 - 1.0) / 2.0);
        let points: Vec<[f32; 2]> = chosen
            .iter()
            .map(|(p, _)| [p[0] as f32 - middle[0], p[1] as f32 - middle[1]])
            .collect();
        let row = |(&([x, y], _), &[px, py]): (&([usize; 2], f32), &[f32; 2])| {
            let [gx, gy] = gradient(x, y);
            let value = image[y * w + x];
            [
                gx * px + gy * py,
                gy * px - gx * py,
                gx,
                gy,
                value,
                1.0,
                0.0,
                0.0,
            ]
        };
        let rows = chosen.iter().zip(&points).map(row).collect();
        Some(Self {
            size,
            left: vec![0.0; points.len()],
            sizes: Vec::with_capacity(points.len().div_ceil(SAMPLED)),
            points,
            rows,
        })
    }

    /// Aligns a frame, from a motion that is nearly right.
    pub(super) fn align(&mut self, frame: &[f32], rough: Motion, iterations: usize) -> Aligned {
        let mut aligned = Aligned {
            motion: rough,
            correlation: 0.0,
            seen: 0.0,
            covariance: [[f64::INFINITY; 4]; 4],
        };
        // What hides half of the frame does not change a median.
        self.look(frame, &rough, 1.0, 0.0);
        let (mut gain, mut offset) = (1.0f32, self.median(|left| left));
        for _ in 0..iterations {
            let seen = self.look(frame, &aligned.motion, gain, offset);
            let deviation = self.median(f32::abs);
            let sums = self.sums(deviation);
            let normal: [[f64; 6]; 6] =
                std::array::from_fn(|i| std::array::from_fn(|j| sums[i][j]));
            let Some(inverse) = cholesky_inverse(&normal) else {
                return aligned;
            };
            let step: [f64; 6] =
                std::array::from_fn(|i| (0..6).map(|j| inverse[i][j] * sums[LEFT][j]).sum());
            let weight = sums[5][5];
            let left = sums[LEFT][LEFT] / weight.max(1e-9);
            gain += step[4] as f32;
            offset += step[5] as f32;
            let [da, db, dx, dy] = [0, 1, 2, 3].map(|k| (step[k] / f64::from(gain)) as f32);
            aligned.motion = aligned.motion.after_inverse([da, db, dx, dy]);
            aligned.seen = seen;
            aligned.correlation = correlation(&sums, gain);
            let variance = left / f64::from(gain * gain);
            aligned.covariance =
                std::array::from_fn(|i| std::array::from_fn(|j| variance * inverse[i][j]));
        }
        aligned
    }

    /// What the frame differs by from the reference under a motion; tells which share of it is seen.
    fn look(&mut self, frame: &[f32], motion: &Motion, gain: f32, offset: f32) -> f64 {
        let [w, h] = self.size;
        let middle = [w, h].map(|n| (n as f32 - 1.0) / 2.0);
        let mut seen = 0usize;
        for ((left, &p), row) in self.left.iter_mut().zip(&self.points).zip(&self.rows) {
            let q = motion.apply(p);
            let (x, y) = (q[0] + middle[0], q[1] + middle[1]);
            let (i, j) = (x as usize, y as usize);
            if !(x >= 0.0 && y >= 0.0 && i + 1 < w && j + 1 < h) {
                *left = f32::NAN;
                continue;
            }
            let (u, v) = (x - i as f32, y - j as f32);
            let (upper, lower) = (&frame[j * w + i..][..2], &frame[(j + 1) * w + i..][..2]);
            let a = upper[0] + u * (upper[1] - upper[0]);
            let b = lower[0] + u * (lower[1] - lower[0]);
            *left = a + v * (b - a) - gain * row[VALUE] - offset;
            seen += 1;
        }
        seen as f64 / self.points.len() as f64
    }

    /// The sums of all products of two numbers of a row, weighted by how well the pixel agrees; with what is left in its room.
    fn sums(&self, deviation: f32) -> [[f64; 8]; 8] {
        let mut all = [[0.0f64; 8]; 8];
        let far = 1.0 / (ROBUST * deviation.max(LEAST_DEVIATION));
        for (rows, left) in self.rows.chunks(64).zip(self.left.chunks(64)) {
            let mut sums = [[0.0f32; 8]; 8];
            for (row, &left) in rows.iter().zip(left) {
                if left.is_nan() {
                    continue;
                }
                let off = left * far;
                let one = 1.0 / (1.0 + off * off);
                let mut row = *row;
                row[LEFT] = left;
                for (sum, &a) in sums.iter_mut().zip(&row) {
                    let weighted = one * one * a;
                    for (s, &b) in sum.iter_mut().zip(&row) {
                        *s += weighted * b;
                    }
                }
            }
            for (all, sum) in all.iter_mut().flatten().zip(sums.iter().flatten()) {
                *all += f64::from(*sum);
            }
        }
        all
    }

    /// The median of what is left, taken as `of` says; 0 where nothing is seen.
    fn median(&mut self, of: impl Fn(f32) -> f32) -> f32 {
        let seen = self.left.iter().step_by(SAMPLED).filter(|l| !l.is_nan());
        self.sizes.clear();
        self.sizes.extend(seen.map(|&l| of(l)));
        let middle = self.sizes.len() / 2;
        match self.sizes.is_empty() {
            true => 0.0,
            false => *self.sizes.select_nth_unstable_by(middle, f32::total_cmp).1,
        }
    }
}

/// Of the frame with the reference, from the weighted sums.
fn correlation(sums: &[[f64; 8]; 8], gain: f32) -> f64 {
    let weight = sums[5][5].max(1e-9);
    let mean = sums[VALUE][5] / weight;
    let explained = f64::from(gain).powi(2) * (sums[VALUE][VALUE] / weight - mean * mean);
    let left = sums[LEFT][LEFT] / weight;
    match gain > 0.0 {
        true => (explained.max(0.0) / (explained.max(0.0) + left).max(1e-12)).sqrt(),
        false => 0.0,
    }
}
