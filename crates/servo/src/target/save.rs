//! Saving a view: only what is seen to move with the stage counts, and what repeats itself is refused.

use super::{MIN_MOVED_FEATURES, MIN_TARGET_FEATURES, Picture, Taken, Target, trials::tried};
use crate::hand_eye::pose_sigma;
use crate::kinematics::PlanarPose;
use crate::procedure::{Procedure, Progress};
use crate::proof::{Aside, FOLLOWS, Place, Seen, Station, look_around, step_aside};
use crate::vision::{centre_px, grab, gray, same_objective};
use crate::{Calibration, FrameRole, ServoError, Sink, VisionOptions};
use scopeservo_features::{Features, GrayImage, Keypoint};
use scopeservo_registration::likeness::Pair;
use scopeservo_registration::{Estimate, Prior, find_rivals, periods, shifted, undecided};
use scopeservo_scope::{ErrorKind, Frame, Instrument, ObjectiveId, StagePose};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How a target is saved.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SaveOptions {
    /// How to look.
    pub vision: VisionOptions,
    /// Nothing may move: then nobody knows what belongs to the specimen, and the run must prove it.
    pub still: bool,
    /// The objective's calibration, when there is one.
    pub calibration: Option<Calibration>,
}

impl SaveOptions {
    /// Size of a pixel, um, when it is known better than the objective's nominal one.
    fn um_per_px(&self) -> Option<f64> {
        self.calibration.as_ref().map(Calibration::um_per_px)
    }
}

/// Saves the present view: a frame, a step aside that shows what moves with the stage, and back again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SaveTarget {
    options: SaveOptions,
    /// Where the view is, once that was asked: who goes on after a kill begins there, and not where the step aside had led.
    #[serde(default)]
    home: Option<StagePose>,
}

impl SaveTarget {
    /// Saves what is in view now.
    pub fn new(options: SaveOptions) -> Self {
        Self {
            options,
            home: None,
        }
    }

    /// Leaves out what is fixed to the camera, counts what moves, and looks for places that are alike.
    fn judge(
        &self,
        mut target: Target,
        image: &GrayImage,
        seen: &Seen,
    ) -> Result<Target, ServoError> {
        let all = target.features.len();
        target.features = seen.fixed.without(&target.features).into_owned();
        let second = seen.fixed.without(&seen.features);
        let prior = Prior {
            moved_px: Some(crate::proof::LEAST_PX),
            ..same_objective(0.05)
        };
        self.refuse_repetition(&target, image, (&seen.image, &second), &prior, |p| {
            !seen.fixed.holds(p)
        })?;
        // What neither moved nor stayed is left out as well: digits that follow the stage do that, and noise.
        let free = &target.features;
        let moves = |k: &usize| seen.parallax.of_keypoint(&free.keypoints[*k]) == Place::Moved;
        let moving: Vec<usize> = (0..free.len()).filter(moves).collect();
        if moving.len() < MIN_MOVED_FEATURES {
            return Err(ServoError::PoorTarget {
                features: all,
                moved: Some(moving.len()),
                needed: MIN_MOVED_FEATURES,
            });
        }
        let moved: Vec<Keypoint> = moving.iter().map(|&i| free.keypoints[i]).collect();
        target.mask = Some(seen.parallax.moving(free, &moved));
        target.moved = Some(moving.len());
        target.features = free.subset(&moving);
        Ok(target)
    }

    /// A second frame registered to the target, as a run will do it.
    fn refuse_repetition(
        &self,
        target: &Target,
        image: &GrayImage,
        (second, second_features): (&GrayImage, &Features),
        prior: &Prior,
        counts: impl Fn([f64; 2]) -> bool,
    ) -> Result<(), ServoError> {
        let options = &self.options.vision.registration;
        let answer = self
            .options
            .vision
            .register(second_features, &target.features, prior);
        let Some(found) = answer.found() else {
            // Of a lattice hardly a match passes the ratio test: its own periods tell.
            let still = Estimate::at_rest();
            return match shifted(&still, &target.periods_px).first() {
                None => Ok(()),
                Some(rival) => Err(ServoError::Repeats {
                    rival: *rival,
                    um_per_px: self.options.um_per_px(),
                }),
            };
        };
        let moved = prior.moved_px.is_some();
        let features = &target.features;
        let rivals = find_rivals(second_features, features, &answer, prior, options, moved);
        let pair = Pair::new(second, image, 1.0);
        // Without a move what decides may itself be fixed to the camera.
        match undecided(
            &pair,
            found,
            (image, &target.periods_px),
            &rivals,
            moved,
            counts,
        ) {
            None => Ok(()),
            Some(rival) => Err(ServoError::Repeats {
                rival,
                um_per_px: self.options.um_per_px(),
            }),
        }
    }
}

impl SaveTarget {
    /// Steps aside, and divides out the shadows on the camera where they can be told from the specimen.
    fn look_aside(
        &self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        (target, image, frame): (&mut Target, &mut GrayImage, &Arc<Frame>),
        home: &PlanarPose,
    ) -> Result<Aside, ServoError> {
        let vision = &self.options.vision;
        let objective = target.objective.clone();
        let of = (&objective, self.um_per_px(scope, &objective)?);
        let first = (&*image, &target.features);
        let go = |to: &StagePose| Ok(scope.move_to(to)?);
        let aside = step_aside(scope, sink, of, vision, first, (home, &go))?;
        if let Aside::Seen(seen) = &aside
            && !self.went_along(scope, home, seen)?
        {
            let now = PlanarPose::from(&scope.gate().position()?);
            let way_m = [0, 1].map(|k| now.x_m[k] - home.x_m[k]);
            let moved_um = 1e6 * f64::hypot(way_m[0], way_m[1]);
            return Ok(Aside::Nothing { moved_um });
        }
        if matches!(&aside, Aside::Seen(seen) if seen.fixed.is_empty()) {
            return Ok(aside);
        }
        let Some(cleaned) = look_around(scope, sink, of, vision, frame, home)? else {
            return Ok(aside);
        };
        target.picture = Some(Picture::of(&cleaned.image));
        target.periods_px = periods(&cleaned.image);
        (target.features, *image) = (cleaned.features, cleaned.image);
        Ok(Aside::Seen(Box::new(cleaned.seen)))
    }

    /// Whether what was seen to move moved as the stage did; without a calibration nobody can tell.
    fn went_along(
        &self,
        scope: &Instrument,
        home: &PlanarPose,
        seen: &Seen,
    ) -> Result<bool, ServoError> {
        let Some(calibration) = &self.options.calibration else {
            return Ok(true);
        };
        let info = scope.gate().info();
        let here = Station {
            pose: PlanarPose::from(&scope.gate().position()?),
            calibration,
            kinematics: info.kinematics,
            pose_sigma: calibration.pose_sigma(pose_sigma(info)),
            still: false,
        };
        let centre = centre_px(seen.image.width(), seen.image.height());
        let lay = seen.parallax.second_from_first.inverse();
        Ok(lay.is_some_and(|first_from_second| {
            let lay = first_from_second.apply(centre);
            let way = [lay[0] - centre[0], lay[1] - centre[1]];
            here.follows(home, way, FOLLOWS)
        }))
    }

    /// Size of a pixel: as calibrated, else as engraved.
    fn um_per_px(&self, scope: &Instrument, objective: &ObjectiveId) -> Result<f64, ServoError> {
        let nominal = scope.objective(objective)?.nominal_um_per_px;
        Ok(self.options.um_per_px().unwrap_or(nominal))
    }

    /// Tries what was saved; what nobody could come back to is not saved.
    fn tried(
        &self,
        scope: &Instrument,
        mut target: Target,
        image: &GrayImage,
    ) -> Result<Target, ServoError> {
        let um_per_px = self.um_per_px(scope, &target.objective)?;
        let objectives = scope.gate().objectives();
        let vision = &self.options.vision;
        let quality = tried(&target, image, objectives, um_per_px, vision)?;
        if quality.is_hopeless() {
            return Err(ServoError::HopelessTarget(Box::new(quality)));
        }
        target.quality = Some(quality);
        Ok(target)
    }

    fn taken(
        &self,
        scope: &Instrument,
        objective: &ObjectiveId,
        frame: Arc<Frame>,
        stage: StagePose,
    ) -> Result<Taken, ServoError> {
        Ok(Taken {
            frame,
            flat_field: scope.flat_field(),
            um_per_px: self.um_per_px(scope, objective)?,
            calibration: self.options.calibration.clone(),
            stage,
            kinematics: scope.gate().info().kinematics,
        })
    }
}

impl Procedure for SaveTarget {
    type Output = Target;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Target>, ServoError> {
        let Some(stage) = self.home else {
            self.home = Some(scope.gate().position()?);
            return Ok(Progress::Continue);
        };
        let now = scope.gate().position()?;
        let moved = scope.gate().info().axes.iter().any(|axis| {
            let both = now.si(axis.axis).zip(stage.si(axis.axis));
            both.is_some_and(|(now, then)| (now - then).abs() > axis.tolerance())
        });
        if moved && !self.options.still {
            scope.return_to(&PlanarPose::from(&stage).request(&now))?;
        }
        let vision = &self.options.vision;
        let (mut target, mut image, frame) = Target::grab(scope, vision, sink)?;
        let objective = target.objective.clone();
        let features_seen = target.features.len();
        if features_seen < MIN_TARGET_FEATURES {
            return Err(ServoError::PoorTarget {
                features: features_seen,
                moved: None,
                needed: MIN_TARGET_FEATURES,
            });
        }
        if self.options.still {
            let second = grab(scope, sink, FrameRole::Aside, &objective)?;
            let second = gray(scope, &second)?;
            let seen = vision.of_view(&second)?;
            let prior = same_objective(0.05);
            self.refuse_repetition(&target, &image, (&second, &seen), &prior, |_| true)?;
            target.taken = Some(Arc::new(self.taken(scope, &objective, frame, stage)?));
            return Ok(Progress::Done(self.tried(scope, target, &image)?));
        }
        let home = PlanarPose::from(&scope.gate().as_goal(&stage)?);
        let of = (&mut target, &mut image, &frame);
        let aside = self.look_aside(scope, sink, of, &home);
        // Back, also when a place was refused; a stage that failed or was stopped stays.
        let stays = match &aside {
            Err(ServoError::Scope(error)) => error.kind() != ErrorKind::Refused,
            _ => false,
        };
        if !stays {
            scope.return_to(&home.request(&scope.gate().position()?))?;
        }
        match aside? {
            Aside::Nothing { moved_um } => Err(ServoError::NothingMoves {
                objective,
                moved_um,
                features: features_seen,
            }),
            Aside::Seen(seen) => {
                target.taken = Some(Arc::new(self.taken(scope, &objective, frame, stage)?));
                let target = self.judge(target, &image, &seen)?;
                Ok(Progress::Done(self.tried(scope, target, &image)?))
            }
        }
    }
}
