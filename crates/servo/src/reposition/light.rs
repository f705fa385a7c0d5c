//! Whether a view is too dark or too bright to be seen as it was saved, and the exposure that mends it.

use crate::vision::grab;
use crate::{FrameRole, ServoError, Sink, Target};
use scopeservo_scope::{Instrument, ObjectiveId};
use std::time::Duration;

/// A sample at this share of full scale or above is saturated.
const SATURATED: f32 = 0.995;
/// More saturated samples than in the target by this share of all are too many.
const BLIND: f64 = 0.2;
/// A view that has this share of the target's light is too dark.
const DARK: f64 = 0.3;
/// An exposure is adapted until the light is within this factor of the target's.
const NEAR: f64 = 1.5;
/// So many frames at most, each exposed by this factor longer or shorter at most.
const FRAMES: usize = 5;
const STEP: f64 = 16.0;
/// What is wanted where the target has no image of its own, and at most.
const WANTED: f64 = 0.6;
const WANTED_AT_MOST: f64 = 0.85;

/// How bright an image is.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Light {
    /// What one sample in ten is above, 0 to 1.
    level: f64,
    /// Share of samples that are saturated.
    saturated: f64,
}

impl Light {
    fn of(luminance: &[f32]) -> Self {
        let mut all = luminance.to_vec();
        let at = all.len() * 9 / 10;
        let count = all.iter().filter(|v| **v >= SATURATED).count();
        let saturated = count as f64 / all.len().max(1) as f64;
        let level = match at < all.len() {
            true => f64::from(*all.select_nth_unstable_by(at, f32::total_cmp).1),
            false => 0.0,
        };
        Self { level, saturated }
    }

    /// That of the target. However dark its ground is, as in dark field, a view that has the same is exposed as it was.
    fn wanted(target: &Target) -> Self {
        let image = target.gray().ok();
        image.map_or(
            Self {
                level: WANTED,
                saturated: 0.0,
            },
            |image| Self::of(image.data()).attainable(),
        )
    }

    /// No more than can be seen not to be too bright.
    fn attainable(self) -> Self {
        Self {
            level: self.level.min(WANTED_AT_MOST),
            ..self
        }
    }

    /// By what factor to expose longer; `None` where that is near enough to what is wanted, as `far` says.
    fn factor(&self, wanted: &Self, far: f64) -> Option<f64> {
        if self.saturated > wanted.saturated + BLIND {
            // How far above is not seen.
            return Some(1.0 / STEP.sqrt());
        }
        // A ground without any light says nothing of how it was exposed.
        if wanted.level <= 0.0 {
            return None;
        }
        let factor = wanted.level / self.level.max(wanted.level / STEP).max(f64::MIN_POSITIVE);
        (factor > far || self.saturated > 0.0 && factor < 1.0 / NEAR).then_some(factor)
    }
}

/// Adapts the exposure where the view is too dark or too bright: how it was exposed before, and how since. `None` where the light is as it was
/// for the target, or the camera takes no other exposure. What fails leaves it as it was.
pub(super) fn adapt(
    scope: &Instrument,
    sink: &mut dyn Sink,
    objective: &ObjectiveId,
    target: &Target,
) -> Result<Option<[Duration; 2]>, ServoError> {
    let camera = scope.camera();
    let Ok(before) = camera.exposure() else {
        return Ok(None);
    };
    let mut now = before;
    match adapted(scope, sink, objective, target, &mut now) {
        Ok(()) => Ok((now != before).then_some([before, now])),
        Err(error) => {
            if now != before {
                // Why is the news.
                let _ = camera.set_exposure(before);
            }
            Err(error)
        }
    }
}

/// Exposes longer or shorter from frame to frame. `now`: how the camera is exposed.
fn adapted(
    scope: &Instrument,
    sink: &mut dyn Sink,
    objective: &ObjectiveId,
    target: &Target,
    now: &mut Duration,
) -> Result<(), ServoError> {
    let camera = scope.camera();
    let (wanted, info) = (Light::wanted(target), camera.info());
    let mut far = 1.0 / DARK;
    for _ in 0..FRAMES {
        let frame = grab(scope, sink, FrameRole::Identify, objective)?;
        let Some(factor) = Light::of(&frame.luminance()).factor(&wanted, far) else {
            break;
        };
        far = NEAR;
        let next = now.mul_f64(factor);
        let next = next.clamp(info.min_exposure, info.max_exposure);
        // At an end of what the camera can.
        let changes = next.as_secs_f64() / now.as_secs_f64().max(1e-9);
        if (0.9..1.1).contains(&changes) {
            break;
        }
        match camera.set_exposure(next) {
            Ok(set) => *now = set,
            Err(_) => break,
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_dark_is_exposed_longer_and_what_is_saturated_shorter() {
        let of = |level: f32| Light::of(&vec![level; 1000]);
        let wanted = of(0.6);
        let far = 1.0 / DARK;
        assert_eq!(of(0.6).factor(&wanted, far), None);
        assert_eq!(
            of(0.3).factor(&wanted, far),
            None,
            "half the light is enough"
        );
        let factor = of(0.06).factor(&wanted, far).unwrap();
        assert!((factor - 10.0).abs() < 1e-3, "{factor}");
        let factor = of(0.0).factor(&wanted, far).unwrap();
        assert!((factor - STEP).abs() < 1e-9, "{factor}");
        assert_eq!(of(1.0).factor(&wanted, far), Some(0.25));
        // White glass between tissue saturated when it was saved as well.
        let mut half = vec![1.0f32; 500];
        half.resize(1000, 0.5);
        let half = Light::of(&half);
        assert_eq!(half.factor(&half, far), None);
        assert_eq!(Light::of(&[]).level, 0.0);
        // Bright cells on a dark ground, and a sensor of 10 bits that counts to 16.
        for (ground, cells) in [(0.012f32, 0.47f32), (0.004, 0.015), (0.0, 0.3)] {
            let mut dark = vec![ground; 950];
            dark.resize(1000, cells);
            let wanted = Light::of(&dark).attainable();
            assert_eq!(Light::of(&dark).factor(&wanted, far), None, "{ground}");
        }
        // A ground of no light at all, and a hot pixel.
        let mut hot = vec![0.0f32; 949];
        hot.resize(999, 0.3);
        hot.push(1.0);
        let hot = Light::of(&hot);
        assert_eq!(hot.factor(&hot.attainable(), far), None);
        let bright = of(0.97).attainable();
        assert!((bright.level - WANTED_AT_MOST).abs() < 1e-9);
    }
}
