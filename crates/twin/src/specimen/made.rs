//! Specimens that need no file, by their description.

use super::{Blank, Lattice, LatticeConfig, Sparse, SparseConfig, Specimen, Tissue, Twice};
use crate::TwinError;
use crate::numbers::{finite, positive, require};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The description of a specimen that needs no file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum MadeSpecimen {
    /// Glass with nothing on it.
    Blank {},
    /// Single cells on glass.
    Sparse(SparseConfig),
    /// What repeats itself.
    Lattice(LatticeConfig),
    /// Procedural tissue of which a piece is there a second time.
    Twice(TwiceConfig),
}

/// Procedural tissue and the piece of it that is there twice.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwiceConfig {
    /// Of the tissue.
    #[serde(default = "one")]
    pub seed: u64,
    /// Middle of the piece, um.
    pub original_um: [f64; 2],
    /// Middle of its copy, um.
    pub copy_um: [f64; 2],
    /// Sides of both, um.
    pub size_um: [f64; 2],
}

fn one() -> u64 {
    1
}

impl MadeSpecimen {
    /// Makes it.
    ///
    /// # Errors
    /// [`TwinError::BadConfig`] with the field and what it must be.
    pub fn make(&self) -> Result<Arc<dyn Specimen>, TwinError> {
        Ok(match self {
            Self::Blank {} => Arc::new(Blank),
            Self::Sparse(config) => Arc::new(Sparse::new(config.clone())?),
            Self::Lattice(config) => Arc::new(Lattice::new(config.clone())?),
            Self::Twice(twice) => {
                require(
                    finite(&twice.original_um)
                        && finite(&twice.copy_um)
                        && positive(&twice.size_um),
                    "twice: places must be numbers and sizes above 0",
                )?;
                let tissue = Arc::new(Tissue::new(twice.seed));
                Arc::new(Twice::new(
                    tissue,
                    twice.original_um,
                    twice.copy_um,
                    twice.size_um,
                ))
            }
        })
    }
}
