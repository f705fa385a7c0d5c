//! A step aside: the stage moves the view a little, and what does not move along is fixed to the camera.

use super::fixed::{FixedPlaces, Parallax};
use crate::event::tell;
use crate::small_step::{directions, place};
use crate::vision::{grab, gray};
use crate::{Event, FrameRole, PlanarPose, ServoError, Sink, VisionOptions};
use scopeservo_features::{Features, GrayImage};
use scopeservo_geometry::Vec2;
use scopeservo_scope::{Axis, Instrument, ObjectiveId, ScopeError, StagePose};

/// So far the view must be seen to move, pixels: what stays and what moves is then told apart without doubt.
pub(crate) const SEEN_PX: f64 = 12.0;
/// The first step, pixels: a little more, for a view that was a pixel off and a scale that is only nominal.
const FIRST_STEP_PX: f64 = 16.0;
/// Seen from the goal it must be as far, also when the view was not quite there.
const MARGIN_PX: f64 = 1.5;
/// The step doubles up to this share of the shorter side: backlash in the drive may swallow a small one.
const LONGEST_SHARE: f64 = 0.25;

/// How the stage goes to a place.
pub(crate) type Goes<'a> = &'a dyn Fn(&StagePose) -> Result<StagePose, ServoError>;

/// What a step aside showed.
pub(crate) enum Aside {
    /// The specimen moved.
    Seen(Box<Seen>),
    /// Nothing did.
    Nothing {
        /// The longest step, um.
        moved_um: f64,
    },
}

/// The second frame of a step aside, and what it tells of the first.
pub(crate) struct Seen {
    pub(crate) parallax: Parallax,
    pub(crate) fixed: FixedPlaces,
    pub(crate) image: GrayImage,
    pub(crate) features: Features,
}

/// The steps to try, pixels.
fn steps(shorter_px: usize) -> Vec<f64> {
    let longest = LONGEST_SHARE * shorter_px as f64;
    let doubling = std::iter::successors(Some(FIRST_STEP_PX), |s| Some(2.0 * s));
    let mut steps: Vec<f64> = doubling.take_while(|s| *s < longest).collect();
    steps.push(longest.max(FIRST_STEP_PX));
    steps
}

/// Moves (by `go`) away from `home`, where the frame `first` was taken, until the view is seen to have moved, and stays there.
pub(crate) fn step_aside(
    scope: &Instrument,
    sink: &mut dyn Sink,
    (objective, um_per_px): (&ObjectiveId, f64),
    vision: &VisionOptions,
    (first, first_features): (&GrayImage, &Features),
    (home, go): (&PlanarPose, Goes<'_>),
) -> Result<Aside, ServoError> {
    let steps = steps(first.width().min(first.height()));
    let longest = steps[steps.len() - 1];
    let mut gone_um: f64 = 0.0;
    let mut refused = None;
    // One way first; along the lines of a grating, or into the backlash of a drive, another way may show more.
    let others = directions(scope)
        .into_iter()
        .skip(1)
        .map(|(along, _)| (Some(along), longest));
    let ways = steps.iter().map(|step_px| (None, *step_px)).chain(others);
    for (along, step_px) in ways {
        let step_m = step_px * um_per_px * 1e-6;
        let way = match along {
            None => free_direction(scope, home, step_m),
            Some(along) => is_free(scope, home, along, step_m).map(|()| along),
        };
        let along = match way {
            Ok(along) => along,
            Err(why) => {
                refused = refused.or(Some(why));
                continue;
            }
        };
        let to = place(home, along, step_m, 1.0);
        go(&to.request(&scope.gate().position()?))?;
        gone_um = gone_um.max(step_m * 1e6);
        let frame = grab(scope, sink, FrameRole::Aside, objective)?;
        let (seen, seen_px) = look(vision, (first, first_features), gray(scope, &frame)?)?;
        let event = Event::SteppedAside {
            objective: objective.clone(),
            step_px,
            seen_px,
            fixed: seen.as_ref().map_or(0, |seen| seen.fixed.len()),
        };
        tell(scope, sink, event);
        if let Some(seen) = seen {
            return Ok(Aside::Seen(Box::new(seen)));
        }
    }
    match refused {
        Some(why) if gone_um == 0.0 => Err(why.into()),
        _ => Ok(Aside::Nothing { moved_um: gone_um }),
    }
}

/// What an image from elsewhere tells of the first one, when it is seen to be far enough away; and how far it is.
pub(crate) fn look(
    vision: &VisionOptions,
    first: (&GrayImage, &Features),
    image: GrayImage,
) -> Result<(Option<Seen>, Option<f64>), ServoError> {
    let second = vision.of_view(&image)?;
    let seen = Parallax::of(first, (&image, &second), vision);
    let seen_px = seen
        .as_ref()
        .map(|s| s.motion_px(image.width(), image.height()));
    let enough = seen.filter(|_| seen_px.is_some_and(|px| px >= SEEN_PX + MARGIN_PX));
    let seen = enough.map(|parallax| Seen {
        fixed: parallax.fixed(first.1),
        parallax,
        image,
        features: second,
    });
    Ok((seen, seen_px))
}

pub(crate) fn is_free(
    scope: &Instrument,
    home: &PlanarPose,
    along: Vec2,
    step_m: f64,
) -> Result<(), ScopeError> {
    let present = scope.gate().position()?;
    let to = place(home, along, step_m, 1.0);
    scope.gate().check(&to.request(&present))
}

/// A direction in x or y in which a step is allowed; the first refusal when none is.
fn free_direction(scope: &Instrument, home: &PlanarPose, step_m: f64) -> Result<Vec2, ScopeError> {
    let mut refused = None;
    for (along, _) in directions(scope) {
        match is_free(scope, home, along, step_m) {
            Ok(()) => return Ok(along),
            Err(why) => refused = refused.or(Some(why)),
        }
    }
    Err(refused.unwrap_or(ScopeError::NoSuchAxis { axis: Axis::X }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_double_up_to_a_quarter_of_the_shorter_side() {
        assert_eq!(steps(480), [16.0, 32.0, 64.0, 120.0]);
        assert_eq!(steps(300), [16.0, 32.0, 64.0, 75.0]);
        assert_eq!(steps(32), [16.0]);
    }
}
