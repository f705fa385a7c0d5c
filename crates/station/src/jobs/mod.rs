//! The jobs: one use case each, that any front end can run.
//!
//! What storage knows comes in with the input (the target, known calibrations, the size of a pixel), and what is to be kept goes out with
//! the output. A job that ends early has it in [`crate::JobHandle::kept`].

mod any;
mod calibrate;
mod check;
mod doctor;
mod focus;
mod grid;
mod identify;
mod level;
mod reposition;
mod save_target;

pub use any::{Answer, AnyJob, Request, StoredError};
pub use calibrate::{CalibrateInput, CalibrateJob, CalibrateOutput, Whole};
pub use check::{CheckInput, CheckJob, CheckOutput, Checked};
pub use doctor::{
    Check, DoctorInput, DoctorJob, DoctorOutput, Finding, Trouble, look_by_small_moves,
};
pub use focus::{FocusInput, FocusJob, FocusOutput};
pub use grid::{GridInput, GridJob, GridOutput};
pub use identify::{IdentifyInput, IdentifyJob, IdentifyOutput};
pub use level::{LevelInput, LevelJob, LevelOutput};
pub use reposition::{RepositionInput, RepositionJob, RepositionOutput};
pub use save_target::{SaveTargetInput, SaveTargetJob, SaveTargetOutput};
