//! Checks of a camera.

use super::check::{Check, ensure, run, said};
use crate::{Instrument, Samples};

/// Camera checks: those of [`check_frames`], and that the exposure is honoured. Nothing moves.
pub fn check_camera(scope: &Instrument) -> Vec<Check> {
    let mut checks = check_frames(scope);
    checks.push(check_exposure(scope));
    checks
}

/// Frame shape and time stamps. Nothing moves and nothing is set.
pub fn check_frames(scope: &Instrument) -> Vec<Check> {
    let camera = scope.camera();
    vec![
        run("frames have the size they claim", || {
            let frame = scope.grab().map_err(said)?;
            let info = camera.info();
            let samples = match &frame.samples {
                Samples::U8(s) => s.len(),
                Samples::U16(s) => s.len(),
            };
            ensure(
                frame.width == info.width
                    && frame.height == info.height
                    && samples == info.width * info.height * info.channels.count(),
                || format!("{}x{} with {samples} samples", frame.width, frame.height),
            )
        }),
        run("a frame begins after it was asked for", || {
            let mut last = None;
            for _ in 0..3 {
                let asked = scope.clock().now();
                let frame = scope.grab().map_err(said)?;
                ensure(frame.exposure_start >= asked, || {
                    format!(
                        "exposed {} s before it was asked for",
                        asked.since(frame.exposure_start).as_secs_f64()
                    )
                })?;
                ensure(last < Some(frame.sequence), || {
                    "sequence numbers do not rise".into()
                })?;
                last = Some(frame.sequence);
            }
            Ok(())
        }),
    ]
}

/// The exposure is set for a moment, and set back whatever comes of it.
fn check_exposure(scope: &Instrument) -> Check {
    let camera = scope.camera();
    run(
        "exposure is honoured, and refused outside its range",
        || {
            let info = camera.info();
            let before = camera.exposure().map_err(said)?;
            let half = (before / 2).max(info.min_exposure);
            let tried = (|| -> Result<_, String> {
                let set = camera.set_exposure(half).map_err(said)?;
                let frame = scope.grab().map_err(said)?;
                let refused = camera.set_exposure(info.max_exposure * 2);
                Ok((set, frame.exposure, refused))
            })();
            camera.set_exposure(before).map_err(said)?;
            let (set, seen, refused) = tried?;
            ensure(seen == set, || {
                format!("set {set:?}, the frame says {seen:?}")
            })?;
            ensure(refused.is_err(), || "twice the longest was accepted".into())
        },
    )
}
