//! A saved view, and the saving: only what is seen to move with the stage counts, and what repeats itself is refused.

use crate::hand_eye::pose_sigma;
use crate::kinematics::PlanarPose;
use crate::procedure::{Procedure, Progress};
use crate::proof::Place;
use crate::proof::look_around;
use crate::proof::{Aside, Seen, step_aside};
use crate::proof::{FOLLOWS, Station};
use crate::vision::{centre_px, features, grab, gray, same_objective};
use crate::{Calibration, FrameRole, ServoError, Sink, VisionOptions};
use base64::Engine as _;
use scopeservo_registration::likeness::Pair;
use scopeservo_registration::{
    Estimate, Prior, Rival, find_rivals, periods, register, shifted, undecided,
};
use scopeservo_scope::{
    ErrorKind, FlatField, Frame, Instrument, Kinematics, ObjectiveId, StagePose,
};
use scopeservo_sift::{Features, GrayImage};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Fewer features than this and a target cannot be told from others.
pub(crate) const MIN_TARGET_FEATURES: usize = 30;
/// Of those that were seen to move with the stage so many are enough: none of them is noise or dust.
const MIN_MOVED_FEATURES: usize = 15;

/// A saved view: its features and what made it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Target {
    /// The objective it was taken with.
    pub objective: ObjectiveId,
    /// Its features, made with the target settings; those that a step aside showed to move with the stage, when one was made.
    pub features: Features,
    /// Its luminance, to tell places that look alike from each other. Targets saved earlier lack it.
    #[serde(default)]
    pub picture: Option<Picture>,
    /// Shifts under which it looks like itself, pixels; none of what is there only once.
    #[serde(default)]
    pub periods_px: Vec<[f64; 2]>,
    /// How many of its features were seen to move with the stage; `None` when it was saved without moving, so that a run must
    /// prove it.
    #[serde(default)]
    pub moved: Option<usize>,
    /// How it was taken. Targets saved earlier lack it.
    #[serde(skip)]
    pub taken: Option<Arc<Taken>>,
}

/// The frame that a target was made of, and what is known of how it was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct Taken {
    /// As the camera gave it, in full depth.
    pub frame: Arc<Frame>,
    /// What lay on the camera then.
    pub flat_field: Option<Arc<FlatField>>,
    /// Size of a pixel on the specimen, um: as calibrated, else as engraved.
    pub um_per_px: f64,
    /// The objective's calibration then.
    pub calibration: Option<Calibration>,
    /// Where the stage said it was.
    pub stage: StagePose,
    /// Which side the stage moves.
    pub kinematics: Kinematics,
}

impl Taken {
    /// The grey picture, without the shadows on the camera, as features are made of it.
    ///
    /// # Errors
    /// [`ServoError::Features`] when it has no pixels.
    pub fn gray(&self) -> Result<GrayImage, ServoError> {
        crate::vision::gray_of(&self.frame, self.flat_field.as_deref())
    }
}

impl Target {
    /// Grabs the present view as a target without moving anything: nobody knows yet what of it belongs to the specimen.
    ///
    /// # Errors
    /// Instrument and detector errors; [`ServoError::CannotGoOn`] when no objective is in the beam.
    pub fn save(
        scope: &Instrument,
        options: &VisionOptions,
        sink: &mut dyn Sink,
    ) -> Result<Self, ServoError> {
        Ok(Self::grab(scope, options, sink)?.0)
    }

    fn grab(
        scope: &Instrument,
        options: &VisionOptions,
        sink: &mut dyn Sink,
    ) -> Result<(Self, GrayImage, Arc<Frame>), ServoError> {
        let objective = scope.gate().current_objective()?.ok_or_else(|| {
            ServoError::CannotGoOn("no objective is in the beam; select one and try again".into())
        })?;
        let frame = grab(scope, sink, FrameRole::Target, &objective)?;
        let image = gray(scope, &frame)?;
        let target = Self {
            objective,
            features: features(&image, &options.target)?,
            picture: Some(Picture::of(&image)),
            periods_px: periods(&image),
            moved: None,
            taken: None,
        };
        Ok((target, image, frame))
    }
}

/// A grey picture in 8 bits, from its darkest to its brightest place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` bytes, row by row, in base64.
    gray: String,
}

impl Picture {
    /// Of a grey image.
    pub fn of(image: &GrayImage) -> Self {
        // Single hot and dead pixels must not set the range.
        let mut sorted = image.data().to_vec();
        let end = sorted.len() / 1000;
        let low = *sorted.select_nth_unstable_by(end, f32::total_cmp).1;
        let last = sorted.len() - 1 - end;
        let high = *sorted.select_nth_unstable_by(last, f32::total_cmp).1;
        let scale = 255.0 / (high - low).max(f32::MIN_POSITIVE);
        let level = |v: &f32| ((v - low) * scale + 0.5).clamp(0.0, 255.0) as u8;
        let bytes: Vec<u8> = image.data().iter().map(level).collect();
        Self {
            width: image.width(),
            height: image.height(),
            gray: base64::engine::general_purpose::STANDARD.encode(bytes),
        }
    }

    /// The picture, 0 to 1; `None` when it was damaged.
    pub fn image(&self) -> Option<GrayImage> {
        let bytes = base64::engine::general_purpose::STANDARD
            .decode(&self.gray)
            .ok()?;
        let data = bytes.into_iter().map(|v| f32::from(v) / 255.0).collect();
        GrayImage::new(self.width, self.height, data).ok()
    }
}

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
        let answer = register(second_features, &target.features, prior, options);
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
        let mut rivals = shifted(found, &target.periods_px);
        rivals.extend(find_rivals(
            second_features,
            features,
            &answer,
            prior,
            options,
            moved,
        ));
        let pair = Pair::new(second, image, 1.0);
        // Without a move what decides may itself be fixed to the camera.
        match undecided(&pair, &found.target_from_view, &rivals, moved, counts) {
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
        let aside = step_aside(scope, sink, of, vision, first, home)?;
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
            pose_sigma: pose_sigma(info),
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
            scope.move_to(&PlanarPose::from(&stage).request(&now))?;
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
            let seen = features(&second, &vision.view)?;
            let prior = same_objective(0.05);
            self.refuse_repetition(&target, &image, (&second, &seen), &prior, |_| true)?;
            target.taken = Some(Arc::new(self.taken(scope, &objective, frame, stage)?));
            return Ok(Progress::Done(target));
        }
        let home = PlanarPose::from(&stage);
        let of = (&mut target, &mut image, &frame);
        let aside = self.look_aside(scope, sink, of, &home);
        // Back, also when a place was refused; a stage that failed or was stopped stays.
        let stays = match &aside {
            Err(ServoError::Scope(error)) => error.kind() != ErrorKind::Refused,
            _ => false,
        };
        if !stays {
            scope.move_to(&home.request(&scope.gate().position()?))?;
        }
        match aside? {
            Aside::Nothing { moved_um } => Err(ServoError::NothingMoves {
                objective,
                moved_um,
                features: features_seen,
            }),
            Aside::Seen(seen) => {
                target.taken = Some(Arc::new(self.taken(scope, &objective, frame, stage)?));
                Ok(Progress::Done(self.judge(target, &image, &seen)?))
            }
        }
    }
}

/// What a rival is, for people: the way from one place to the other that looks like it.
pub(crate) fn rival_in_words(rival: &Rival, um_per_px: Option<f64>) -> String {
    let [x, y] = rival.shift_px;
    let turned = match rival.turn_rad.to_degrees() {
        deg if deg.abs() >= 0.5 => format!(", turned by {deg:.0} deg"),
        _ => String::new(),
    };
    match um_per_px {
        Some(um) => format!(
            "{:.1}, {:.1} um ({x:.0}, {y:.0} px{turned})",
            x * um,
            y * um
        ),
        None => format!("{x:.0}, {y:.0} px{turned}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_comes_back_from_json_and_a_hot_pixel_does_not_set_its_range() {
        let image = GrayImage::from_fn(50, 40, |x, y| match (x, y) {
            (7, 7) => 90.0,
            _ => 0.2 + 0.001 * (x + y) as f32,
        })
        .unwrap();
        let picture = Picture::of(&image);
        let json = serde_json::to_string(&picture).unwrap();
        let back: Picture = serde_json::from_str(&json).unwrap();
        assert_eq!(back, picture);
        let shown = back.image().unwrap();
        assert!(shown.get(40, 30) - shown.get(5, 5) > 0.5);
        let damaged: Picture =
            serde_json::from_str(&json.replace("\"width\":50", "\"width\":51")).unwrap();
        assert_eq!(damaged.image(), None);
    }
}
