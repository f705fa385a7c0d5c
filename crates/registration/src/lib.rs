//! Two images, or their features, to `target_from_view`: the affine transform that takes a pixel of the view to the
//! pixel of the target showing the same thing, with its covariance and a verdict.
//!
//! 1. [`Correspondences`]: two-nearest matches of any feature engine, only between keypoints that the [`Prior`] allows.
//! 2. LO-RANSAC from single oriented matches (or from three, the paper's way), then a robust weighted fit.
//! 3. [`significance`]: a match set is *found* when so many inliers would come up by chance less than once in
//!    `1 / false_alarms` registrations, the transform is a possible one, and it is determined well enough.

#![cfg_attr(
    not(test),
    warn(
        clippy::disallowed_methods,
        clippy::disallowed_types,
        clippy::disallowed_macros
    )
)]
#![warn(clippy::too_many_lines)]

pub mod constellation;
mod contest;
mod corners;
pub mod correlation;
mod correspondences;
mod fourier;
mod grid;
pub mod likeness;
mod named;
mod options;
mod outcome;
mod period;
mod pictures;
pub mod pixels;
mod plane;
mod prior;
mod register;
mod rival;
mod search;
pub mod significance;
pub mod tracking;
mod turns;

pub use contest::undecided;
pub use correspondences::Correspondences;
pub use grid::{Grid, NoGrid, Term, find_grid, follow_grid};
pub use options::{Method, Options};
pub use outcome::{Estimate, NotFound, Registration};
pub use period::periods;
pub use pictures::{Allow, PictureVerdict, flipped, register_pictures};
pub use prior::{Prior, RotationPrior, ScalePrior, Shapes};
pub use register::{register, register_correspondences};
pub use rival::{Rival, find_rivals, shifted};
