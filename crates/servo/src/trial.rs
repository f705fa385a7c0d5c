//! What images tell about a stage before anything leans on it: whether it moves as far as it says, and whether the view stands.
//!
//! A stage whose unit is wrong by a thousand agrees with itself in all that it reports. Only an image shows it.

use crate::procedure::run;
use crate::small_step::{SHARE, directions, place, stands};
use crate::vision::{centre_px, gray, same_objective};
use crate::{Identify, Identity, NoSink, ServoError, VisionOptions};
use scopeservo_features::Features;
use scopeservo_geometry::Vec2;
use scopeservo_scope::{Instrument, ObjectiveId};
use std::time::Duration;

/// The first step, as a share of the one that measures the scale: were it a thousand times too long, it would not be twice as long as
/// that one.
const FIRST_SHARE: f64 = 1.0 / 500.0;
/// An image that shifts by fewer pixels than this, beyond what the stage's arrivals explain, may have shaken.
const SHAKES_PX: f64 = 3.0;
/// Between the two images of a drift.
const DRIFT_TIME: Duration = Duration::from_secs(2);

/// Views that show whether it shakes, and how much longer each waits than the one before.
const SHAKING_VIEWS: u32 = 6;
const SHAKING_TIME: Duration = Duration::from_millis(37);
/// What moves by less than this, or by fewer standard deviations, stands.
const SHAKING_PX: f64 = 1.0;
const SHAKING_SIGMAS: f64 = 4.0;

/// How fast the view moves while the stage stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// Pixels of the view a second.
    pub px_per_s: f64,
    /// Standard deviation of that.
    pub sigma_px_per_s: f64,
}

/// Moves the stage a little, sees how far the image goes, and whether that fits the objective's nominal scale. The first step is so
/// small that a unit wrong by a thousand cannot take the stage far. It comes back to where it began.
///
/// # Errors
/// [`ServoError::MovesTooFar`]; [`ServoError::PictureStays`] where it hardly moves, and the other errors of [`Identify`].
pub fn scale_seen(
    scope: &Instrument,
    objective: &ObjectiveId,
    vision: &VisionOptions,
) -> Result<Identity, ServoError> {
    first_step(scope, vision)?;
    run(
        &mut Identify::new(objective.clone(), vision.clone()),
        scope,
        &mut NoSink,
    )
}

/// How far the view goes to and fro while the stage stands: standard deviation of the distance from the mean, px. `None` where the views are
/// not found in each other, or it is within what their registration knows.
///
/// # Errors
/// What the instrument reports.
pub(crate) fn shaking_px(
    scope: &Instrument,
    vision: &VisionOptions,
) -> Result<Option<f64>, ServoError> {
    let first = look(scope, vision)?;
    let mut seen = vec![([0.0; 2], 0.0)];
    for more in 1..SHAKING_VIEWS {
        // Not as regular as what shakes.
        scope.clock().sleep(SHAKING_TIME * more);
        if let Some(shift) = shift(&first, &look(scope, vision)?, vision) {
            seen.push(shift);
        }
    }
    let count = seen.len() as f64;
    let mean = [0, 1].map(|k| seen.iter().map(|(d, _)| d[k]).sum::<f64>() / count);
    let square = |d: &Vec2| (d[0] - mean[0]).powi(2) + (d[1] - mean[1]).powi(2);
    let scatter_px = (seen.iter().map(|(d, _)| square(d)).sum::<f64>() / (count - 1.0)).sqrt();
    let sigma_px = seen.iter().map(|(_, s)| *s).fold(0.0, f64::max);
    let shakes = seen.len() > 2 && scatter_px > SHAKING_PX.max(SHAKING_SIGMAS * sigma_px);
    Ok(shakes.then_some(scatter_px))
}

fn look(scope: &Instrument, vision: &VisionOptions) -> Result<Features, ServoError> {
    vision.of_view(&gray(scope, &scope.grab()?)?)
}

/// How far the middle of the image went from one view to another, pixels, and its standard deviation; `None` when it is not found.
fn shift_px(before: &Features, after: &Features, vision: &VisionOptions) -> Option<(f64, f64)> {
    let ([x, y], sigma_px) = shift(before, after, vision)?;
    Some((f64::hypot(x, y), sigma_px))
}

/// The same along columns and rows.
fn shift(before: &Features, after: &Features, vision: &VisionOptions) -> Option<(Vec2, f64)> {
    let found = vision
        .register(after, before, &same_objective(0.05))
        .outcome;
    let estimate = found.ok()?;
    let centre = centre_px(before.width, before.height);
    let offset = estimate.target_from_view.recentred(centre, centre).offset;
    Some((offset, estimate.sigma_px))
}

/// Moves the stage by a very small step and comes back, and sees whether the image goes much farther than that: where nobody knows yet whether
/// the stage's unit is right. What cannot be told from these images is left to the larger step.
///
/// # Errors
/// [`ServoError::MovesTooFar`], and what the instrument reports.
pub fn first_step(scope: &Instrument, vision: &VisionOptions) -> Result<(), ServoError> {
    let info = scope.camera().info();
    let side_px = info.width.min(info.height) as f64;
    let scales = scope.gate().objectives().iter();
    let finest_m = scales
        .map(|o| o.nominal_um_per_px * 1e-6)
        .fold(f64::INFINITY, f64::min);
    let step_m = FIRST_SHARE * SHARE * side_px * finest_m;
    let present = scope.gate().position()?;
    let home = stands(scope)?;
    let request = |along| place(&home, along, step_m, 1.0).request(&present);
    let free = directions(scope)
        .into_iter()
        .find(|(along, _)| scope.gate().check(&request(*along)).is_ok());
    // Where there is no room for this, the larger step says so.
    let Some((along, scatter_m)) = free else {
        return Ok(());
    };
    let (before, again) = (look(scope, vision)?, look(scope, vision)?);
    if shift_px(&before, &again, vision).is_none() {
        // Nothing can be told from such images: the larger step says so, too.
        return Ok(());
    }
    scope.move_to(&request(along))?;
    let seen = shift_px(&before, &look(scope, vision)?, vision);
    let allowed_px = SHAKES_PX + (step_m + 2.0 * scatter_m) / finest_m;
    scope.return_to(&home.request(&scope.gate().position()?))?;
    match seen {
        Some((px, _)) if px <= allowed_px => Ok(()),
        _ => Err(ServoError::MovesTooFar {
            asked_um: step_m * 1e6,
            seen_px: seen.map(|s| s.0),
        }),
    }
}

/// Looks twice, two seconds apart. Nothing moves.
///
/// # Errors
/// What the instrument reports; [`ServoError::NothingToFollow`] when the second view is not found in the first.
pub fn drift_seen(scope: &Instrument, vision: &VisionOptions) -> Result<Drift, ServoError> {
    let before = look(scope, vision)?;
    let start = scope.clock().now();
    scope.clock().sleep(DRIFT_TIME);
    let after = look(scope, vision)?;
    let seconds = scope.clock().now().since(start).as_secs_f64();
    let (px, sigma_px) = shift_px(&before, &after, vision).ok_or(ServoError::NothingToFollow)?;
    Ok(Drift {
        px_per_s: px / seconds,
        sigma_px_per_s: sigma_px * std::f64::consts::SQRT_2 / seconds,
    })
}
