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
mod calibration;
mod chain;
mod changes;
mod focus;
mod matches;
mod model;
mod page;
mod picture;
mod plots;
mod provenance;
mod recorder;
mod summary;
mod svg;
mod text;
mod timeline;
mod views;
mod work;

pub use model::{
    Context, Convergence, Failure, InUse, TrueCalibration, TrueIteration, Truth, Work, WorkEnd,
};
pub use page::html;
pub use recorder::Recorder;
pub use work::work_html;
