//! What the instruments of a study look at.

use scopeservo_studies::rounds::Outcome;
use scopeservo_twin::specimen::{FileSpecimen, Lattice, LatticeConfig, Specimen, Tissue};
use std::path::Path;
use std::sync::Arc;

/// So many pieces of tissue: enough to be different, and few enough that each is painted once and not for every round.
const TISSUES: u64 = 6;
/// Rounds begin within this of the middle of a piece of tissue or a grid, um.
const TISSUE_HALF_UM: f64 = 300.0;
/// And within this of the middle of a slide, um.
const SLIDE_HALF_UM: f64 = 100.0;
/// The pitch of a grid that each of the paper's objectives shows well, um.
pub(crate) const GRID_PITCHES_UM: [f64; 3] = [100.0, 50.0, 20.0];

/// Specimens by turns.
pub(crate) enum Specimens {
    Tissue(Vec<Arc<dyn Specimen>>),
    Slide(Arc<dyn Specimen>),
    /// One for each objective.
    Grid(Vec<Arc<dyn Specimen>>),
}

impl Specimens {
    /// Procedural tissue.
    pub(crate) fn tissue() -> Self {
        let of = |seed| -> Arc<dyn Specimen> { Arc::new(Tissue::new(seed)) };
        Self::Tissue((0..TISSUES).map(of).collect())
    }

    /// One slide from a file.
    pub(crate) fn slide(path: &Path, um_per_px: Option<f64>) -> Outcome<Self> {
        Ok(Self::Slide(Arc::new(FileSpecimen::open(path, um_per_px)?)))
    }

    /// Grids of dots.
    pub(crate) fn grid() -> Outcome<Self> {
        let of = |pitch_um| -> Outcome<Arc<dyn Specimen>> {
            Ok(Arc::new(Lattice::new(LatticeConfig {
                pitch_um,
                ..LatticeConfig::default()
            })?))
        };
        let all = GRID_PITCHES_UM.into_iter().map(of);
        Ok(Self::Grid(all.collect::<Outcome<_>>()?))
    }

    /// That of a round with an objective, and how far from its middle the round may begin, um.
    pub(crate) fn of(&self, round: u64, objective: usize) -> (Arc<dyn Specimen>, f64) {
        match self {
            // Three objectives come by turns.
            Self::Tissue(all) => {
                let k = (round / 3) as usize % all.len();
                (Arc::clone(&all[k]), TISSUE_HALF_UM)
            }
            Self::Slide(slide) => (Arc::clone(slide), SLIDE_HALF_UM),
            Self::Grid(all) => (Arc::clone(&all[objective]), TISSUE_HALF_UM),
        }
    }
}
