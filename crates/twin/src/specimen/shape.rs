//! Shapes that specimens are made of: the share of the light that each takes, at any place.

use crate::font;
use crate::seeds;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use std::f64::consts::TAU;

/// What takes light, around a middle of its own. Lengths in micrometres, x right, y up.
#[derive(Debug, Clone)]
pub(super) enum Shape {
    /// A round spot.
    Disc { radius_um: f64 },
    /// An upright square.
    Square { half_um: f64 },
    /// An upright line without ends.
    Stripe { half_um: f64 },
    /// Two upright lines that cross, and end where those of the next crossing begin.
    Crossing { half_um: f64, arm_um: f64 },
    /// A cell with a nucleus and granules.
    Cell(Cell),
    /// A square of a wafer, with conductors and its number.
    Die(Die),
}

impl Shape {
    /// How far it reaches from its middle, along x and along y.
    pub(super) fn reach_um(&self) -> [f64; 2] {
        match self {
            Self::Disc { radius_um } => [*radius_um; 2],
            Self::Square { half_um } => [*half_um; 2],
            Self::Stripe { half_um } => [*half_um, f64::INFINITY],
            Self::Crossing { arm_um, .. } => [*arm_um; 2],
            Self::Cell(cell) => [1.3 * cell.radius_um; 2],
            Self::Die(die) => [die.half_um; 2],
        }
    }

    /// Light taken at a point, 0..1, as a sample of `edge_um` sees it: edges are that soft.
    pub(super) fn taken(&self, p: [f64; 2], edge_um: f64) -> f64 {
        match self {
            Self::Disc { radius_um } => inside(radius_um - p[0].hypot(p[1]), edge_um),
            Self::Square { half_um } => rectangle(p, [0.0; 2], [*half_um; 2], edge_um),
            Self::Stripe { half_um } => inside(half_um - p[0].abs(), edge_um),
            Self::Crossing { half_um, arm_um } => {
                let along_x = rectangle(p, [0.0; 2], [*arm_um, *half_um], edge_um);
                let along_y = rectangle(p, [0.0; 2], [*half_um, *arm_um], edge_um);
                along_x.max(along_y)
            }
            Self::Cell(cell) => cell.taken(p, edge_um),
            Self::Die(die) => die.taken(p, edge_um),
        }
    }
}

fn inside(by_um: f64, edge_um: f64) -> f64 {
    (0.5 + by_um / edge_um).clamp(0.0, 1.0)
}

/// Exact for upright rectangles: the share of a square sample that each lies over.
fn rectangle(p: [f64; 2], centre: [f64; 2], half: [f64; 2], edge_um: f64) -> f64 {
    let over = |i: usize| {
        let (low, high) = (centre[i] - half[i], centre[i] + half[i]);
        let (from, to) = (p[i] - 0.5 * edge_um, p[i] + 0.5 * edge_um);
        ((to.min(high) - from.max(low)) / edge_um).clamp(0.0, 1.0)
    };
    over(0) * over(1)
}

/// A single cell: an outline of three waves, a nucleus, granules.
#[derive(Debug, Clone)]
pub(super) struct Cell {
    radius_um: f64,
    /// Height and phase of the outline's waves 2, 3 and 5.
    waves: [[f64; 2]; 3],
    nucleus: [f64; 3],
    /// Middle, radius and light taken.
    granules: Vec<[f64; 4]>,
}

impl Cell {
    pub(super) fn draw(radius_um: f64, rng: &mut Pcg64Mcg) -> Self {
        let waves =
            std::array::from_fn(|_| [rng.random_range(0.0..0.1), rng.random_range(0.0..TAU)]);
        let within = |rng: &mut Pcg64Mcg, share: f64| {
            let (r, a) = (
                share * rng.random::<f64>().sqrt(),
                rng.random_range(0.0..TAU),
            );
            [r * radius_um * a.cos(), r * radius_um * a.sin()]
        };
        let [x, y] = within(rng, 0.3);
        let nucleus = [x, y, radius_um * rng.random_range(0.3..0.5)];
        let granules = (0..rng.random_range(8..20))
            .map(|_| {
                let [x, y] = within(rng, 0.85);
                let radius = radius_um * rng.random_range(0.05..0.14);
                [x, y, radius, rng.random_range(0.2..0.6)]
            })
            .collect();
        Self {
            radius_um,
            waves,
            nucleus,
            granules,
        }
    }

    fn taken(&self, p: [f64; 2], edge_um: f64) -> f64 {
        let (r, a) = (p[0].hypot(p[1]), p[1].atan2(p[0]));
        let outline: f64 = [2.0, 3.0, 5.0]
            .iter()
            .zip(&self.waves)
            .map(|(n, [height, phase])| height * (n * a + phase).cos())
            .sum();
        let rim = self.radius_um * (1.0 + outline) - r;
        let body = inside(rim, edge_um);
        if body == 0.0 {
            return 0.0;
        }
        // A membrane a tenth of the radius thick is darker than what it holds.
        let membrane = body * (1.0 - inside(rim - 0.1 * self.radius_um, edge_um));
        let mut light = (1.0 - 0.35 * body) * (1.0 - 0.3 * membrane);
        let [x, y, radius] = self.nucleus;
        light *= 1.0 - 0.5 * inside(radius - (p[0] - x).hypot(p[1] - y), edge_um);
        for [x, y, radius, taken] in &self.granules {
            light *= 1.0 - taken * inside(radius - (p[0] - x).hypot(p[1] - y), edge_um);
        }
        1.0 - light
    }
}

/// One die: rectangles on a square, the same in all dies of a wafer but for the number.
#[derive(Debug, Clone)]
pub(super) struct Die {
    half_um: f64,
    /// Middle, half sides and light taken.
    parts: Vec<[f64; 5]>,
    number: Option<String>,
}

impl Die {
    pub(super) fn draw(half_um: f64, rng: &mut Pcg64Mcg) -> Self {
        let parts = (0..28)
            .map(|_| {
                let long = rng.random_range(0.1..0.5) * half_um;
                let thin = rng.random_range(0.02..0.12) * half_um;
                let [w, h] = if rng.random() {
                    [long, thin]
                } else {
                    [thin, long]
                };
                let mut within = |half: f64| rng.random_range(-1.0..1.0) * (0.92 * half_um - half);
                let [x, y] = [within(w), within(h)];
                [x, y, w, h, rng.random_range(0.3..0.8)]
            })
            .collect();
        Self {
            half_um,
            parts,
            number: None,
        }
    }

    pub(super) fn numbered(&self, number: String) -> Self {
        Self {
            number: Some(number),
            ..self.clone()
        }
    }

    fn taken(&self, p: [f64; 2], edge_um: f64) -> f64 {
        // The street between dies is bright, the die's ground is not.
        let mut light = 1.0 - 0.3 * rectangle(p, [0.0; 2], [self.half_um; 2], edge_um);
        for [x, y, w, h, taken] in &self.parts {
            light *= 1.0 - taken * rectangle(p, [*x, *y], [*w, *h], edge_um);
        }
        if let Some(number) = &self.number {
            let dot_um = 2.0 * self.half_um / 40.0;
            let at = |v: f64| (v / dot_um).floor();
            let (i, j) = (at(p[0] + 0.9 * self.half_um), at(0.9 * self.half_um - p[1]));
            if i >= 0.0 && j >= 0.0 && font::dot(number, i as usize, j as usize) {
                light *= 0.1;
            }
        }
        1.0 - light
    }
}

/// The generator of one cell of a plane.
pub(super) fn rng_of(seed: u64, stream: u64, [i, j]: [i64; 2]) -> Pcg64Mcg {
    // Both numbers whole: planes are smaller than 2^32 cells across.
    seeds::rng(seed, stream, (i as u64) << 32 ^ (j as u64 & 0xffff_ffff))
}
