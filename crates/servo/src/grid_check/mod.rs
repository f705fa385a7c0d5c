//! A pattern slide as a check that knows nothing of tissue: kx, ky, the camera's angle, distortion and the stage's own scale, from a grid of
//! known pitch (the role that Zhang's and Tsai's methods play in the paper's Table II).
//!
//! `plan` says where to go, `follow` counts the periods between two views, `numbers` makes figures of what was seen (`optics` those of the map), `compare` holds them
//! against a calibration, and `procedure` moves and looks.

mod compare;
mod follow;
mod numbers;
mod optics;
mod plan;
mod procedure;
mod report;

pub use compare::{Compared, Comparison, compare_with};
pub use optics::Quantity;
pub use procedure::{GridCheck, GridOptions};
pub use report::{GridReading, GridReport, Known, StageSeen};
