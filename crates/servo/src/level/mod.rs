//! How the specimen is tilted against the focal plane, as the focus sees it, and levelling it on a stage that tips.
//!
//! Each block of the view has a height at which it is sharpest (`blocks`); a robust plane through these (`plane`) is the tilt, which `tilt`
//! puts into words for people: slopes, what they cost at a corner, and whether the data show them at all. `measure` is the sweep that looks.
//! `tip` turns an axis a little at a time: the specimen may come nearer by that, so the stage retreats before, by the longest lever that
//! there can be, and what the focus does afterwards tells the lever. `procedure` levels: it learns what each axis does to the tilt by a small turn
//! of it, and believes nothing that the stage says of its directions.

mod blocks;
mod error;
mod lever;
mod measure;
mod options;
mod plane;
mod procedure;
mod tilt;
mod tip;

pub use blocks::BlockHeight;
pub use error::LevelError;
pub use measure::MeasureTilt;
pub use options::{LevelOptions, LevelReport, Levelled};
pub use procedure::Level;
pub use tilt::{StageTilt, Tilt, TiltReport};
