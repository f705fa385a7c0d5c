//! Turns under which a lattice looks like itself, and with it what is odd in it: a missing cell, a broken one. Which turns a lattice allows
//! follows from its two periods (the crystallographic restriction: halves, thirds, quarters and sixths of a whole turn); about which place
//! the odd cells allow it, is where what the periods do not explain correlates with itself, turned.

use crate::corners::centre;
use crate::fourier::{C32, Fourier, smooth_size};
use crate::likeness::Plane;
use crate::period::SelfLikeness;
use crate::{Estimate, Rival};
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, Mat2, Vec2};

/// A turn of a lattice stretches by no more than this: pixels need be neither square nor upright.
const STRETCH: f64 = 0.06;
/// Samples along a period at least, and all samples of an image at most: the pixels decide later to a pixel and a half.
const LEAST_PERIOD: f64 = 8.0;
const MOST_SAMPLES: usize = 80_000;
/// Places about which each turn is told,
const MOST: usize = 3;
/// and how well what the periods do not explain must correlate with itself there: cells that lie a little off where they should, each its own
/// way, do not.
const ALIKE: f32 = 0.25;

/// The first transform, followed by each turn under which the target may look like itself: rivals that need no feature to be thought of.
/// None of a target without two periods; without any nothing is computed. Also to how many pixels of the target along each axis their places are known.
pub(crate) fn turned(
    first: &Estimate,
    target: &GrayImage,
    periods_px: &[Vec2],
) -> (Vec<Rival>, f64) {
    let none = (Vec::new(), 0.0);
    if periods_px.is_empty() {
        return none;
    }
    let Some(likeness) = SelfLikeness::of(target) else {
        return none;
    };
    let [a, b] = likeness.shortest_periods()[..] else {
        return none;
    };
    let Some(odd) = Odd::of(target, [a, b]) else {
        return none;
    };
    // Where a rival lands is told of the target's middle.
    let middle = centre([target.width(), target.height()]);
    let at = first.target_from_view.inverse().map(|t| t.apply(middle));
    let turns = turns_of([a, b])
        .into_iter()
        .flat_map(|turn| odd.about(turn));
    let rivals = turns.filter_map(|turn| {
        let other = turn.after(&first.target_from_view);
        Rival::beside(&first.target_from_view, &other, at?, [0, 0])
    });
    (rivals.collect(), 0.5 * odd.every as f64)
}

/// Linear parts of the turns that take a lattice onto itself: whole numbers in the basis of its periods, of a determinant of 1, that come
/// back to where they began.
fn turns_of([a, b]: [Vec2; 2]) -> Vec<Mat2> {
    let basis = Mat2([[a[0], b[0]], [a[1], b[1]]]);
    let Some(inverse) = basis.inverse() else {
        return Vec::new();
    };
    let entries = [-1.0, 0.0, 1.0];
    let all = (0..81).map(|k| {
        let entry = |place: usize| entries[k / 3usize.pow(place as u32) % 3];
        Mat2([[entry(0), entry(1)], [entry(2), entry(3)]])
    });
    // Of order 2, 3, 4 and 6 the trace is -2, -1, 0 and 1; of the identity it is 2.
    let whole = all.filter(|m| m.det() == 1.0 && m.0[0][0] + m.0[1][1] < 2.0);
    let turns = whole.map(|m| basis * m * inverse);
    turns
        .filter(|Mat2([[p, q], [r, s]])| f64::hypot(p - s, q + r) <= 2.0 * STRETCH)
        .collect()
}

/// What the periods of a target do not explain of it.
struct Odd {
    plane: Plane,
    /// Columns and rows.
    size: [usize; 2],
    /// Pixels along both axes that make a sample.
    every: usize,
    fourier: Fourier,
    spectrum: Vec<C32>,
    /// The sum of its squares, as many times as a correlation has it that is not divided by the number of values.
    energy: f32,
}

impl Odd {
    fn of(target: &GrayImage, periods_px: [Vec2; 2]) -> Option<Self> {
        let shortest = periods_px.map(|p| f64::hypot(p[0], p[1]));
        let finest = (shortest[0].min(shortest[1]) / LEAST_PERIOD) as usize;
        let every = (1..finest.max(1))
            .find(|f| target.width() * target.height() <= MOST_SAMPLES * f * f)
            .unwrap_or(finest.max(1));
        let light = Plane::thinned(target, every);
        let size = [light.width(), light.height()];
        let periods = periods_px.map(|p| p.map(|v| v / every as f64));
        let plane = unexplained(&light, size, periods)?;
        let fourier = Fourier::new(size.map(|n| smooth_size(2 * n)));
        let spectrum = spectrum(&fourier, size, |x, y| plane.values()[y * size[0] + x]);
        let squares = plane.values().iter().map(|v| v * v).sum::<f32>();
        Some(Self {
            plane,
            size,
            every,
            energy: squares * fourier.len() as f32,
            fourier,
            spectrum,
        })
    }

    /// Target over target: turned, about the places where that looks most like what was there.
    fn about(&self, turn: Mat2) -> Vec<Affine2> {
        let Some(back) = turn.inverse() else {
            return Vec::new();
        };
        let [w, h] = self.size;
        let middle = centre(self.size);
        let turned = spectrum(&self.fourier, self.size, |x, y| {
            let off = back * [x as f64 - middle[0], y as f64 - middle[1]];
            let at = [0, 1].map(|k| middle[k] + off[k]);
            self.plane.at(at).unwrap_or(0.0) as f32
        });
        let mut product: Vec<C32> = self
            .spectrum
            .iter()
            .zip(&turned)
            .map(|(a, b)| a * b.conj())
            .collect();
        let mut height = self.fourier.plane();
        self.fourier
            .inverse(&mut product, &mut height, &mut self.fourier.scratch());
        let [columns, rows] = self.fourier.size.map(|n| n as i64);
        let at = |x: i64, y: i64| {
            height[(y.rem_euclid(rows) * columns + x.rem_euclid(columns)) as usize].re
        };
        let mut peaks = Vec::new();
        for y in 1 - h as i64..h as i64 {
            for x in 1 - w as i64..w as i64 {
                let here = at(x, y);
                let around = (-1..=1).flat_map(|j| (-1..=1).map(move |i| (i, j)));
                if here > ALIKE * self.energy
                    && around.into_iter().all(|(i, j)| at(x + i, y + j) <= here)
                {
                    peaks.push((here, [x, y]));
                }
            }
        }
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
        let shifts = peaks.into_iter().take(MOST).map(|peak| peak.1);
        let middle = middle.map(|v| v * self.every as f64);
        let still = turn * middle;
        shifts
            .map(|shift| Affine2 {
                linear: turn,
                offset: [0, 1]
                    .map(|k| middle[k] - still[k] + (shift[k] * self.every as i64) as f64),
            })
            .collect()
    }
}

/// What differs from the mean of what lies a period away on all sides; nothing where fewer than two of these are seen.
fn unexplained(light: &Plane, size: [usize; 2], periods: [Vec2; 2]) -> Option<Plane> {
    let ways = periods.map(|p| [p, p.map(|v| -v)]).concat();
    let values = (0..size[0] * size[1]).map(|i| {
        let at = [i % size[0], i / size[0]].map(|v| v as f64);
        let seen = ways
            .iter()
            .filter_map(|way| light.at([at[0] + way[0], at[1] + way[1]]));
        let (count, sum) = seen.fold((0, 0.0), |(n, sum), v| (n + 1, sum + v));
        match count {
            0 | 1 => 0.0,
            _ => light.values()[i] - (sum / f64::from(count)) as f32,
        }
    });
    Plane::from_values(size, values.collect())
}

fn spectrum(
    fourier: &Fourier,
    [w, h]: [usize; 2],
    value: impl Fn(usize, usize) -> f32,
) -> Vec<C32> {
    let mut plane = fourier.plane();
    for (y, row) in plane.chunks_exact_mut(fourier.size[0]).take(h).enumerate() {
        row.iter_mut()
            .take(w)
            .enumerate()
            .for_each(|(x, c)| c.re = value(x, y));
    }
    let mut spectrum = fourier.plane();
    fourier.forward(&mut plane, &mut spectrum, &mut fourier.scratch());
    spectrum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::periods;

    fn quarters(turns: &[Mat2]) -> Vec<f64> {
        let mut angles: Vec<f64> = turns
            .iter()
            .map(|Mat2([[p, _], [r, _]])| r.atan2(*p).to_degrees().round())
            .map(|a| if a == -180.0 { 180.0 } else { a })
            .collect();
        angles.sort_by(f64::total_cmp);
        angles
    }

    #[test]
    fn a_lattice_turns_as_its_periods_allow() {
        let square = turns_of([[10.0, 1.0], [-1.0, 10.0]]);
        assert_eq!(quarters(&square), [-90.0, 90.0, 180.0]);
        let hexagonal = turns_of([[10.0, 0.0], [5.0, 10.0 * 0.75f64.sqrt()]]);
        assert_eq!(quarters(&hexagonal), [-120.0, -60.0, 60.0, 120.0, 180.0]);
        let oblong = turns_of([[10.0, 0.0], [0.0, 14.0]]);
        assert_eq!(quarters(&oblong), [180.0]);
    }

    #[test]
    fn a_lattice_turns_about_its_missing_cell() {
        let missing = [200.0, 130.0];
        let image = GrayImage::from_fn(320, 240, |x, y| {
            let d = [x as f64 - missing[0], y as f64 - missing[1]];
            let off = d.map(|v| v - 40.0 * (v / 40.0f64).round());
            let there = d.map(|v| (v / 40.0f64).round()) != [0.0, 0.0];
            if there && f64::hypot(off[0], off[1]) < 12.0 {
                0.2
            } else {
                0.8
            }
        })
        .unwrap();
        let all = turned(&Estimate::at_rest(), &image, &periods(&image));
        for angle in [-90.0f64, 90.0, 180.0] {
            let near = |r: &&Rival| {
                let off = (r.turn_rad.to_degrees() - angle).rem_euclid(360.0);
                off.min(360.0 - off) < 1.0
            };
            let stays = |r: &Rival| {
                let p = r.target_from_view.apply(missing);
                f64::hypot(p[0] - missing[0], p[1] - missing[1]) < 2.0
            };
            assert!(all.0.iter().filter(near).any(stays), "{angle}: {all:?}");
        }
    }
}
