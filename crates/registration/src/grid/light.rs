//! Uneven illumination: a polynomial through the means of whole cells. What repeats itself has the same mean in each of them.

use scopeservo_geometry::{Cholesky, Vec2};

/// Powers of x and y: all up to the second order, then those of the third and fourth.
const POWERS: [[i32; 2]; 15] = [
    [0, 0],
    [1, 0],
    [0, 1],
    [2, 0],
    [1, 1],
    [0, 2],
    [3, 0],
    [2, 1],
    [1, 2],
    [0, 3],
    [4, 0],
    [3, 1],
    [2, 2],
    [1, 3],
    [0, 4],
];
/// So many cells for each coefficient: between few of them a polynomial of a high order goes where it likes.
const PER_COEFFICIENT: f64 = 2.0;
/// Means farther off than so many standard deviations are those of covered cells.
const FAR: f64 = 4.0;
const ROUNDS: usize = 3;

/// The light at each place of an image.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Light {
    coefficients: Vec<f64>,
    corner_px: f64,
}

impl Light {
    pub(super) fn even(value: f64, corner_px: f64) -> Self {
        Self {
            coefficients: vec![value],
            corner_px,
        }
    }

    /// Through means at places from the image's centre, px, of each of which a `share` is news. `None` where there are too few.
    pub(super) fn through(means: &[(Vec2, f64)], share: f64, corner_px: f64) -> Option<Self> {
        let cells = share * means.len() as f64;
        let count = match cells / PER_COEFFICIENT {
            15.0.. => 15,
            2.0.. if means.len() >= 12 => 6,
            _ => return None,
        };
        let row = |p: Vec2| -> Vec<f64> { terms(p, corner_px).take(count).collect() };
        let mut used: Vec<(Vec<f64>, f64)> = means.iter().map(|(p, v)| (row(*p), *v)).collect();
        let mut coefficients = Vec::new();
        for _ in 0..ROUNDS {
            let (mut information, mut right) = (vec![0.0; count * count], vec![0.0; count]);
            for (row, value) in &used {
                for i in 0..count {
                    right[i] += row[i] * value;
                    for j in 0..count {
                        information[i * count + j] += row[i] * row[j];
                    }
                }
            }
            coefficients = Cholesky::of(&information, count)?.solve(&right);
            let off = |(row, value): &(Vec<f64>, f64)| {
                let there: f64 = row.iter().zip(&coefficients).map(|(r, c)| r * c).sum();
                (value - there).abs()
            };
            let mut sorted: Vec<f64> = used.iter().map(off).collect();
            sorted.sort_by(f64::total_cmp);
            let most = FAR * sorted[sorted.len() / 2] / 0.6745;
            used.retain(|mean| off(mean) <= most);
            if used.len() < 2 * count {
                break;
            }
        }
        Some(Self {
            coefficients,
            corner_px,
        })
    }

    pub(super) fn at(&self, [x, y]: Vec2) -> f64 {
        self.along(y)(x)
    }

    /// Along a row, as a polynomial in x.
    pub(super) fn along(&self, y: f64) -> impl Fn(f64) -> f64 {
        let (mut of_x, y) = ([0.0; 5], y / self.corner_px);
        for (c, [i, j]) in self.coefficients.iter().zip(POWERS) {
            of_x[i as usize] += c * y.powi(j);
        }
        let corner_px = self.corner_px;
        move |x| {
            of_x.iter()
                .rev()
                .fold(0.0, |sum, c| sum * (x / corner_px) + c)
        }
    }
}

fn terms(p: Vec2, corner_px: f64) -> impl Iterator<Item = f64> {
    let [x, y] = p.map(|v| v / corner_px);
    POWERS.iter().map(move |[i, j]| x.powi(*i) * y.powi(*j))
}
