//! Which of the view's places lie near a point. Hundreds of thousands of transforms are counted, each with a hundred points, and near most of these lies
//! nothing: that is one look at a raster.

use super::places::{Place, Places};
use scopeservo_geometry::Vec2;

/// Cells of the index, pixels.
const CELL_PX: f64 = 8.0;
/// Sizes that the raster tells apart; dark and bright it does as well.
const SIZES: usize = 8;

/// Kinds of places, one bit each: polarity and about the size.
pub(super) type Kinds = u16;

/// The places of a view, by where they lie.
pub(super) struct Near {
    size: [usize; 2],
    /// For each pixel, the kinds of the places within the radius of any of its points.
    raster: Vec<Kinds>,
    /// The kind of each place.
    kinds: Vec<Kinds>,
    columns: usize,
    cells: Vec<Vec<usize>>,
}

impl Near {
    /// An index for points within `radius` of a place.
    pub(super) fn new(view: &Places, radius: f64) -> Self {
        let size = view.size;
        let [columns, rows] = size.map(|n| (n as f64 / CELL_PX) as usize + 1);
        let mut cells = vec![Vec::new(); columns * rows];
        let mut raster = vec![0; size[0] * size[1]];
        let kinds = kinds(view);
        for (i, place) in view.all.iter().enumerate() {
            let [x, y] = place.at.map(|v| (v / CELL_PX).max(0.0) as usize);
            cells[y.min(rows - 1) * columns + x.min(columns - 1)].push(i);
            for y in pixels(place.at[1], radius, size[1]) {
                for x in pixels(place.at[0], radius, size[0]) {
                    let off = [off(place.at[0], x), off(place.at[1], y)];
                    if off[0].powi(2) + off[1].powi(2) <= radius * radius {
                        raster[y * size[0] + x] |= kinds[i];
                    }
                }
            }
        }
        Self {
            size,
            raster,
            kinds,
            columns,
            cells,
        }
    }

    /// The kinds of those places for which `may` holds, by their number.
    pub(super) fn kinds_of(&self, may: &[bool]) -> Kinds {
        let those = self.kinds.iter().zip(may).filter(|(_, may)| **may);
        those.fold(0, |all, (kind, _)| all | kind)
    }

    /// At least those of these kinds within a radius, no larger than that of the index, of a point of the view; none is told twice.
    pub(super) fn to(&self, at: Vec2, radius: f64, kinds: Kinds) -> impl Iterator<Item = usize> {
        let [x, y] = [0, 1].map(|k| (at[k].max(0.0) as usize).min(self.size[k] - 1));
        let any = self.raster[y * self.size[0] + x] & kinds != 0;
        let range = |v: f64, count: usize| {
            let last = if any { count } else { 0 };
            let [low, high] = [v - radius, v + radius].map(|v| (v / CELL_PX).max(0.0) as usize);
            low.min(last)..(high + 1).min(last)
        };
        let rows = range(at[1], self.cells.len() / self.columns);
        let columns = range(at[0], self.columns);
        rows.flat_map(move |row| {
            let cells = columns
                .clone()
                .map(move |column| row * self.columns + column);
            cells.flat_map(|cell| self.cells[cell].iter().copied())
        })
    }
}

/// The kind of each place: sizes in equal steps of their logarithm.
fn kinds(view: &Places) -> Vec<Kinds> {
    let sizes = || view.all.iter().map(|place| place.sigma.ln());
    let least = sizes().fold(f64::INFINITY, f64::min);
    let step = (sizes().fold(least, f64::max) - least) / SIZES as f64;
    let kind = |place: &Place| {
        let size = ((place.sigma.ln() - least) / step).max(0.0) as usize;
        1 << (size.min(SIZES - 1) + SIZES * usize::from(place.bright))
    };
    view.all.iter().map(kind).collect()
}

/// Pixels, as squares from a whole number to the next, that may come within a radius of a coordinate.
fn pixels(v: f64, radius: f64, count: usize) -> std::ops::Range<usize> {
    let [low, high] = [v - radius, v + radius + 1.0].map(|v| v.max(0.0) as usize);
    low.min(count)..high.min(count)
}

/// How far a coordinate is from a pixel's square.
fn off(v: f64, pixel: usize) -> f64 {
    let low = pixel as f64;
    (low - v).max(v - (low + 1.0)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_that_is_near_is_told_and_told_once() {
        let mut seed = 1u64;
        let mut random = || {
            seed = seed
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (seed >> 11) as f64 / (1u64 << 53) as f64
        };
        let size = [90, 70];
        let within = |x: f64, y: f64| [x * 89.0, y * 69.0];
        let all = (0..200).map(|index| Place {
            at: within(random(), random()),
            sigma: 1.0 + 9.0 * random(),
            bright: random() < 0.5,
            index,
        });
        let view = Places {
            all: all.collect(),
            size,
        };
        let near = Near::new(&view, 2.5);
        let mut found = 0;
        for _ in 0..3000 {
            let at = within(random(), random());
            for (radius, bright, least) in [(2.5, true, 1.0), (2.5, false, 3.0), (1.7, true, 6.0)] {
                let is = |place: &Place| place.bright == bright && place.sigma >= least;
                let may: Vec<bool> = view.all.iter().map(is).collect();
                let mut told: Vec<usize> = near.to(at, radius, near.kinds_of(&may)).collect();
                let count = told.len();
                told.sort_unstable();
                told.dedup();
                assert_eq!(told.len(), count);
                for (i, place) in view.all.iter().enumerate() {
                    let off = f64::hypot(place.at[0] - at[0], place.at[1] - at[1]);
                    if off <= radius && may[i] {
                        assert!(told.contains(&i), "{i} at {at:?}");
                        found += 1;
                    }
                }
            }
        }
        assert!(found > 1000);
    }
}
