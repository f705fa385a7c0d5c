//! One suite for every stage, camera and nosepiece: simulated, emulated or real.
//!
//! Each check returns a sentence on failure. Run it without a specimen that matters. It moves x and y by up to 2 mm, other
//! axes by up to 20 um or 0.01 rad, both ways, focus only away from the specimen and back, all inside the limits. A check that
//! fails stops the stage and goes back to where it began.

mod camera;
mod check;
mod nosepiece;
mod replug;
mod stage;
mod together;
mod trial;

pub use camera::{check_camera, check_frames};
pub use check::Check;
pub use nosepiece::check_nosepiece;
pub use replug::check_replug;
pub use stage::{check_speed, check_stage};
pub use together::check_together;

use crate::Instrument;

/// Runs the whole suite on an instrument.
pub fn check_instrument(scope: &Instrument) -> Vec<Check> {
    let mut checks = check_stage(scope);
    checks.extend(check_camera(scope));
    checks.extend(check_together(scope));
    checks.extend(check_nosepiece(scope));
    checks
}
