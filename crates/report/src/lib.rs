//! A run as one self-contained HTML file: the answer first, then how it is known.
//!
//! A [`Recorder`] listens while a run happens. [`html`] turns what it heard into a page of inline SVG and embedded
//! images that loads nothing from anywhere. What a run did not come to is said in a sentence where it would stand.
//!
//! Known to this crate: events, frames, calibrations. Unknown: how they came about, and files.

#![warn(clippy::too_many_lines)]
#![cfg_attr(
    not(test),
    warn(
        clippy::disallowed_methods,
        clippy::disallowed_types,
        clippy::disallowed_macros
    )
)]

mod blocks;
mod bullseye;
mod calibration;
mod chain;
mod changes;
mod focus;
mod matches;
mod model;
mod page;
mod picture;
mod plots;
mod promises;
mod provenance;
mod recorder;
mod shown;
mod stored;
mod summary;
mod svg;
mod text;
mod tilt;
mod timeline;
mod told;
mod views;
mod work;

pub use model::{
    Context, Convergence, Failure, TrueCalibration, TrueIteration, Truth, Work, WorkEnd,
};
pub use page::html;
pub use recorder::Recorder;
pub use stored::Stored;
pub use work::work_html;
