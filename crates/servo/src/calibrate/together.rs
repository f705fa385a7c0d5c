//! Objectives that were calibrated one after the other, as one instrument with one covariance.

use super::alone::Alone;
use super::chain::{BACKLASH, DRIFT_M_PER_S, link_of};
use super::joint::{Apart, Difference, Differing, SetFit, Shared, Single, one_instrument};
use crate::vision::VisionOptions;
use crate::{Backlash, Calibration, Known};
use scopeservo_geometry::Mat2;
use scopeservo_registration::{
    Correspondences, Prior, RotationPrior, ScalePrior, register_correspondences,
};
use scopeservo_scope::{Kinematics, ObjectiveId, deg_in_words, um_in_words};
use serde::{Deserialize, Serialize};

/// Version of the serialised form.
pub const SET_SCHEMA: u32 = 1;

/// A lens turns no image; what is not quite straight may, by so much, rad.
const ANGLE_RAD: f64 = 2e-4;
/// Makers centre objectives to some tens of micrometres, cheap nosepieces to some hundreds: a standard deviation, m per coordinate.
const PARCENTRIC_M: f64 = 200e-6;
/// By scale and angle the view of one objective is looked for in that of another so far beside what their calibrations say, relative and rad: a
/// calibration that is off must be found, to be named.
const SCALE_SLACK: f64 = 0.15;
const ANGLE_SLACK_RAD: f64 = 0.05;

/// Where one objective looks beside another.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parcentric {
    /// The first objective.
    pub from: ObjectiveId,
    /// The second.
    pub to: ObjectiveId,
    /// The maps of the calibrations that it belongs to: with others it says nothing.
    pub(crate) maps: [Mat2; 2],
    /// Where the centre of the second one lies beside that of the first, x and y, um in stage axes.
    pub offset_um: [Known; 2],
}

impl Parcentric {
    /// Whether it was measured with these two calibrations, the first objective's first.
    pub(crate) fn is_of(&self, from: &Calibration, to: &Calibration) -> bool {
        let ids = (&from.objective, &to.objective) == (&self.from, &self.to);
        ids && [from.stage_from_pixel, to.stage_from_pixel] == self.maps
    }
}

/// Calibrations of several objectives that are one instrument.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibrationSet {
    /// [`SET_SCHEMA`] of the program that wrote it.
    pub schema: u32,
    /// The calibrations, each whole by itself. They share the backlash.
    pub calibrations: Vec<Calibration>,
    /// Covariance of the backlash (x, y: m; rotation: rad), then of each calibration's map row by row (m/px) and of its centre (m): n x n, row by
    /// row, with n = 3 + 6 calibrations; zero where there is no such axis.
    pub covariance: Vec<f64>,
    /// Where objectives look beside each other, each pair that is known.
    pub parcentric: Vec<Parcentric>,
    /// How many pairs of objectives were seen in each other's view.
    pub linked: usize,
    /// Weighted sum of squares; chi-square with `freedom` degrees of freedom.
    pub chi_sq: f64,
    /// What was known more often than asked for.
    pub freedom: usize,
}

impl CalibrationSet {
    /// Whether these can be the numbers of a microscope.
    pub fn is_possible(&self) -> bool {
        let n = 3 + 6 * self.calibrations.len();
        let offsets = self.parcentric.iter().flat_map(|p| p.offset_um);
        let mut known =
            offsets.map(|k| k.value.is_finite() && k.sigma >= 0.0 && k.sigma.is_finite());
        self.schema == SET_SCHEMA
            && self.covariance.len() == n * n
            && self.covariance.iter().all(|c| c.is_finite())
            && self.calibrations.iter().all(|c| c.impossible().is_none())
            && known.all(|k| k)
    }

    fn of(all: &[Alone], fit: &SetFit, linked: usize) -> Self {
        let n = fit.numbers();
        let cell = |i: usize, j: usize| fit.covariance[n * i + j];
        let first = |o: usize| 3 + 6 * o;
        let [x_m, y_m, rz_rad] = fit.backlash;
        let backlash = Backlash {
            x_m,
            y_m,
            rz_rad,
            sigma: [0, 1, 2].map(|k| cell(k, k).sqrt()),
        };
        let one = |(o, alone): (usize, &Alone)| {
            let own = first(o);
            let turns = alone.calibration.rotation_centre_m;
            Calibration {
                stage_from_pixel: fit.optics[o].stage_from_pixel,
                rotation_centre_m: turns.map(|_| fit.optics[o].centre_m),
                covariance: Some(std::array::from_fn(|r| {
                    std::array::from_fn(|c| match turns.is_none() && (r > 3 || c > 3) {
                        true => 0.0,
                        false => cell(own + r, own + c),
                    })
                })),
                backlash: Some(backlash),
                ..alone.calibration.clone()
            }
        };
        let calibrations: Vec<Calibration> = all.iter().enumerate().map(one).collect();
        let beside = |[a, b]: [usize; 2]| {
            let offset_um = [0, 1].map(|k| {
                let (i, j) = (first(a) + 4 + k, first(b) + 4 + k);
                let variance = cell(i, i) + cell(j, j) - 2.0 * cell(i, j);
                Known {
                    value: 1e6 * (fit.optics[b].centre_m[k] - fit.optics[a].centre_m[k]),
                    sigma: 1e6 * variance.max(0.0).sqrt(),
                }
            });
            let [from, to] = [a, b].map(|o| &calibrations[o]);
            // What was not measured is no more than what is known of all nosepieces.
            let known = offset_um.iter().all(|k| k.sigma < 0.5e6 * PARCENTRIC_M);
            known.then(|| Parcentric {
                from: from.objective.clone(),
                to: to.objective.clone(),
                maps: [from.stage_from_pixel, to.stage_from_pixel],
                offset_um,
            })
        };
        Self {
            schema: SET_SCHEMA,
            parcentric: pairs(all.len()).filter_map(beside).collect(),
            covariance: fit.covariance.clone(),
            linked,
            chi_sq: fit.chi_sq,
            freedom: fit.freedom,
            calibrations,
        }
    }
}

/// Calibrations that are not those of one microscope.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NotOne {
    /// The objective without which all others agree; `None` where nobody can say.
    pub odd: Option<ObjectiveId>,
    /// Where two of them contradict each other most, the odd one among them.
    pub between: [ObjectiveId; 2],
    /// In what, and by how much.
    pub difference: Difference,
}

impl std::fmt::Display for NotOne {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [a, b] = &self.between;
        let Difference { what, by, sigma } = self.difference;
        match what {
            Differing::Backlash => write!(
                f,
                "{a} and {b} were calibrated with backlashes {} apart",
                um_in_words(1e6 * by, 2)
            )?,
            Differing::Angle => write!(
                f,
                "the camera is turned by {} between {a} and {b}",
                deg_in_words(by.to_degrees(), 3)
            )?,
            Differing::Scale => write!(
                f,
                "their images say that the scales of {a} and {b} are {:.2} % apart from what their calibrations say",
                100.0 * by
            )?,
            Differing::Centre => write!(
                f,
                "the rotation centres of {a} and {b} are {} apart from where they should be",
                um_in_words(1e6 * by, 1)
            )?,
        }
        write!(f, " ({:.0} standard deviations). ", by / sigma)?;
        match &self.odd {
            Some(odd) => write!(
                f,
                "{odd} is the one that disagrees: look whether it is in the beam as said, and calibrate it again"
            ),
            None => write!(f, "Each counts by itself: calibrate both again"),
        }
    }
}

/// Each two of so many.
fn pairs(count: usize) -> impl Iterator<Item = [usize; 2]> {
    (0..count).flat_map(move |b| (0..b).map(move |a| [a, b]))
}

/// Calibrations of one job as one instrument: what the stage and the camera share is known by all of them, and where objectives look beside each
/// other by what their first views show of the same specimen. `None` of fewer than two. What contradicts is not merged.
///
/// # Errors
/// [`NotOne`], with the objective that disagrees where the others tell.
pub fn one_microscope(
    all: &[Alone],
    kinematics: Kinematics,
    vision: &VisionOptions,
) -> Option<Result<CalibrationSet, NotOne>> {
    let singles: Vec<Single> = all.iter().map(|alone| alone.single.clone()).collect();
    let link = |both: [usize; 2]| {
        let [fixed, found] = both.map(|o| &all[o]);
        let estimate = seen_in(fixed, found, vision)?;
        let size_px = [found.features.width, found.features.height];
        Some(link_of(&estimate, size_px, both))
    };
    let links: Vec<_> = pairs(all.len()).filter_map(link).collect();
    let shared = Shared {
        kinematics,
        backlash: BACKLASH,
        angle_rad: ANGLE_RAD,
        parcentric_m: PARCENTRIC_M,
        drift_m_per_s: DRIFT_M_PER_S,
    };
    let named = |o: usize| all[o].calibration.objective.clone();
    Some(match one_instrument(&shared, &singles, &links)? {
        Ok(fit) => {
            let linked = links.len() - usize::from(fit.left_out.is_some());
            Ok(CalibrationSet::of(all, &fit, linked))
        }
        Err(Apart {
            odd,
            between,
            difference,
        }) => Err(NotOne {
            odd: odd.map(named),
            between: between.map(named),
            difference,
        }),
    })
}

/// The first view of one objective in that of another.
fn seen_in(
    fixed: &Alone,
    found: &Alone,
    vision: &VisionOptions,
) -> Option<scopeservo_registration::Estimate> {
    let turned = fixed.calibration.pixel_from_stage()? * found.calibration.stage_from_pixel;
    let prior = Prior {
        scale: Some(ScalePrior {
            ratio: found.calibration.um_per_px() / fixed.calibration.um_per_px(),
            tolerance: SCALE_SLACK,
        }),
        rotation: Some(RotationPrior {
            angle_rad: turned.rotation_angle()?,
            tolerance_rad: ANGLE_SLACK_RAD,
        }),
        ..Prior::default()
    };
    let (view, target) = (&found.features, &fixed.features);
    let options = &vision.registration;
    let pairs = Correspondences::of(&*vision.engine, view, target, &prior, options).ok()?;
    register_correspondences(&pairs, &prior, options)
        .outcome
        .ok()
}
