//! What repeats itself: wafers, gratings, EM grids, holey films, cells in rows.

use super::canvas::{Canvas, LEVELS, Lie, SAMPLE_UM};
use super::pyramid::{Grid, Pyramid, Source};
use super::shape::{Cell, Die, Shape, rng_of};
use super::{Patch, Specimen, SpecimenError};
use crate::TwinError;
use crate::numbers::{finite, fraction, positive, require};
use crate::seeds;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// How the cells of a lattice lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LatticeKind {
    /// In rows and columns.
    Square,
    /// In rows, every other one shifted by half a pitch.
    Hexagonal,
    /// Lines along y.
    Grating,
    /// Lines along x and y: a grid.
    Lines,
    /// Dark and bright squares in turn; the pitch is that of two.
    Chequer,
    /// Dies of a wafer in rows and columns, with bright streets between them.
    Dies,
}

/// What stands at each place of a square or hexagonal lattice.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CellKind {
    /// Round spots.
    #[default]
    Discs,
    /// Squares.
    Squares,
    /// Cells with a nucleus and granules, all alike.
    Cells,
}

/// A lattice without end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LatticeConfig {
    /// Of the disorder, and of the pattern in a die or a cell.
    pub seed: u64,
    /// How its cells lie.
    pub kind: LatticeKind,
    /// What each is.
    pub cells: CellKind,
    /// Distance of two cells, um.
    pub pitch_um: f64,
    /// How far it is turned against the specimen's axes.
    pub turned_deg: f64,
    /// Width of a cell, of a line or of a die over the pitch (over half of it on a chequer board). The lines of a grid are thin: 0.1 or so.
    pub fill: f64,
    /// Disorder: standard deviation of each cell's place along each axis, as a share of the pitch (normal, cut at 3).
    pub disorder: f64,
    /// Light that a cell takes, 0..1: small for a weak stain.
    pub contrast: f64,
    /// Bright cells in a dark film.
    pub holes: bool,
    /// Whether each die carries its own number.
    pub numbered: bool,
    /// A cell that is missing, by column and row.
    pub odd_cell: Option<[i64; 2]>,
}

impl Default for LatticeConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            kind: LatticeKind::Square,
            cells: CellKind::Discs,
            pitch_um: 20.0,
            turned_deg: 0.0,
            fill: 0.5,
            disorder: 0.0,
            contrast: 0.7,
            holes: false,
            numbered: false,
            odd_cell: None,
        }
    }
}

impl LatticeConfig {
    fn check(&self) -> Result<(), TwinError> {
        require(
            positive(&[self.pitch_um, self.fill])
                && self.pitch_um >= 4.0 * SAMPLE_UM
                && self.pitch_um <= 1e4
                && self.fill <= 1.0
                && finite(&[self.turned_deg])
                && fraction(self.contrast)
                && (0.0..=0.25).contains(&self.disorder),
            "lattice: pitch_um is 1 to 10000, fill above 0 and at most 1, contrast 0..1, disorder 0..0.25",
        )
    }
}

/// Normal numbers are cut here.
const FARTHEST_SIGMAS: f64 = 3.0;

/// A specimen that repeats itself.
#[derive(Debug)]
pub struct Lattice {
    made: Made,
    grid: Grid,
    pyramid: Pyramid,
}

#[derive(Debug)]
struct Made {
    config: LatticeConfig,
    shape: Shape,
    /// Cosine and sine.
    turn: [f64; 2],
}

impl Lattice {
    /// The lattice of this description. Nothing is computed before it is looked at.
    ///
    /// # Errors
    /// [`TwinError::BadConfig`] with the field and what it must be.
    pub fn new(config: LatticeConfig) -> Result<Self, TwinError> {
        config.check()?;
        let half_um = 0.5 * config.fill * config.pitch_um;
        let mut rng = seeds::rng(config.seed, seeds::LATTICE, 0);
        let shape = match (config.kind, config.cells) {
            (LatticeKind::Grating, _) => Shape::Stripe { half_um },
            (LatticeKind::Lines, _) => Shape::Crossing {
                half_um,
                arm_um: 0.5 * config.pitch_um,
            },
            (LatticeKind::Chequer, _) => Shape::Square {
                half_um: 0.5 * half_um,
            },
            (LatticeKind::Dies, _) => Shape::Die(Die::draw(half_um, &mut rng)),
            (_, CellKind::Discs) => Shape::Disc { radius_um: half_um },
            (_, CellKind::Squares) => Shape::Square { half_um },
            (_, CellKind::Cells) => Shape::Cell(Cell::draw(half_um / 1.3, &mut rng)),
        };
        let (s, c) = config.turned_deg.to_radians().sin_cos();
        Ok(Self {
            made: Made {
                config,
                shape,
                turn: [c, s],
            },
            grid: Grid {
                finest_um: SAMPLE_UM,
                levels: LEVELS,
                corner_um: [0.0, 0.0],
            },
            pyramid: Pyramid::new(),
        })
    }
}

impl Made {
    /// Distance of two rows of cells, and by how much each is shifted along the row, in um.
    fn row_um(&self) -> [f64; 2] {
        let p = self.config.pitch_um;
        match self.config.kind {
            LatticeKind::Hexagonal => [0.75f64.sqrt() * p, 0.5 * p],
            LatticeKind::Chequer => [0.5 * p, 0.5 * p],
            _ => [p, 0.0],
        }
    }

    /// Place of a cell along the lattice's own axes, um, without its disorder.
    fn site(&self, [i, j]: [i64; 2]) -> [f64; 2] {
        let [row, shift] = self.row_um();
        let shift = if j.rem_euclid(2) == 1 { shift } else { 0.0 };
        [i as f64 * self.config.pitch_um + shift, j as f64 * row]
    }

    fn off_um(&self, cell: [i64; 2]) -> [f64; 2] {
        if self.config.disorder == 0.0 {
            return [0.0; 2];
        }
        let mut rng = rng_of(self.config.seed, seeds::LATTICE_CELL, cell);
        let scale = self.config.disorder * self.config.pitch_um;
        [normal(&mut rng) * scale, normal(&mut rng) * scale]
    }

    fn stamp(&self, canvas: &mut Canvas, cell: [i64; 2]) {
        if self.config.odd_cell == Some(cell) {
            return;
        }
        let (site, off) = (self.site(cell), self.off_um(cell));
        let (u, v) = (site[0] + off[0], site[1] + off[1]);
        let [c, s] = self.turn;
        let lie = Lie {
            at_um: [c * u - s * v, s * u + c * v],
            turn: self.turn,
        };
        match &self.shape {
            Shape::Die(die) if self.config.numbered => {
                let number =
                    rng_of(self.config.seed, seeds::LATTICE_NUMBER, cell).random_range(0..10_000);
                canvas.stamp(&Shape::Die(die.numbered(format!("{number:04}"))), &lie);
            }
            shape => canvas.stamp(shape, &lie),
        }
    }
}

/// A number of the standard normal distribution, by Box and Muller, cut.
fn normal(rng: &mut Pcg64Mcg) -> f64 {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    let r = (-2.0 * (1.0 - u).ln()).sqrt();
    (r * (std::f64::consts::TAU * v).cos()).clamp(-FARTHEST_SIGMAS, FARTHEST_SIGMAS)
}

impl Source for Made {
    fn finest(&self, tx: i64, ty: i64) -> Result<Vec<u8>, SpecimenError> {
        let mut canvas = Canvas::new(tx, ty);
        let [c, s] = self.turn;
        let [x, y] = canvas.middle_um();
        let (u, v) = (c * x + s * y, c * y - s * x);
        let p = self.config.pitch_um;
        let spread = FARTHEST_SIGMAS * self.config.disorder * p;
        let reach = self
            .shape
            .reach_um()
            .map(|r| r + spread + Canvas::radius_um());
        let [row, shift] = self.row_um();
        let along = |at: f64, reach: f64, step: f64| {
            ((at - reach) / step).floor() as i64..=((at + reach) / step).ceil() as i64
        };
        let rows = match self.config.kind {
            LatticeKind::Grating => 0..=0,
            _ => along(v, reach[1], row),
        };
        for j in rows {
            for i in along(u, reach[0] + shift, p) {
                self.stamp(&mut canvas, [i, j]);
            }
        }
        Ok(canvas.rgb(self.config.contrast, [0.95, 1.0, 0.9], self.config.holes))
    }

    fn is_blank(&self, _column: i64, _row: i64, _side: i64) -> bool {
        false
    }
}

impl Specimen for Lattice {
    fn finest_um(&self) -> f64 {
        self.grid.finest_um
    }

    fn levels(&self) -> usize {
        self.grid.levels
    }

    fn patch(
        &self,
        level: usize,
        x_um: [f64; 2],
        y_um: [f64; 2],
        margin: usize,
    ) -> Result<Patch, SpecimenError> {
        let w = self.grid.window(level, x_um, y_um, margin)?;
        let rgb = self.pyramid.read(&self.made, &w)?;
        Ok(self.grid.patch(&w, rgb))
    }

    fn extent_um(&self) -> Option<[f64; 4]> {
        None
    }

    fn describe(&self) -> String {
        let LatticeConfig {
            kind,
            pitch_um,
            disorder,
            ..
        } = &self.made.config;
        format!("a lattice ({kind:?}) of {pitch_um:.2} um, disorder {disorder}")
    }
}
