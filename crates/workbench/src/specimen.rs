//! What lies under a simulated microscope of this program, and a picture in its place.

use crate::Workbench;
use scopeservo_twin::specimen::{FileSpecimen, Specimen};
use std::path::Path;
use std::sync::{Arc, PoisonError};
use thiserror::Error;

/// Why a picture cannot lie under the microscope.
#[derive(Debug, Error)]
pub enum LayError {
    /// There is no simulated microscope of this program.
    #[error("a picture can only lie under a simulated microscope")]
    NoTwin,
    /// It cannot be read.
    #[error("{what}")]
    Unreadable {
        /// What is wrong with it.
        what: String,
    },
}

impl Workbench {
    /// Lays a picture with pixels of that size, um, under the simulated microscope, its middle in the middle of the view; what lay there at
    /// first without.
    ///
    /// # Errors
    /// [`LayError`]; then nothing is changed.
    pub fn lay(&self, picture: Option<(&Path, f64)>) -> Result<(), LayError> {
        let twin = self.twin.as_ref().ok_or(LayError::NoTwin)?;
        let new: Option<Arc<dyn Specimen>> = match picture {
            None => None,
            Some((path, um_per_px)) => {
                let opened = FileSpecimen::open(path, Some(um_per_px));
                let opened = opened.map_err(|e| LayError::Unreadable {
                    what: e.to_string(),
                })?;
                Some(Arc::new(opened))
            }
        };
        let first = &self.first_specimen;
        let mut first = first.lock().unwrap_or_else(PoisonError::into_inner);
        match (new, first.take()) {
            (None, None) => return Ok(()),
            (None, Some(before)) => drop(twin.replace_specimen(before)),
            (Some(new), before) => {
                let was = twin.replace_specimen(new);
                *first = Some(before.unwrap_or(was));
            }
        }
        twin.centre_specimen([0.0; 2], 0.0);
        Ok(())
    }
}
