//! What the instruments of a study look at.

use scopeservo_studies::rounds::Outcome;
use scopeservo_twin::specimen::{FileSpecimen, Specimen, Tissue};
use std::path::Path;
use std::sync::Arc;

/// So many pieces of tissue: enough to be different, and few enough that each is painted once and not for every round.
const TISSUES: u64 = 6;
/// Rounds begin within this of the middle of a piece of tissue, um.
const TISSUE_HALF_UM: f64 = 300.0;
/// And within this of the middle of a slide, um.
const SLIDE_HALF_UM: f64 = 100.0;

/// Specimens by turns, and how far from their middle a round may begin, um.
pub(crate) struct Specimens {
    all: Vec<Arc<dyn Specimen>>,
    half_um: f64,
}

impl Specimens {
    /// Procedural tissue.
    pub(crate) fn tissue() -> Self {
        let of = |seed| -> Arc<dyn Specimen> { Arc::new(Tissue::new(seed)) };
        Self {
            all: (0..TISSUES).map(of).collect(),
            half_um: TISSUE_HALF_UM,
        }
    }

    /// One slide from a file.
    pub(crate) fn slide(path: &Path, um_per_px: Option<f64>) -> Outcome<Self> {
        Ok(Self {
            all: vec![Arc::new(FileSpecimen::open(path, um_per_px)?)],
            half_um: SLIDE_HALF_UM,
        })
    }

    /// That of a round.
    pub(crate) fn of(&self, round: u64) -> (Arc<dyn Specimen>, [f64; 2]) {
        // Three objectives come by turns.
        let k = (round / 3) as usize % self.all.len();
        (Arc::clone(&self.all[k]), [self.half_um; 2])
    }
}
