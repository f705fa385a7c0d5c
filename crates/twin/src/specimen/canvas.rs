//! A tile on which shapes take light away.

use super::GLASS;
use super::pyramid::TILE;
use super::shape::Shape;

/// Spacing of the finest samples of what is drawn here, micrometres: two to a pixel of a 40x objective.
pub(super) const SAMPLE_UM: f64 = 0.25;
/// Levels 0.25, 0.5, 1, 2, 4 and 8 um.
pub(super) const LEVELS: usize = 6;

/// How a shape lies.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lie {
    /// Its middle, um on the specimen.
    pub(super) at_um: [f64; 2],
    /// Cosine and sine of the angle that it is turned by.
    pub(super) turn: [f64; 2],
}

/// Light taken at each sample of one tile.
pub(super) struct Canvas {
    /// Centre of the first sample.
    first_um: [f64; 2],
    taken: Vec<f32>,
}

impl Canvas {
    pub(super) fn new(tx: i64, ty: i64) -> Self {
        let first = |t: i64| ((t * TILE as i64) as f64 + 0.5) * SAMPLE_UM;
        Self {
            first_um: [first(tx), -first(ty)],
            taken: vec![0.0; TILE * TILE],
        }
    }

    /// Middle of the tile, um.
    pub(super) fn middle_um(&self) -> [f64; 2] {
        let half = 0.5 * (TILE - 1) as f64 * SAMPLE_UM;
        [self.first_um[0] + half, self.first_um[1] - half]
    }

    /// Distance from the middle to a corner, um, with a sample to spare.
    pub(super) fn radius_um() -> f64 {
        (0.5 * TILE as f64 + 1.0) * SAMPLE_UM * std::f64::consts::SQRT_2
    }

    /// Draws a shape. What two shapes cover loses light to both, unless one of them is opaque.
    pub(super) fn stamp(&mut self, shape: &Shape, lie: &Lie) {
        let [c, s] = lie.turn;
        let [a, b] = shape.reach_um().map(|r| r + SAMPLE_UM);
        // The upright box around the turned one; a share of nothing of an endless side is nothing.
        let of = |share: f64, r: f64| {
            if share.abs() < 1e-12 {
                0.0
            } else {
                share.abs() * r
            }
        };
        let half = [of(c, a) + of(s, b), of(s, a) + of(c, b)];
        let ends = |from: f64, to: f64| {
            let clip = |v: f64| v.clamp(0.0, TILE as f64) as usize;
            clip((from / SAMPLE_UM).ceil())..clip((to / SAMPLE_UM).floor() + 1.0)
        };
        let x = lie.at_um[0] - self.first_um[0];
        let y = self.first_um[1] - lie.at_um[1];
        let columns = ends(x - half[0], x + half[0]);
        for row in ends(y - half[1], y + half[1]) {
            for column in columns.clone() {
                let dx = column as f64 * SAMPLE_UM - x;
                let dy = y - row as f64 * SAMPLE_UM;
                let taken = shape.taken([c * dx + s * dy, c * dy - s * dx], SAMPLE_UM) as f32;
                let v = &mut self.taken[row * TILE + column];
                *v = 1.0 - (1.0 - *v) * (1.0 - taken);
            }
        }
    }

    /// The colour of every sample: glass, darkened by `contrast` of the light taken, more in one colour than in another.
    /// `holes` take no light where all else does.
    pub(super) fn rgb(&self, contrast: f64, tint: [f64; 3], holes: bool) -> Vec<u8> {
        let colour = |taken: f32| {
            let taken = if holes { 1.0 - taken } else { taken };
            [0, 1, 2].map(|c| {
                let light = 1.0 - contrast * tint[c] * f64::from(taken);
                (f64::from(GLASS[c]) * light).round().clamp(0.0, 255.0) as u8
            })
        };
        let mut out = Vec::with_capacity(3 * self.taken.len());
        // Most of a tile is glass: what the sample before has, this one has.
        let (mut before, mut told) = (0.0, colour(0.0));
        for &taken in &self.taken {
            if taken != before {
                (before, told) = (taken, colour(taken));
            }
            out.extend_from_slice(&told);
        }
        out
    }
}
