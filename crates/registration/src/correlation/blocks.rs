//! Block by block: how far the view lies from where a transform puts it. Each block is a correspondence, so that what follows the
//! matching of features judges blocks, too.

use super::matched::Matched;
use crate::{Correspondences, Shapes};
use scopeservo_geometry::{Affine2, Correspondence, Vec2};

/// Half side of a block, samples.
const RADIUS: usize = 8;
/// Distance of two blocks, samples of the finest level.
const STEP: f64 = 12.0;
/// More blocks than this are not looked at: then every second, fourth... one is.
const MOST_BLOCKS: usize = 400;
/// A block has structure when the mean square of its values, which are of equal contrast, is at least this.
const STRUCTURED: f32 = 0.15;
/// So much of a block must count in both images.
const LEAST_SHARE: f32 = 0.6;
/// Below this a correlation is anything's.
const LEAST_CORRELATION: f32 = 0.3;
/// The descriptors' windows, in place of which a block's sides are: what lies nearer together than one sees the same pixels.
const WINDOW_SIGMAS: f64 = 12.0;

/// Where the blocks of a target lie: whole multiples of one distance, whatever the level, so that a place is the same place in all frames.
fn lattice(matched: &Matched<'_>, finest: usize) -> impl Iterator<Item = Vec2> {
    let base = STEP * matched.ratio * finest as f64;
    let [w, h] = matched.target_size;
    let times = (matched.view.every / finest).max(1);
    let count = move |n: usize, times: usize| (n as f64 / (base * times as f64)) as usize;
    let times = (0..)
        .map(|k| times << k)
        .find(|&t| count(w, t) * count(h, t) <= MOST_BLOCKS)
        .unwrap_or(times);
    let along = move |n: usize| (1..=count(n, times)).map(move |k| (k * times) as f64 * base);
    along(h).flat_map(move |y| along(w).map(move |x| [x, y]))
}

/// The blocks of the target that are found near where `rough` puts them, `reach` samples away at most.
pub(super) fn correspondences(
    matched: &Matched<'_>,
    rough: &Affine2,
    finest: usize,
    reach: usize,
) -> Option<Correspondences> {
    let view_from_target = rough.inverse()?;
    let sample = matched.view.sample_from_pixel();
    let pixel = matched.view.pixel_from_sample();
    let target_sample_from_view_sample = matched
        .target
        .sample_from_pixel()
        .after(&rough.after(&pixel));
    let mut search = Search {
        matched,
        map: target_sample_from_view_sample,
        reach,
        patch: Vec::new(),
    };
    let every = matched.view.every as f64;
    let sigma = (2 * RADIUS + 1) as f64 * every / WINDOW_SIGMAS;
    let angle = rough.linear.rotation_angle()?;
    let shapes: Shapes = [sigma, sigma * matched.ratio, 0.0, angle];
    // Where a block can be found: the square that is searched.
    let side = (2 * reach + 1) as f64 * every * matched.ratio;
    let mut all = Correspondences {
        view_size: matched.view_size,
        target_area: side * side,
        indices: Vec::new(),
        pairs: Vec::new(),
        shapes: Vec::new(),
    };
    for (i, place) in lattice(matched, finest).enumerate() {
        let p = sample.apply(view_from_target.apply(place));
        let Some(found) = search.block(p) else {
            continue;
        };
        let at = [p[0] + found.shift[0], p[1] + found.shift[1]];
        all.indices.push([i, i]);
        all.pairs.push(Correspondence {
            p_in_a: pixel.apply(at),
            p_in_b: place,
            sigma: found.sigma * every * matched.ratio,
        });
        all.shapes.push(shapes);
    }
    Some(all)
}

/// A block that was found.
struct Found {
    /// From where it was put, samples.
    shift: Vec2,
    /// Standard deviation up to a common factor: what is not explained, over how sharp the peak is.
    sigma: f64,
}

struct Search<'a> {
    matched: &'a Matched<'a>,
    /// Sample of the target from sample of the view.
    map: Affine2,
    reach: usize,
    patch: Vec<f32>,
}

impl Search<'_> {
    /// Looks for the block around a sample of the view.
    fn block(&mut self, p: Vec2) -> Option<Found> {
        let view = self.matched.view;
        let margin = (RADIUS + self.reach) as f64;
        let fits = |v: f64, side: usize| v >= margin && v + margin + 1.0 < side as f64;
        if !fits(p[0], view.width) || !fits(p[1], view.height) {
            return None;
        }
        let [x, y] = p.map(|v| v.round() as usize);
        let side = 2 * RADIUS + 1;
        self.draw([x, y]);
        let own: f32 = self.patch.iter().map(|v| v * v).sum();
        let counts = self.patch.iter().filter(|v| **v != 0.0).count();
        let area = (side * side) as f32;
        if own < STRUCTURED * area || (counts as f32) < LEAST_SHARE * area {
            return None;
        }
        let across = 2 * self.reach + 1;
        let mut like = vec![0.0f32; across * across];
        for (k, out) in like.iter_mut().enumerate() {
            let left = x + k % across - self.reach - RADIUS;
            let top = y + k / across - self.reach - RADIUS;
            *out = self.correlation([left, top], own);
        }
        peak(&like, across)
    }

    /// Draws what the target shows around a sample of the view.
    fn draw(&mut self, [x, y]: [usize; 2]) {
        self.patch.clear();
        let side = 2 * RADIUS as i64 + 1;
        for j in 0..side {
            for i in 0..side {
                let at = [x as i64 + i, y as i64 + j].map(|v| (v - RADIUS as i64) as f64);
                let value = self.matched.target.at(self.map.apply(at));
                self.patch.push(value);
            }
        }
    }

    /// With the view's square that begins at a sample.
    fn correlation(&self, [left, top]: [usize; 2], own: f32) -> f32 {
        let (view, side) = (self.matched.view, 2 * RADIUS + 1);
        let (mut product, mut energy) = ([0.0f32; 4], [0.0f32; 4]);
        for (j, row) in self.patch.chunks_exact(side).enumerate() {
            let seen = &view.values[(top + j) * view.width + left..][..side];
            let (row4, row_end) = row.as_chunks::<4>();
            let (seen4, seen_end) = seen.as_chunks::<4>();
            for (a, b) in row4.iter().zip(seen4) {
                for k in 0..4 {
                    product[k] += a[k] * b[k];
                    energy[k] += b[k] * b[k];
                }
            }
            for (a, b) in row_end.iter().zip(seen_end) {
                product[0] += a * b;
                energy[0] += b * b;
            }
        }
        let (product, energy) = (product.iter().sum::<f32>(), energy.iter().sum::<f32>());
        match energy > STRUCTURED * (side * side) as f32 * 0.3 {
            true => product / (own * energy).sqrt(),
            false => 0.0,
        }
    }
}

/// The highest place, between samples, if it is one and not the border's.
fn peak(like: &[f32], across: usize) -> Option<Found> {
    let (k, height) = like
        .iter()
        .copied()
        .enumerate()
        .reduce(|a, b| if b.1 > a.1 { b } else { a })?;
    let (x, y) = (k % across, k / across);
    let inside = |v: usize| v > 0 && v + 1 < across;
    if !inside(x) || !inside(y) || height < LEAST_CORRELATION {
        return None;
    }
    let at = |dx: i64, dy: i64| {
        f64::from(like[((y as i64 + dy) * across as i64 + x as i64 + dx) as usize])
    };
    // The parabola through each three samples.
    let along = |before: f64, after: f64| {
        let bend = before + after - 2.0 * f64::from(height);
        let shift = (bend < -1e-6).then(|| 0.5 * (before - after) / bend)?;
        Some((shift.clamp(-0.5, 0.5), -bend))
    };
    let (dx, bend_x) = along(at(-1, 0), at(1, 0))?;
    let (dy, bend_y) = along(at(0, -1), at(0, 1))?;
    let reach = (across / 2) as f64;
    let unexplained = (1.0 - f64::from(height).powi(2)).max(0.02);
    Some(Found {
        shift: [x as f64 - reach + dx, y as f64 - reach + dy],
        sigma: (unexplained / bend_x.min(bend_y)).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peak_is_found_between_samples_and_on_the_border_it_is_none() {
        let bump = |cx: f64, cy: f64| -> Vec<f32> {
            (0..49)
                .map(|i| {
                    let d = ((i % 7) as f64 - cx).powi(2) + ((i / 7) as f64 - cy).powi(2);
                    (0.9 - 0.05 * d) as f32
                })
                .collect()
        };
        let found = peak(&bump(3.3, 2.8), 7).unwrap();
        assert!((found.shift[0] - 0.3).abs() < 1e-4 && (found.shift[1] + 0.2).abs() < 1e-4);
        assert!(peak(&bump(0.1, 3.0), 7).is_none());
        assert!(peak(&[0.2; 49], 7).is_none(), "anything's");
    }
}
