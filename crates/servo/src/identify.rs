//! Which objective is active, asked of the image: where only somebody's word tells, a small move of the stage shows how many
//! micrometres a pixel has.

use crate::event::tell;
use crate::kinematics::PlanarPose;
use crate::procedure::{Procedure, Progress, withdrawn};
use crate::proof::{LEAST_PX, SEEN_PX};
use crate::small_step::{SHARE, directions, place, stands};
use crate::vision::{centre_px, grab, gray, same_objective};
use crate::{Event, FrameRole, Identity, ServoError, Sink, VisionOptions};
use scopeservo_geometry::Vec2;
use scopeservo_registration::{NotFound, Prior};
use scopeservo_scope::{Axis, ErrorKind, Instrument, Objective, ObjectiveId, ScopeError};
use serde::{Deserialize, Serialize};

/// The move is at least this many times what the stage scatters, if that leaves half of the field of the objective that was told.
const SCATTERS: f64 = 20.0;
/// The move is halved at most so often when the views are not found.
const HALVINGS: u8 = 3;
/// Two arrivals may scatter by this share of the move at the most: objectives differ by more.
const SCATTER_SHARE: f64 = 0.2;
/// A view that shifts less than this share of what the weakest objective would show stays.
const STAYS: f64 = 0.33;
/// Measured over nominal um per pixel may be this, or one over this, at most: as for a calibration.
const NOMINAL_FACTOR: f64 = 1.5;
/// Objectives whose scales are nearer than this to each other look the same.
const ALIKE: f64 = 1.15;

/// The check as a step machine: three moves and two views per step. The view must be in focus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identify {
    objective: ObjectiveId,
    vision: VisionOptions,
    /// Where it began.
    home: Option<PlanarPose>,
    halvings: u8,
}

impl Identify {
    /// A check that `objective` is active.
    pub fn new(objective: ObjectiveId, vision: VisionOptions) -> Self {
        Self {
            objective,
            vision,
            home: None,
            halvings: 0,
        }
    }

    /// Moves twice by `step_m` along `along`, and sees how far the second move, which takes up no backlash, shifts the view:
    /// um per pixel. A pixel of the weakest objective has `weakest_m`.
    fn look(
        &self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        home: &PlanarPose,
        along: Vec2,
        (step_m, weakest_m): (f64, f64),
    ) -> Result<Result<f64, NotFound>, ServoError> {
        let mut see = |k: f64| -> Result<_, ServoError> {
            let pose = place(home, along, step_m, k);
            let at = scope.move_to(&pose.request(&scope.gate().position()?))?;
            let frame = grab(scope, sink, FrameRole::Identify, &self.objective)?;
            let centre = centre_px(frame.width, frame.height);
            Ok((
                PlanarPose::from(&at).x_m,
                centre,
                self.vision.of_view(&gray(scope, &frame)?)?,
            ))
        };
        let (a, centre, first) = see(1.0)?;
        let (b, _, second) = see(2.0)?;
        let prior = same_objective(0.05);
        // What is fixed to the camera stays while any objective shows the specimen move; when all stays, that is told.
        let seen_px = step_m / weakest_m;
        let moving = Prior {
            moved_px: (seen_px >= SEEN_PX).then_some(LEAST_PX),
            ..prior
        };
        let see = |prior: &Prior| self.vision.register(&second, &first, prior).outcome;
        let estimate = match see(&moving).or_else(|_| see(&prior)) {
            Ok(estimate) => estimate,
            Err(why) => return Ok(Err(why)),
        };
        let shift = estimate.target_from_view.recentred(centre, centre).offset;
        let moved_um = 1e6 * f64::hypot(b[0] - a[0], b[1] - a[1]);
        Ok(Ok(moved_um / f64::hypot(shift[0], shift[1])))
    }

    /// The objective whose nominal scale is nearest, if one is near, and whether that may be the one that was told.
    fn judge(&self, scope: &Instrument, um_per_px: f64) -> Identity {
        let off = |o: &Objective| (um_per_px / o.nominal_um_per_px).ln().abs();
        let all = scope.gate().objectives();
        let nearest = all
            .iter()
            .filter(|o| off(o) <= NOMINAL_FACTOR.ln())
            .min_by(|a, b| off(a).total_cmp(&off(b)));
        let told = all.iter().find(|o| o.id == self.objective);
        let as_told = match (nearest, told) {
            (Some(nearest), Some(told)) => {
                let apart = (nearest.nominal_um_per_px / told.nominal_um_per_px).ln();
                nearest.id == told.id || apart.abs() <= ALIKE.ln()
            }
            _ => false,
        };
        Identity {
            um_per_px,
            looks_like: match as_told {
                true => Some(self.objective.clone()),
                false => nearest.map(|o| o.id.clone()),
            },
            as_told,
        }
    }
}

impl Identify {
    fn advance(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Identity>, ServoError> {
        let home = match self.home {
            Some(home) => home,
            None => *self.home.insert(stands(scope)?),
        };
        let info = scope.camera().info();
        let side_px = info.width.min(info.height) as f64;
        let nominal = |o: &Objective| o.nominal_um_per_px * 1e-6;
        let all = || scope.gate().objectives().iter().map(nominal);
        let (finest, coarsest) = (
            all().fold(f64::INFINITY, f64::min),
            all().fold(0.0, f64::max),
        );
        let told = nominal(scope.objective(&self.objective)?);
        let scatter_m = directions(scope).first().map_or(0.0, |d| d.1);
        let most_m = 0.5 * side_px * told;
        let step_m = (SHARE * side_px * finest).max((SCATTERS * scatter_m).min(most_m))
            / f64::from(1u32 << self.halvings);
        // Where both places are allowed; the first that is refused says why when none is.
        let present = scope.gate().position()?;
        let mut refused = None;
        let free = directions(scope).into_iter().find(|(along, _)| {
            let allowed = [1.0, 2.0].iter().try_for_each(|k| {
                let pose = place(&home, *along, step_m, *k);
                scope.gate().check(&pose.request(&present))
            });
            let free = allowed.is_ok();
            refused = refused.take().or(allowed.err());
            free
        });
        let Some((along, scatter_m)) = free else {
            return Err(refused
                .unwrap_or(ScopeError::NoSuchAxis { axis: Axis::X })
                .into());
        };
        let looked = self.look(scope, sink, &home, along, (step_m, coarsest));
        // Back, also when a place or an image was refused; a stage that failed or was stopped stays.
        let stays = match &looked {
            Err(ServoError::Scope(error)) => error.kind() != ErrorKind::Refused,
            _ => false,
        };
        if !stays {
            scope.return_to(&home.request(&scope.gate().position()?))?;
        }
        let um_per_px = match looked? {
            Ok(um_per_px) => um_per_px,
            Err(_) if self.halvings < HALVINGS => {
                self.halvings += 1;
                return Ok(Progress::Continue);
            }
            Err(reason) => {
                return Err(ServoError::ObjectiveUnclear {
                    objective: self.objective.clone(),
                    reason,
                });
            }
        };
        if um_per_px * 1e-6 * STAYS > coarsest {
            return Err(ServoError::PictureStays {
                objective: self.objective.clone(),
                moved_um: step_m * 1e6,
            });
        }
        if 2.0 * scatter_m > SCATTER_SHARE * step_m {
            return Err(ServoError::StageTooCoarse {
                objective: self.objective.clone(),
                moved_um: step_m * 1e6,
                scatter_um: scatter_m * 1e6,
            });
        }
        let identity = self.judge(scope, um_per_px);
        if identity.as_told {
            scope.gate().confirm_objective();
        }
        let event = Event::Identified {
            objective: self.objective.clone(),
            identity: identity.clone(),
        };
        tell(scope, sink, event);
        Ok(Progress::Done(identity))
    }
}

impl Procedure for Identify {
    type Output = Identity;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Identity>, ServoError> {
        let ended = self.advance(scope, sink);
        withdrawn(scope, ended)
    }
}
