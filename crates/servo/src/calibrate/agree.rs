//! Objectives of one microscope have one camera and one axis of rotation: their calibrations tell the same of these.

use crate::{Calibration, ServoError};
use scopeservo_geometry::Mat2;
use scopeservo_scope::{Objective, ObjectiveId};

/// The camera's angle differs between objectives by less, rad: nothing but a loose camera turns with the nosepiece.
const ANGLE_RAD: f64 = 0.0175;
/// Their magnifications, by what is engraved, by less: makers promise 5 %.
const SCALE: f64 = 1.15;
/// Their centres lie nearer to each other than this, m.
const CENTRE_M: f64 = 2e-3;
/// What is uncertain is given so many standard deviations more.
const SIGMAS: f64 = 4.0;

/// Refuses a calibration that tells another handedness, another angle of the camera, another magnification or another rotation centre than one
/// of those `before` it; the one that most of them contradict is named.
///
/// # Errors
/// [`ServoError::ObjectivesDisagree`].
pub fn agree(
    objectives: &[Objective],
    before: &[&Calibration],
    new: &Calibration,
) -> Result<(), ServoError> {
    let against = |other: &&Calibration| {
        Some((
            other.objective.clone(),
            contradiction(objectives, other, new)?,
        ))
    };
    let contradicted: Vec<(ObjectiveId, String)> = before.iter().filter_map(against).collect();
    let Some((other, what)) = contradicted.first().cloned() else {
        return Ok(());
    };
    // With two others, one against one tells nothing, and two against one do.
    let wrong = match (contradicted.len(), before.len()) {
        (all, of) if all == of && of >= 2 => Some(new.objective.clone()),
        (1, of) if of >= 2 => Some(other.clone()),
        _ => None,
    };
    Err(ServoError::ObjectivesDisagree {
        objective: new.objective.clone(),
        other,
        what,
        wrong,
    })
}

/// What two calibrations contradict each other in.
fn contradiction(objectives: &[Objective], a: &Calibration, b: &Calibration) -> Option<String> {
    if a.stage_from_pixel.det() * b.stage_from_pixel.det() < 0.0 {
        return Some("one of their images is mirrored, and the other is not".into());
    }
    let between = a.stage_from_pixel.inverse()? * b.stage_from_pixel;
    let angle_rad = heading(between).abs();
    let sigma = |c: &Calibration, number: fn(&Calibration) -> f64| {
        c.sigma_of(|c| Some(number(c))).unwrap_or(0.0)
    };
    let direction = |c: &Calibration| heading(c.stage_from_camera());
    let angle_sigma = f64::hypot(sigma(a, direction), sigma(b, direction));
    if angle_rad > ANGLE_RAD + SIGMAS * angle_sigma {
        let deg = angle_rad.to_degrees();
        return Some(format!("the camera is turned by {deg:.2} deg between them"));
    }
    let nominal = |c: &Calibration| {
        let own = objectives.iter().find(|o| o.id == c.objective);
        own.map(|o| c.um_per_px() / o.nominal_um_per_px)
    };
    let factor = nominal(b)? / nominal(a)?;
    if factor.max(1.0 / factor) > SCALE {
        let percent = 100.0 * (factor - 1.0);
        return Some(format!(
            "by what is engraved their scales are {percent:.0} % apart"
        ));
    }
    let (Some(p), Some(q)) = (a.rotation_centre_m, b.rotation_centre_m) else {
        return None;
    };
    let variance = |c: &Calibration| c.covariance.map_or(0.0, |v| v[4][4] + v[5][5]);
    let apart_m = f64::hypot(p[0] - q[0], p[1] - q[1]);
    (apart_m > CENTRE_M + SIGMAS * (variance(a) + variance(b)).sqrt())
        .then(|| format!("their rotation centres are {:.2} mm apart", 1e3 * apart_m))
}

/// The angle of the rotation nearest to a map, rad.
fn heading(map: Mat2) -> f64 {
    let Mat2([[a, b], [c, d]]) = map;
    f64::atan2(c - b, a + d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CALIBRATION_SCHEMA;
    use scopeservo_scope::Immersion;

    const FACTORS: [f64; 3] = [4.0, 2.0, 1.0];

    fn objectives() -> Vec<Objective> {
        let of = |(k, factor): (usize, &f64)| Objective {
            id: ObjectiveId(["10x", "20x", "40x"][k].into()),
            magnification: 400.0 / factor,
            numerical_aperture: 0.25,
            nominal_um_per_px: 0.5 * factor,
            immersion: Immersion::Air,
        };
        FACTORS.iter().enumerate().map(of).collect()
    }

    /// A calibration in order, but for a map before it, and for its centre.
    fn made(k: usize, map: Mat2, x_m: f64) -> Calibration {
        Calibration {
            schema: CALIBRATION_SCHEMA,
            objective: objectives()[k].id.clone(),
            image_size_px: [640, 480],
            stage_from_pixel: Mat2::rotation(0.7) * map * (0.5e-6 * FACTORS[k]),
            rotation_centre_m: Some([0.125 + x_m, 0.0]),
            covariance: None,
            backlash: None,
            scatter: None,
        }
    }

    #[test]
    fn objectives_of_one_microscope_agree_and_one_that_does_not_is_named() {
        let good = |k| {
            made(
                k,
                Mat2::diagonal(1.0 + 0.01 * k as f64, 1.0),
                3e-4 * k as f64,
            )
        };
        let (ten, twenty) = (good(0), good(1));
        let all = objectives();
        agree(&all, &[], &ten).unwrap();
        agree(&all, &[&ten], &twenty).unwrap();
        agree(&all, &[&ten, &twenty], &good(2)).unwrap();
        let wrong = [
            (Mat2::rotation(0.03), 0.0, "turned by 1.7"),
            (Mat2::diagonal(-1.0, 1.0), 0.0, "mirrored"),
            (Mat2::diagonal(1.2, 1.2), 0.0, "20 % apart"),
            (Mat2::IDENTITY, 5e-3, "5.00 mm apart"),
        ];
        for (map, x_m, says) in wrong {
            let forty = made(2, map, x_m);
            let error = agree(&all, &[&ten, &twenty], &forty).unwrap_err();
            let ServoError::ObjectivesDisagree { wrong, .. } = &error else {
                panic!("{error}")
            };
            assert_eq!(*wrong, Some(forty.objective.clone()), "{error}");
            assert!(error.to_string().contains(says), "{error}");
            // Of two nobody knows which it is.
            let error = agree(&all, &[&ten], &made(1, map, x_m)).unwrap_err();
            assert!(
                matches!(error, ServoError::ObjectivesDisagree { wrong: None, .. }),
                "{error}"
            );
        }
    }
}
