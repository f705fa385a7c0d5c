//! Single cells on blank glass.

use super::canvas::{Canvas, LEVELS, Lie, SAMPLE_UM};
use super::pyramid::{Grid, Pyramid, Source};
use super::shape::{Cell, Shape, rng_of};
use super::{Patch, Specimen, SpecimenError};
use crate::TwinError;
use crate::numbers::{fraction, not_negative, positive, require};
use crate::seeds;
use rand::RngExt;
use serde::{Deserialize, Serialize};

/// Single cells, each with its own look, at random places.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SparseConfig {
    /// Of places and looks.
    pub seed: u64,
    /// Cells per square millimetre, on average.
    pub per_mm2: f64,
    /// Least and most radius of a cell, um.
    pub radius_um: [f64; 2],
    /// Light that stain takes, 0..1: small for a weak stain.
    pub contrast: f64,
}

impl Default for SparseConfig {
    fn default() -> Self {
        Self {
            seed: 1,
            per_mm2: 150.0,
            radius_um: [4.0, 9.0],
            contrast: 0.8,
        }
    }
}

impl SparseConfig {
    fn check(&self) -> Result<(), TwinError> {
        require(
            not_negative(&[self.per_mm2])
                && self.per_mm2 <= 1e5
                && positive(&self.radius_um)
                && self.radius_um[0] <= self.radius_um[1]
                && self.radius_um[1] <= 50.0
                && fraction(self.contrast),
            "sparse: per_mm2 is 0 to 100000, radius_um two rising numbers up to 50, contrast 0..1",
        )
    }
}

/// Side of the squares in which cells are counted out, um.
const BLOCK_UM: f64 = 100.0;

/// A smear: single cells, and glass between them.
#[derive(Debug)]
pub struct Sparse {
    config: SparseConfig,
    grid: Grid,
    pyramid: Pyramid,
}

impl Sparse {
    /// The smear of this description. Nothing is computed before it is looked at.
    ///
    /// # Errors
    /// [`TwinError::BadConfig`] with the field and what it must be.
    pub fn new(config: SparseConfig) -> Result<Self, TwinError> {
        config.check()?;
        Ok(Self {
            config,
            grid: Grid {
                finest_um: SAMPLE_UM,
                levels: LEVELS,
                corner_um: [0.0, 0.0],
            },
            pyramid: Pyramid::new(),
        })
    }
}

impl SparseConfig {
    /// Draws the cells of one block that may reach into the tile.
    fn stamp(&self, canvas: &mut Canvas, block: [i64; 2]) {
        let mut rng = rng_of(self.seed, seeds::SPARSE, block);
        // Poisson, by waiting times.
        let mean = self.per_mm2 * BLOCK_UM * BLOCK_UM * 1e-6;
        let mut waited = 0.0;
        loop {
            waited -= (1.0 - rng.random::<f64>()).ln();
            if waited > mean {
                return;
            }
            let at_um = block.map(|b| (b as f64 + rng.random::<f64>()) * BLOCK_UM);
            let [least, most] = self.radius_um;
            let radius = least + (most - least) * rng.random::<f64>();
            let cell = Shape::Cell(Cell::draw(radius, &mut rng));
            let lie = Lie {
                at_um,
                turn: [1.0, 0.0],
            };
            canvas.stamp(&cell, &lie);
        }
    }
}

impl Source for SparseConfig {
    fn finest(&self, tx: i64, ty: i64) -> Result<Vec<u8>, SpecimenError> {
        let mut canvas = Canvas::new(tx, ty);
        let reach = Canvas::radius_um() + 1.3 * self.radius_um[1];
        let blocks = canvas.middle_um().map(|at| {
            let block = |v: f64| (v / BLOCK_UM).floor() as i64;
            block(at - reach)..=block(at + reach)
        });
        for j in blocks[1].clone() {
            for i in blocks[0].clone() {
                self.stamp(&mut canvas, [i, j]);
            }
        }
        Ok(canvas.rgb(self.contrast, [0.7, 1.0, 0.5], false))
    }

    fn is_blank(&self, _column: i64, _row: i64, _side: i64) -> bool {
        false
    }
}

impl Specimen for Sparse {
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
        let rgb = self.pyramid.read(&self.config, &w)?;
        Ok(self.grid.patch(&w, rgb))
    }

    fn extent_um(&self) -> Option<[f64; 4]> {
        None
    }

    fn describe(&self) -> String {
        format!("single cells, {} per mm^2", self.config.per_mm2)
    }
}
