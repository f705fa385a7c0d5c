//! Joint calibration: every overlapping pair of views along a path much longer than one view, and the stage's repeatability as a prior,
//! solved for everything at once.
//!
//! Unknown are the map of each objective, the rotation centre, the backlash of each axis and where every view truly was. The paper's two
//! steps (`hand_eye`) use views that all overlap one reference: their moves are no longer than a field, and what the stage scatters spoils
//! them. A chain of views measures moves of many fields by the same images, and rotations about the view's centre widen to degrees, so that
//! the same scatter counts a tenth as much.
//!
//! Objectives of one microscope, each with a fit of its own, are one instrument: [`one_instrument`].
//!
//! The mathematics only: [`next_view`] says where to look next, [`fit()`] what the views say. No instrument, no image here.

mod equations;
mod fit;
mod link;
mod minimise;
mod model;
mod path;
mod plan;
mod play;
mod prospect;
mod set;
mod sight;
mod single;
mod start;
mod three;
mod whole;

pub use fit::{JointFit, fit};
pub use link::{Link, Seen};
pub use model::{Instrument, Optics, Pair, Priors, View};
pub use path::{next_view, partners};
pub use plan::{Known, Next, PathOptions, Role, Taken};
pub use set::one_instrument;
pub use single::{Apart, Difference, Differing, SetFit, Shared, Single};
