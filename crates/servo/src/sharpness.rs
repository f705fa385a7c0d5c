//! How sharp a picture is, whole and cell by cell, and which cells tell nothing of the focus.
//!
//! Burnt-in text, a reticle and dust on the sensor are as sharp at every height, and drown what little a sparse specimen adds. So cells
//! that are clearly sharper than the quietest ones at every height of a sweep, and do not rise and fall with it, are left out.

use scopeservo_scope::Frame;
use serde::{Deserialize, Serialize};

/// Cells along and down the picture, at most.
const CELLS: [usize; 2] = [16, 12];
/// The least side of a cell, pixels.
const LEAST_SIDE_PX: usize = 16;
/// What is kept of a cell's sharpness.
const UNIT: f64 = 1e-5;
/// A cell is sharp when it is never less sharp than this many times the quietest quarter of the cells.
const SHARP: f64 = 1.5;
/// Standard deviation of mean |Laplacian| over its mean, of noise: this over the root of the number of pixels. Half again as much for
/// noise that neighbouring pixels share.
const NOISE: f64 = 1.4;
/// A cell varies for sure beyond so many of its standard deviations: the range of some twenty samples of noise has four.
const RANGE_SIGMAS: f64 = 4.5;
/// The same for the whole of what is left of the picture.
const WHOLE_SIGMAS: f64 = 5.5;
/// What rises and falls once goes twice its range, up and down. Digits that follow the height go farther.
const UPS_AND_DOWNS: f64 = 2.5;

/// The mean |Laplacian| of each cell over the mean luminance of the picture, in whole numbers of [`UNIT`]: a stored sweep stays small.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Grid {
    /// Pixels of a cell.
    cell_px: f64,
    #[serde(with = "crate::compact::cells")]
    cells: Vec<u32>,
}

/// Mean |Laplacian| of the luminance (4-neighbour mask, inner pixels) over its mean: light that changes with the height, or
/// flickers, is no sharpness. 0 for a black frame.
pub fn sharpness(frame: &Frame) -> f64 {
    sharpness_and_grid(frame).0
}

/// That of the whole picture and of its cells.
pub(crate) fn sharpness_and_grid(frame: &Frame) -> (f64, Grid) {
    let (w, h) = (frame.width, frame.height);
    let l = frame.luminance();
    let mean = l.iter().map(|&v| f64::from(v)).sum::<f64>() / l.len() as f64;
    if w < 3 || h < 3 || mean.is_nan() || mean <= 0.0 {
        return (0.0, Grid::default());
    }
    let inner = [w - 2, h - 2];
    let [across, down] = [0, 1].map(|k| (inner[k] / LEAST_SIDE_PX).clamp(1, CELLS[k]));
    let mut cells = vec![[0.0f64; 2]; across * down];
    let mut sum = 0.0f64;
    let mut line = vec![0.0f32; inner[0]];
    for y in 0..inner[1] {
        let (up, row, below) = (&l[y * w..], &l[(y + 1) * w..], &l[(y + 2) * w..]);
        for (x, out) in (1..).zip(line.iter_mut()) {
            *out = (up[x] + below[x] + row[x - 1] + row[x + 1] - 4.0 * row[x]).abs();
        }
        sum += f64::from(line.iter().sum::<f32>());
        let row_of_cells = &mut cells[y * down / inner[1] * across..][..across];
        for (k, cell) in row_of_cells.iter_mut().enumerate() {
            let [from, to] = [k, k + 1].map(|k| (k * inner[0]).div_ceil(across));
            cell[0] += f64::from(line[from..to].iter().sum::<f32>());
            cell[1] += (to - from) as f64;
        }
    }
    let count = (inner[0] * inner[1]) as f64;
    let grid = Grid {
        cell_px: count / cells.len() as f64,
        cells: cells
            .iter()
            .map(|[sum, count]| (sum / count / mean / UNIT).round() as u32)
            .collect(),
    };
    (sum / count / mean, grid)
}

impl Grid {
    /// The mean without some cells.
    pub(crate) fn without(&self, left_out: &[usize]) -> f64 {
        let counted = |(k, v): (usize, &u32)| (!left_out.contains(&k)).then_some(f64::from(*v));
        let counted: Vec<f64> = self.cells.iter().enumerate().filter_map(counted).collect();
        UNIT * counted.iter().sum::<f64>() / counted.len().max(1) as f64
    }

    /// The range that noise alone gives to the mean without some cells, over it.
    pub(crate) fn noise_without(&self, left_out: &[usize]) -> f64 {
        let cells = self.cells.len() - left_out.len().min(self.cells.len());
        WHOLE_SIGMAS * NOISE / (self.cell_px * cells as f64).sqrt()
    }
}

/// The cells that are sharp at every height of a sweep, in order of height, and tell nothing of the focus: they stay as they are, up to
/// `min_contrast` and noise, or go up and down. A quarter of the cells is always left.
pub(crate) fn constant(sweep: &[&Grid], min_contrast: f64) -> Vec<usize> {
    let Some(first) = sweep.first() else {
        return Vec::new();
    };
    // Pictures of two sizes cannot be compared.
    if first.cells.is_empty() || sweep.iter().any(|g| g.cells.len() != first.cells.len()) {
        return Vec::new();
    }
    let curves = (0..first.cells.len()).map(|k| sweep.iter().map(move |g| f64::from(g.cells[k])));
    let least: Vec<f64> = curves
        .clone()
        .map(|curve| curve.fold(f64::INFINITY, f64::min))
        .collect();
    let mut sorted = least.clone();
    let quarter = (sorted.len() - 1) / 4;
    let quiet = *sorted.select_nth_unstable_by(quarter, f64::total_cmp).1;
    let sigma = quiet * NOISE / first.cell_px.sqrt();
    let tells_nothing = |curve: Vec<f64>, least: f64| {
        let range = curve.iter().copied().fold(0.0, f64::max) - least;
        let way: f64 = curve.windows(2).map(|v| (v[1] - v[0]).abs()).sum();
        range < (min_contrast - 1.0) * least + RANGE_SIGMAS * sigma || way > UPS_AND_DOWNS * range
    };
    (0..)
        .zip(curves)
        .filter(|(k, curve)| {
            let least = least[*k];
            least > SHARP * quiet && tells_nothing(curve.clone().collect(), least)
        })
        .map(|(k, _)| k)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_geometry::SplitMix64;
    use scopeservo_scope::{Channels, Samples, Timestamp};

    fn frame_of(width: usize, height: usize, f: impl FnMut(usize) -> u8) -> Frame {
        Frame {
            width,
            height,
            channels: Channels::Gray,
            bit_depth: 8,
            samples: Samples::U8((0..width * height).map(f).collect()),
            sequence: 0,
            exposure_start: Timestamp::default(),
            exposure: std::time::Duration::from_millis(10),
        }
    }

    fn frame(f: impl Fn(usize, usize) -> u8) -> Frame {
        frame_of(32, 24, |i| f(i % 32, i / 32))
    }

    #[test]
    fn a_slope_has_no_laplacian_and_an_edge_has() {
        assert_eq!(sharpness(&frame(|_, _| 77)), 0.0);
        assert!(sharpness(&frame(|x, y| (3 * x + 2 * y) as u8)) < 1e-6);
        // One step between two columns: |L| is its height on both sides of it, 2 of 30 inner columns; the mean is half of it.
        for high in [255, 100] {
            let edge = sharpness(&frame(|x, _| if x < 16 { 0 } else { high }));
            assert!((edge - 2.0 / 30.0 / 0.5).abs() < 1e-6, "{edge}");
        }
        assert_eq!(sharpness(&frame(|_, _| 0)), 0.0);
    }

    /// Blank glass with noise of a standard deviation, and marks: rows of hard dots on some of the picture. What else there is in a cell is
    /// added by `more`.
    fn blank(
        rng: &mut SplitMix64,
        sigma: f64,
        marked: impl Fn(usize, usize) -> bool,
        more: impl Fn(usize, usize) -> f64,
    ) -> Frame {
        frame_of(640, 480, |i| {
            let (x, y) = (i % 640, i / 640);
            if marked(x, y) && (x / 3 + y / 3).is_multiple_of(2) {
                return 20;
            }
            // Twelve uniform numbers are near enough to a normal one.
            let normal = (0..12).map(|_| rng.uniform()).sum::<f64>() - 6.0;
            (200.0 + sigma * normal + more(x, y)).round() as u8
        })
    }

    fn text(_: usize, y: usize) -> bool {
        (44..62).contains(&y)
    }

    fn specks(x: usize, y: usize) -> bool {
        (x * 7 + y * 13) % 97 < 3 && x > 200
    }

    #[test]
    fn noise_beside_marks_or_without_is_never_a_contrast() {
        let mut rng = SplitMix64::new(3);
        type Marked = fn(usize, usize) -> bool;
        let none: Marked = |_, _| false;
        let most_of_it: Marked = |x, _| x < 470;
        for (marked, count) in [
            (none, 0..=0),
            (text, 16..=16),
            (specks, 0..=144),
            (most_of_it, 144..=144),
        ] {
            for sigma in [0.6, 2.55, 12.0] {
                for _ in 0..3 {
                    let seen: Vec<Grid> = (0..15)
                        .map(|_| sharpness_and_grid(&blank(&mut rng, sigma, marked, |_, _| 0.0)).1)
                        .collect();
                    let left_out = constant(&seen.iter().collect::<Vec<_>>(), 1.04);
                    assert!(count.contains(&left_out.len()), "{sigma}: {left_out:?}");
                    let all: Vec<f64> = seen.iter().map(|g| g.without(&left_out)).collect();
                    let most = all.iter().copied().fold(0.0, f64::max);
                    let least = all.iter().copied().fold(f64::INFINITY, f64::min);
                    let range = most / least - 1.0;
                    assert!(range < 0.02, "{sigma}: {range}");
                    assert!(range < seen[0].noise_without(&left_out), "{sigma}: {range}");
                }
            }
        }
    }

    #[test]
    fn text_is_left_out_and_what_rises_and_falls_counts_also_where_it_is_sharp_at_every_height() {
        let mut rng = SplitMix64::new(5);
        let tissue = |x: usize, y: usize| (300..420).contains(&x) && (200..320).contains(&y);
        let seen: Vec<Grid> = (0..11)
            .map(|k| {
                let sharp = 8.0 + 30.0 * (-((f64::from(k) - 5.0) / 1.5).powi(2)).exp();
                let more = |x: usize, y: usize| match tissue(x, y) && (x + y).is_multiple_of(2) {
                    true => -sharp,
                    false => 0.0,
                };
                sharpness_and_grid(&blank(&mut rng, 2.0, text, more)).1
            })
            .collect();
        let left_out = constant(&seen.iter().collect::<Vec<_>>(), 1.04);
        // The second row of cells.
        assert_eq!(left_out, (16..32).collect::<Vec<_>>());
    }

    #[test]
    fn digits_that_follow_the_height_are_left_out() {
        let mut rng = SplitMix64::new(7);
        let seen: Vec<Grid> = (0..15)
            .map(|_| {
                let wide = 100 + rng.below(40);
                let digits = |x: usize, y: usize| text(x, y) && x < wide;
                sharpness_and_grid(&blank(&mut rng, 2.0, digits, |_, _| 0.0)).1
            })
            .collect();
        let left_out = constant(&seen.iter().collect::<Vec<_>>(), 1.04);
        assert_eq!(left_out, [16, 17, 18]);
    }

    #[test]
    fn pictures_of_two_sizes_and_black_ones_leave_nothing_out() {
        let (_, small) = sharpness_and_grid(&frame(|x, _| (7 * x) as u8));
        let (_, black) = sharpness_and_grid(&frame(|_, _| 0));
        assert_eq!(small.cells.len(), 1);
        assert!(constant(&[&small, &black], 1.04).is_empty());
        assert!(constant(&[], 1.04).is_empty());
    }
}
