//! Whether the images obey the stage's axes: each moves them, the two of the plane across each other, the rotation to the side that these tell,
//! and at the end all of them still do.

use super::Chain;
use crate::calibrate::joint::{JointFit, Known, Role, Taken};
use crate::hand_eye::pose_sigma;
use crate::kinematics::PlanarPose;
use crate::trial::shaking_px;
use crate::{Calibration, ServoError};
use scopeservo_geometry::Vec2;
use scopeservo_scope::{Axis, Instrument, Kinematics};

/// An axis that moves the image by less than this share of what is asked stands.
const STANDS: f64 = 0.25;
/// Two axes whose directions have a greater cosine than this move the image the same way.
const ALIKE: f64 = 0.7;
/// Moves of fewer standard deviations of the stage's scatter tell nothing.
const SURE_SIGMAS: f64 = 8.0;
/// Two steps are compared within so many standard deviations of what their ends scatter.
const SCATTERS: f64 = 2.0;
/// How an image turns is told by so many views.
const LATEST: usize = 4;
/// No angle is known better, rad; and the share of what was asked is known when it is known to so much.
const LEAST_ANGLE_RAD: f64 = 5e-5;
const SURE_SHARE: f64 = 0.12;
/// So many views that must overlap with earlier ones are not found when the stage does not go where it says: fewer may have had an accident.
const LOST: usize = 3;
/// No microscope has its axis of rotation farther away, m.
const FARTHEST_M: f64 = 0.7;
/// At the end the view may be beside where it should be by so many px, and by so many standard deviations of the stage's scatter.
const ASTRAY_PX: f64 = 3.0;
const ASTRAY_SIGMAS: f64 = 6.0;
/// Of the reference's light a view has less when the light is off.
const DARK: f64 = 0.1;

impl Chain {
    /// Refuses a view that is dark where the first was not.
    pub(super) fn lit(&mut self, mean: f64) -> Result<(), ServoError> {
        let first = *self.light.get_or_insert(mean);
        match mean < DARK * first {
            true => Err(ServoError::WentDark {
                objective: self.objective.id.clone(),
                views: self.taken.len(),
            }),
            false => Ok(()),
        }
    }

    /// Refuses what the last view contradicts.
    pub(super) fn obeys(&self, scope: &Instrument) -> Result<(), ServoError> {
        let Some(last) = self.taken.last() else {
            return Ok(());
        };
        match last.role {
            Role::Corner { index: 1, .. } if last.found => self.plane(scope),
            Role::Widen { .. } | Role::Sweep { .. } if last.found => {
                self.turns_wrongly(scope).map_or(Ok(()), Err)
            }
            Role::Return if last.found => self.alike(scope),
            Role::Return | Role::Widen { .. } | Role::Sweep { .. } => self.follows(scope),
            _ => Ok(()),
        }
    }

    /// The displacements of the image that the two corners show, px, with the distances that were asked for along x and y, m.
    fn corners(&self) -> Option<([Vec2; 2], [f64; 2])> {
        let corner = |wanted: u8| {
            let is = |t: &Taken| {
                t.found && matches!(t.role, Role::Corner { index, .. } if index == wanted)
            };
            let k = self.taken.iter().rposition(is)?;
            Some((self.places[k]?.centre_px, self.taken[k].asked.x_m))
        };
        let reference = self.taken.first()?.asked.x_m;
        let ((a_px, a_m), (b_px, b_m)) = (corner(0)?, corner(1)?);
        let across = [b_px[0] - a_px[0], b_px[1] - a_px[1]];
        Some(([a_px, across], [a_m[0] - reference[0], b_m[1] - a_m[1]]))
    }

    /// Whether the first moves showed the scale that is engraved.
    pub(super) fn began_as_engraved(&self) -> bool {
        self.corners().is_some_and(|([a, b], [x_m, y_m])| {
            let seen_px2 = (a[0] * b[1] - a[1] * b[0]).abs();
            let um_per_px = 1e6 * (x_m * y_m / seen_px2).abs().sqrt();
            let factor = um_per_px / self.objective.nominal_um_per_px;
            factor.max(1.0 / factor) <= self.options.nominal_factor
        })
    }

    /// Each axis of the plane moves the image, and not as the other does.
    fn plane(&self, scope: &Instrument) -> Result<(), ServoError> {
        let Some((seen, asked_m)) = self.corners() else {
            return Ok(());
        };
        let sigma = pose_sigma(scope.gate().info());
        let nominal_m = 1e-6 * self.objective.nominal_um_per_px;
        let length = |v: Vec2| f64::hypot(v[0], v[1]);
        for (k, axis) in [Axis::X, Axis::Y].into_iter().enumerate() {
            let (asked_m, seen_m) = (asked_m[k].abs(), length(seen[k]) * nominal_m);
            if asked_m < SURE_SIGMAS * sigma[k] {
                return Ok(());
            }
            if seen_m < STANDS * asked_m {
                return Err(self.stands(axis, asked_m));
            }
        }
        let [a, b] = seen;
        let cosine = (a[0] * b[0] + a[1] * b[1]) / (length(a) * length(b));
        match cosine.abs() > ALIKE {
            true => Err(ServoError::AxesAlike {
                objective: self.objective.id.clone(),
            }),
            false => Ok(()),
        }
    }

    /// The two go the same part of what is asked; where steps were lost on the way, which looks the same, the view does not come back.
    fn alike(&self, scope: &Instrument) -> Result<(), ServoError> {
        let (Some((seen, asked_m)), Some(Some(back))) = (self.corners(), self.places.last()) else {
            return Ok(());
        };
        let sigma = pose_sigma(scope.gate().info());
        let nominal_m = 1e-6 * self.objective.nominal_um_per_px;
        let seen_m = seen.map(|v| f64::hypot(v[0], v[1]) * nominal_m);
        let share = [0, 1].map(|k| seen_m[k] / asked_m[k].abs());
        let factor = (share[0] / share[1]).max(share[1] / share[0]);
        let doubt: f64 = (0..2).map(|k| (2.0 * sigma[k] / asked_m[k]).powi(2)).sum();
        let back_m = f64::hypot(back.centre_px[0], back.centre_px[1]) * nominal_m;
        let came_back = back_m < 0.5 * (seen_m[0] - seen_m[1]).abs();
        match came_back && factor > self.options.anisotropy * (1.0 + SCATTERS * doubt.sqrt()) {
            true => Err(ServoError::AxesDiffer {
                objective: self.objective.id.clone(),
                factor,
            }),
            false => Ok(()),
        }
    }

    /// That an axis which was asked to move by so much, m or rad, does not move the image.
    pub(super) fn stands(&self, axis: Axis, asked: f64) -> ServoError {
        ServoError::AxisStands {
            objective: self.objective.id.clone(),
            axis,
            asked,
        }
    }

    /// What the turned views show for what was asked, the first view and the last ones: angles, rad, and the variance of what is seen.
    fn turns(&self, scope: &Instrument) -> Vec<[f64; 3]> {
        let scatter_sq = pose_sigma(scope.gate().info())[2].powi(2);
        let turned = |t: &Taken| {
            matches!(
                t.role,
                Role::Reference | Role::Widen { .. } | Role::Sweep { .. }
            )
        };
        let seen = self.taken.iter().zip(&self.places).rev();
        let of = seen.filter(|(t, _)| turned(t)).filter_map(|(t, place)| {
            let place = place.as_ref()?;
            Some([
                t.asked.theta_rad,
                place.angle_rad,
                place.angle_variance + scatter_sq,
            ])
        });
        of.take(LATEST).collect()
    }

    /// That the image does not turn with the stage, or to the other side than x and y tell; nothing where a single view says so.
    fn turns_wrongly(&self, scope: &Instrument) -> Option<ServoError> {
        let ([a, b], [x_m, y_m]) = self.corners()?;
        let side = match scope.gate().info().kinematics {
            Kinematics::MovesMicroscope => 1.0,
            Kinematics::SpecimenRotationOnTop | Kinematics::SpecimenXyOnTop => -1.0,
        };
        let handed = side * ((a[0] * b[1] - a[1] * b[0]) * x_m * y_m).signum();
        let turns = self.turns(scope);
        let told = wrong_turn(&turns, handed)?;
        let without = |k: usize| [&turns[..k], &turns[k + 1..]].concat();
        if (0..turns.len()).any(|k| wrong_turn(&without(k), handed) != Some(told)) {
            return None;
        }
        let ends = |f: fn(f64, f64) -> f64| turns.iter().map(|t| t[0]).reduce(f).unwrap_or(0.0);
        Some(match told {
            Turn::None => self.stands(Axis::Rz, ends(f64::max) - ends(f64::min)),
            Turn::Reversed => ServoError::AxesContradict {
                objective: self.objective.id.clone(),
            },
        })
    }

    /// Views that must overlap with earlier ones are found.
    fn follows(&self, scope: &Instrument) -> Result<(), ServoError> {
        let must = |t: &&Taken| {
            matches!(
                t.role,
                Role::Return | Role::Widen { .. } | Role::Sweep { .. }
            )
        };
        let lost = self.taken.iter().filter(must).filter(|t| !t.found).count();
        match lost >= LOST {
            true => Err(self.astray(scope, None)),
            false => Ok(()),
        }
    }

    /// That a view is not where it should be; or what the turned ones tell of the reason.
    pub(super) fn astray(&self, scope: &Instrument, off_um: Option<f64>) -> ServoError {
        self.turns_wrongly(scope).unwrap_or(ServoError::ViewAstray {
            objective: self.objective.id.clone(),
            off_um,
        })
    }

    /// Why views contradict each other, where it is that they shake.
    pub(super) fn or_it_shakes(&self, scope: &Instrument, error: ServoError) -> ServoError {
        let contradicts = matches!(
            error,
            ServoError::ViewAstray { .. }
                | ServoError::CalibrationContradicted { .. }
                | ServoError::CalibrationInconsistent { .. }
        );
        match contradicts.then(|| shaking_px(scope, &self.vision)) {
            Some(Ok(Some(px))) => ServoError::ViewShakes {
                objective: self.objective.id.clone(),
                um: px * self.objective.nominal_um_per_px,
            },
            // What the instrument cannot do now is told when it is to go home.
            _ => error,
        }
    }

    /// The views back and forth were found, the rotation centre is not beyond all instruments, and at the end the reference is where the
    /// calibration puts it.
    pub(super) fn still_obeys(
        &self,
        scope: &Instrument,
        known: &Known,
        fit: &JointFit,
        calibration: &Calibration,
        stated_px: f64,
    ) -> Result<(), ServoError> {
        let swept = |found: bool| {
            let sweep = |t: &&Taken| matches!(t.role, Role::Sweep { .. }) && t.found == found;
            self.taken.iter().filter(sweep).count()
        };
        let far = fit
            .instrument
            .optics
            .iter()
            .any(|o| f64::hypot(o.centre_m[0], o.centre_m[1]) > FARTHEST_M);
        if (swept(false) > 0 && swept(false) >= swept(true)) || far {
            return Err(self.astray(scope, None));
        }
        let first = self
            .taken
            .first()
            .zip(self.places.first().copied().flatten());
        let Some(first) = first else {
            return Ok(());
        };
        let allowed_px = ASTRAY_PX + ASTRAY_SIGMAS * stated_px;
        let [columns, rows] = known.image_size_px.map(|n| n as f64);
        let mut all = self.taken.iter().zip(&self.places);
        let Some((taken, place)) = all.find(|(taken, _)| taken.role == Role::Home) else {
            return Ok(());
        };
        let Some(place) = place else {
            return Err(self.astray(scope, None));
        };
        let poses = [first.0, taken].map(|t| standing(t, fit.instrument.backlash));
        let Some([x, y, angle_rad]) = known.shows(&poses[0], &poses[1], fit) else {
            return Ok(());
        };
        let turned_px = 0.5 * f64::hypot(columns, rows) * (place.angle_rad - angle_rad).abs();
        let off_px = f64::hypot(place.centre_px[0] - x, place.centre_px[1] - y).max(turned_px);
        match off_px > allowed_px {
            true => Err(self.astray(scope, Some(off_px * calibration.um_per_px()))),
            false => Ok(()),
        }
    }
}

/// What an image does that does not turn as it should.
#[derive(Clone, Copy, PartialEq)]
enum Turn {
    None,
    Reversed,
}

/// What is wrong with how images turn, by the angles that were asked for and seen, rad, and the variance of these: `None` where they turn to the
/// side of `handed`, or nobody can say.
fn wrong_turn(turns: &[[f64; 3]], handed: f64) -> Option<Turn> {
    let mean = |k: usize| turns.iter().map(|t| t[k]).sum::<f64>() / turns.len() as f64;
    let (asked_rad, seen_rad) = (mean(0), mean(1));
    let asked_sq: f64 = turns.iter().map(|t| (t[0] - asked_rad).powi(2)).sum();
    let both: f64 = turns
        .iter()
        .map(|t| (t[0] - asked_rad) * (t[1] - seen_rad))
        .sum();
    let sigma = (mean(2).max(LEAST_ANGLE_RAD.powi(2)) / asked_sq).sqrt();
    // Of what was asked, to the side that x and y tell.
    let share = handed * both / asked_sq;
    let near = |wanted: f64| (share - wanted).abs() < STANDS + 2.0 * sigma;
    match (
        turns.len() >= 2 && sigma <= SURE_SHARE,
        near(0.0),
        near(-1.0),
    ) {
        (true, true, _) => Some(Turn::None),
        (true, _, true) => Some(Turn::Reversed),
        _ => None,
    }
}

/// Where the stage stands at a view, its play counted.
pub(super) fn standing(taken: &Taken, backlash: [f64; 3]) -> PlanarPose {
    let behind = |k: usize| 0.5 * f64::from(taken.view.approach[k]) * backlash[k];
    let reported = taken.view.reported;
    PlanarPose {
        x_m: [0, 1].map(|k| reported.x_m[k] - behind(k)),
        theta_rad: reported.theta_rad - behind(2),
    }
}
