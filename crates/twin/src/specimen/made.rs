//! Specimens that need no file, by their description.

use super::{Blank, Lattice, LatticeConfig, Sparse, SparseConfig, Specimen, Tissue, Twice};
use crate::TwinError;
use crate::config::{finite, positive, require};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The description of a specimen that needs no file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum MadeSpecimen {
    /// Glass with nothing on it.
    Blank {},
    /// Procedural tissue.
    Tissue {
        /// Of everything that is drawn.
        seed: u64,
    },
    /// Single cells on glass.
    Sparse(SparseConfig),
    /// What repeats itself.
    Lattice(LatticeConfig),
    /// Procedural tissue of which a piece is there a second time.
    Twice {
        /// Of the tissue.
        seed: u64,
        /// Middle of the piece, um.
        original_um: [f64; 2],
        /// Middle of its copy, um.
        copy_um: [f64; 2],
        /// Sides of both, um.
        size_um: [f64; 2],
    },
}

impl MadeSpecimen {
    /// Makes it.
    ///
    /// # Errors
    /// [`TwinError::BadConfig`] with the field and what it must be.
    pub fn make(&self) -> Result<Arc<dyn Specimen>, TwinError> {
        Ok(match self {
            Self::Blank {} => Arc::new(Blank),
            Self::Tissue { seed } => Arc::new(Tissue::new(*seed)),
            Self::Sparse(config) => Arc::new(Sparse::new(config.clone())?),
            Self::Lattice(config) => Arc::new(Lattice::new(config.clone())?),
            Self::Twice {
                seed,
                original_um,
                copy_um,
                size_um,
            } => {
                require(
                    finite(original_um) && finite(copy_um) && positive(size_um),
                    "twice: places must be numbers and sizes above 0",
                )?;
                let tissue = Arc::new(Tissue::new(*seed));
                Arc::new(Twice::new(tissue, *original_um, *copy_um, *size_um))
            }
        })
    }
}
