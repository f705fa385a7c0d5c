//! One look at a height: sharpness on each level, cell by cell.

use super::levels::{Plane, levels};
use super::measure::{FocusMeasure, LEVELS};
use super::noise::Noise;
use crate::compact::Size;
use scopeservo_scope::Frame;
use serde::{Deserialize, Serialize};

/// Cells along and down an image, at most, and the least side of one in pixels of its level.
const CELLS: [usize; 2] = [12, 9];
const LEAST_SIDE_PX: usize = 40;
/// From this share of full scale on a pixel is saturated, and tells nothing.
const SATURATED: f32 = 0.995;

/// The cells of one level: the mean answer of the measure over the light, the noise's share included.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Cells {
    /// Answers in a cell, on average.
    pub(crate) count: f64,
    #[serde(with = "crate::compact::sizes")]
    values: Vec<Size>,
    /// Columns; all of one row where an earlier version kept none.
    #[serde(default)]
    across: usize,
}

impl Cells {
    /// Saturated pixels, and those beside them, do not count; a cell without any other has none.
    fn of(plane: &Plane, measure: &dyn FocusMeasure, light: f64) -> Self {
        let (w, h) = (plane.width, plane.height);
        if w < 3 || h < 3 || light.is_nan() || light <= 0.0 {
            return Self::default();
        }
        let inner = [w - 2, h - 2];
        let [across, down] = [0, 1].map(|k| (inner[k] / LEAST_SIDE_PX).clamp(1, CELLS[k]));
        let mut sums = vec![[0.0f64; 2]; across * down];
        let mut answer = vec![0.0f32; inner[0]];
        let edges: Vec<usize> = (0..=across)
            .map(|k| (k * inner[0]).div_ceil(across))
            .collect();
        for y in 0..inner[1] {
            let row = |k: usize| &plane.data[(y + k) * w..(y + k + 1) * w];
            let rows = [row(0), row(1), row(2)];
            measure.row(rows, &mut answer);
            let cells = &mut sums[y * down / inner[1] * across..][..across];
            for (cell, edge) in cells.iter_mut().zip(edges.windows(2)) {
                for x in edge[0]..edge[1] {
                    if rows[1][x + 1] < SATURATED {
                        cell[0] += f64::from(answer[x]);
                        cell[1] += 1.0;
                    }
                }
            }
        }
        let unit = light.powi(measure.order());
        let value = |[sum, count]: &[f64; 2]| Size::from(sum / count.max(1.0) / unit);
        Self {
            count: (inner[0] * inner[1]) as f64 / sums.len() as f64,
            values: sums.iter().map(value).collect(),
            across,
        }
    }

    /// Columns and rows.
    pub(crate) fn shape(&self) -> [usize; 2] {
        let across = match self.across {
            0 => self.len().max(1),
            across => across,
        };
        [across, self.len() / across]
    }

    pub(crate) fn len(&self) -> usize {
        self.values.len()
    }

    pub(crate) fn get(&self, cell: usize) -> f64 {
        self.values.get(cell).map_or(0.0, |size| size.get())
    }

    /// The mean of the cells but for some, and how many these are.
    pub(crate) fn without(&self, left_out: &[usize]) -> (f64, usize) {
        let counted = (0..self.len()).filter(|k| left_out.binary_search(k).is_err());
        let (sum, n) = counted.fold((0.0, 0usize), |(sum, n), k| (sum + self.get(k), n + 1));
        (sum / n.max(1) as f64, n)
    }
}

/// One look.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Sample {
    /// Where the stage says it was.
    pub(crate) z_um: f64,
    /// Mean luminance.
    pub(crate) light: f64,
    /// What its noise seems to be.
    pub(crate) noise: Noise,
    /// The finest first.
    pub(crate) levels: Vec<Cells>,
}

impl Sample {
    pub(crate) fn of(frame: &Frame, z_um: f64, measure: &dyn FocusMeasure, count: usize) -> Self {
        let image = Plane::of(frame);
        let light = image.mean();
        let mut planes = levels(&image, count.min(LEVELS));
        let noise = Noise::of(&image);
        if let (false, Some(finest)) = (measure.smooths(), planes.first_mut()) {
            *finest = image;
        }
        Self {
            z_um,
            light,
            noise,
            levels: planes
                .iter()
                .map(|plane| Cells::of(plane, measure, light))
                .collect(),
        }
    }
}

/// A cell is sharp when it never answers less than this many times the quietest quarter of the cells.
const SHARP: f64 = 2.25;
/// In a sweep so many widths of its level wide a specimen's cell falls by more than this factor: what does not was written onto the image,
/// and changes as the digits do.
const WIDE: f64 = 6.0;
const FALLS: f64 = 4.0;
/// A cell varies for sure beyond so many of its standard deviations: the range of some twenty samples of noise has four.
const RANGE_SIGMAS: f64 = 4.5;
/// What rises and falls once goes twice its range, up and down. Digits that follow the height go farther.
const UPS_AND_DOWNS: f64 = 2.5;

/// The cells of a level that are sharp at every height, in order of height, and tell nothing of the focus: burnt-in text, a reticle and dust
/// on the sensor stay as they are, up to `contrast` and noise, or go up and down. A quarter of the cells is always left. `correlation`:
/// so many answers to noise count as one. `widths`: how wide the sweep is.
pub(crate) fn constant(
    sweep: &[&Cells],
    contrast: f64,
    correlation: f64,
    widths: f64,
) -> Vec<usize> {
    let Some(first) = sweep.first() else {
        return Vec::new();
    };
    // Images of two sizes cannot be compared.
    if first.len() == 0 || sweep.iter().any(|g| g.len() != first.len()) {
        return Vec::new();
    }
    let curve = |k: usize| sweep.iter().map(move |cells| cells.get(k));
    let least: Vec<f64> = (0..first.len())
        .map(|k| curve(k).fold(f64::INFINITY, f64::min))
        .collect();
    let mut sorted = least.clone();
    let quarter = (sorted.len() - 1) / 4;
    let quiet = *sorted.select_nth_unstable_by(quarter, f64::total_cmp).1;
    let sigma = quiet * (2.0 * correlation / first.count).sqrt();
    let stays = match widths >= WIDE {
        true => contrast.max(FALLS),
        false => contrast,
    };
    let tells_nothing = |k: usize| {
        let values: Vec<f64> = curve(k).collect();
        let range = values.iter().copied().fold(0.0, f64::max) - least[k];
        let way: f64 = values.windows(2).map(|v| (v[1] - v[0]).abs()).sum();
        range < (stays - 1.0) * least[k] + RANGE_SIGMAS * sigma || way > UPS_AND_DOWNS * range
    };
    (0..first.len())
        .filter(|&k| least[k] > SHARP * quiet && tells_nothing(k))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::focus::measure::Measure;
    use crate::focus::sharpness::tests::{frame, frame_of};
    use scopeservo_geometry::SplitMix64;

    fn seen(frame: &Frame) -> Sample {
        Sample::of(frame, 0.0, Measure::Laplacian.measure(), 1)
    }

    fn left_out(sweep: &[Sample]) -> Vec<usize> {
        let cells: Vec<&Cells> = sweep.iter().map(|s| &s.levels[0]).collect();
        constant(&cells, 1.08, 5.68, 1.0)
    }

    /// Blank glass with noise of a standard deviation, and marks: rows of hard dots on some of the image. What else there is in a cell is
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
            (text, 16..=32),
            (specks, 0..=81),
            (most_of_it, 81..=81),
        ] {
            for sigma in [0.6, 2.55, 12.0] {
                for _ in 0..3 {
                    let sweep: Vec<Sample> = (0..15)
                        .map(|k| Sample {
                            z_um: f64::from(k),
                            ..seen(&blank(&mut rng, sigma, marked, |_, _| 0.0))
                        })
                        .collect();
                    let left_out = left_out(&sweep);
                    assert!(count.contains(&left_out.len()), "{sigma}: {left_out:?}");
                    let measure = Measure::Laplacian.measure();
                    let curve = crate::focus::curve::Curve::of(&sweep, 0, measure, 1.04, 1.0);
                    assert_eq!((curve.bracketed(1.08), curve.rises_at(1.08)), (None, None));
                }
            }
        }
    }

    #[test]
    fn text_is_left_out_and_what_rises_and_falls_counts_also_where_it_is_sharp_at_every_height() {
        let mut rng = SplitMix64::new(5);
        let tissue = |x: usize, y: usize| (300..420).contains(&x) && (200..320).contains(&y);
        let sweep: Vec<Sample> = (0..11)
            .map(|k| {
                let sharp = 8.0 + 30.0 * (-((f64::from(k) - 5.0) / 1.5).powi(2)).exp();
                let more =
                    |x: usize, y: usize| match tissue(x, y) && (x / 3 + y / 3).is_multiple_of(2) {
                        true => -sharp,
                        false => 0.0,
                    };
                seen(&blank(&mut rng, 2.0, text, more))
            })
            .collect();
        let left_out = left_out(&sweep);
        // The first two rows of cells, and what of the text reaches into their neighbours.
        assert!((0..24).all(|k| left_out.contains(&k)), "{left_out:?}");
        assert!(left_out.iter().all(|k| *k < 36), "{left_out:?}");
    }

    #[test]
    fn digits_that_follow_the_height_are_left_out() {
        let mut rng = SplitMix64::new(7);
        let sweep: Vec<Sample> = (0..15)
            .map(|_| {
                let wide = 115 + rng.below(40);
                let digits = |x: usize, y: usize| text(x, y) && x < wide;
                seen(&blank(&mut rng, 2.0, digits, |_, _| 0.0))
            })
            .collect();
        let left_out = left_out(&sweep);
        assert!((12..15).all(|k| left_out.contains(&k)), "{left_out:?}");
    }

    #[test]
    fn images_of_two_sizes_and_black_ones_leave_nothing_out() {
        let small = seen(&frame(|x, _| (7 * x) as u8));
        let black = seen(&frame(|_, _| 0));
        assert!(left_out(&[small, black]).is_empty());
        assert!(constant(&[], 1.04, 5.0, 1.0).is_empty());
    }

    #[test]
    fn the_share_of_white_noise_is_what_the_measures_say() {
        let mut rng = SplitMix64::new(11);
        for measure in [Measure::Laplacian, Measure::Tenengrad, Measure::BandPower] {
            let measure = measure.measure();
            let sigma = 0.02;
            let image = Plane {
                width: 640,
                height: 480,
                data: (0..640 * 480)
                    .map(|_| (0.5 + sigma * rng.normal()) as f32)
                    .collect(),
            };
            for (level, plane) in levels(&image, LEVELS).iter().enumerate() {
                let (seen, _) = Cells::of(plane, measure, 1.0).without(&[]);
                let share = measure.noise_gain()[level] * sigma * sigma;
                let n = (plane.width * plane.height) as f64 / measure.correlation()[level];
                let off = (seen / share - 1.0).abs();
                assert!(
                    off < 0.01 + 4.0 * (2.0 / n).sqrt(),
                    "{}: {level} {off}",
                    measure.name()
                );
            }
        }
    }
}
