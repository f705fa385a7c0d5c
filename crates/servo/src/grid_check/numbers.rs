//! From where the grid was seen to the numbers: the optics by the pitch, the stage by how far it went.

use super::follow::{GridView, observations, so_far};
use super::optics::{Quantity, column, off_square};
use super::report::{GridReading, GridReport, Known, StageSeen};
use crate::hand_eye::{covariance, explained_px};
use crate::{CALIBRATION_SCHEMA, Calibration};
use scopeservo_geometry::Mat2;
use scopeservo_scope::{Kinematics, ObjectiveId};

/// What the stage says of its scatter counts as so many coordinates that were seen.
const SAID: f64 = 4.0;
/// A rotation that is known no better, relative, is not told.
const ROTATION: f64 = 0.1;

/// What the numbers are made from.
pub(super) struct Given<'a> {
    pub(super) objective: &'a ObjectiveId,
    pub(super) image_size_px: [usize; 2],
    pub(super) pitch_m: f64,
    pub(super) kinematics: Kinematics,
    /// Standard deviations of arrivals as stated: m, m, rad.
    pub(super) pose_sigma: [f64; 3],
    pub(super) views: &'a [GridView],
}

/// The numbers, and how far the views are from where the stage says.
pub(super) struct Told {
    pub(super) report: GridReport,
    /// Root mean square per coordinate, px, and what the stage's repeatability explains of it.
    pub(super) residual_px: f64,
    pub(super) explained_px: f64,
}

/// How a stage goes where it is told: `true = true_from_commanded commanded`, symmetric, as the directions of its axes are what all angles are
/// counted from.
struct Stretch {
    /// Commanded metres per period.
    stage_from_lattice: Mat2,
    covariance: [[f64; 6]; 6],
    pitch_m: f64,
}

impl Stretch {
    /// The rotation of the grid against the stage.
    fn turn(stage_from_lattice: &Mat2) -> Mat2 {
        stage_from_lattice.nearest_orthogonal()
    }

    fn number(&self, of: impl Fn(&Mat2) -> f64) -> Option<Known> {
        let at = |m: &Mat2| -> Option<f64> {
            let stretch = *m * Self::turn(m).transpose();
            Some(of(&(stretch.inverse()? * self.pitch_m)))
        };
        let gradient = gradient(&self.stage_from_lattice, &at)?;
        let variance = quadratic(&gradient, &self.covariance, &gradient);
        Some(Known {
            value: at(&self.stage_from_lattice)?,
            sigma: variance.max(0.0).sqrt(),
        })
    }
}

/// By the four numbers of a map, by central differences.
fn gradient(m: &Mat2, number: &impl Fn(&Mat2) -> Option<f64>) -> Option<[f64; 4]> {
    let step = 1e-6 * m.frobenius();
    let mut gradient = [0.0; 4];
    for (k, g) in gradient.iter_mut().enumerate() {
        let at = |by: f64| {
            let mut moved = *m;
            moved.0[k / 2][k % 2] += by;
            number(&moved)
        };
        *g = (at(step)? - at(-step)?) / (2.0 * step);
    }
    Some(gradient)
}

/// `a^T C b` with the first four rows and columns of C.
fn quadratic(a: &[f64; 4], c: &[[f64; 6]; 6], b: &[f64; 4]) -> f64 {
    let all = (0..4).flat_map(|i| (0..4).map(move |j| (i, j)));
    all.map(|(i, j)| a[i] * c[i][j] * b[j]).sum()
}

/// All of them. `None` when the views do not determine them.
pub(super) fn tell(given: &Given) -> Option<Told> {
    let first = given.views.first()?;
    let so_far = so_far(given.kinematics, given.views)?;
    let [translations, rotations] = observations(given.views);
    let stage_from_lattice = so_far.lattice_from_stage.inverse()?;
    let blank = Calibration {
        schema: CALIBRATION_SCHEMA,
        objective: given.objective.clone(),
        image_size_px: given.image_size_px,
        stage_from_pixel: stage_from_lattice,
        rotation_centre_m: so_far.centre_m,
        covariance: None,
        backlash: None,
        scatter: None,
    };
    let explained = explained_px(&first.pose, &blank, given.kinematics, given.pose_sigma);
    // At each of two places.
    let stated = explained / 2f64.sqrt();
    let factor = scatter(stated, so_far.scatter(given.kinematics, given.views));
    let pose_sigma = given.pose_sigma.map(|s| s * factor);
    let covariance = covariance(
        given.kinematics,
        &first.pose,
        &translations,
        &rotations,
        pose_sigma,
    )?;
    let stretch = Stretch {
        stage_from_lattice,
        covariance,
        pitch_m: given.pitch_m,
    };
    let calibration = calibration(given, &stretch, blank)?;
    let px = first.grid.pitch_px();
    Some(Told {
        report: GridReport {
            pitch_um: 1e6 * given.pitch_m,
            um_per_px: [
                Quantity::XUmPerPx.known(&calibration)?,
                Quantity::YUmPerPx.known(&calibration)?,
            ],
            image_x_deg: Quantity::ImageXDeg.known(&calibration)?,
            skew_deg: Quantity::SkewDeg.known(&calibration)?,
            mirrored: calibration.reading().is_none(),
            reading: reading(&calibration),
            distortion: first.grid.distortion,
            keystone: first.grid.keystone,
            rotation_centre_um: Quantity::CentreXUm
                .known(&calibration)
                .zip(Quantity::CentreYUm.known(&calibration))
                .map(|(x, y)| [x, y]),
            stage: StageSeen {
                x: stretch.number(|m| column(m, 0).0 - 1.0)?,
                y: stretch.number(|m| column(m, 1).0 - 1.0)?,
                square_deg: stretch.number(|m| off_square(m).to_degrees())?,
                rotation: rotation(given),
                scatter_um: 1e6 * pose_sigma[0].hypot(pose_sigma[1]) / 2f64.sqrt(),
                reach_um: reach_um(given.views),
            },
            nodes: first.grid.nodes,
            left_out: first.grid.left_out,
            sigma_px: first.grid.sigma_px,
            views: given.views.len(),
            calibration,
        },
        residual_px: so_far.residual * px,
        explained_px: explained * px,
    })
}

/// So many times what is `stated` the stage scatters: as it was seen, where that is known better.
fn scatter(stated: f64, (seen, freedom): (f64, f64)) -> f64 {
    let factor = ((SAID + freedom * (seen / stated).powi(2)) / (SAID + freedom)).sqrt();
    if factor.is_finite() { factor } else { 1.0 }
}

/// The map by the pitch: `stage_from_pixel = pitch turn lattice_from_pixel`, with the covariance of both.
fn calibration(given: &Given, stretch: &Stretch, blank: Calibration) -> Option<Calibration> {
    let grid = &given.views.first()?.grid;
    let (by_view, by_moves) = (grid.pixel_from_lattice, stretch.stage_from_lattice);
    let map = |view: &Mat2, moves: &Mat2| -> Option<Mat2> {
        Some(Stretch::turn(moves) * view.inverse()? * given.pitch_m)
    };
    let mut covariance = [[0.0; 6]; 6];
    let mut by = [[[0.0; 4]; 2]; 4];
    for (k, by) in by.iter_mut().enumerate() {
        let cell = |m: Mat2| m.0[k / 2][k % 2];
        by[0] = gradient(&by_view, &|view| map(view, &by_moves).map(cell))?;
        by[1] = gradient(&by_moves, &|moves| map(&by_view, moves).map(cell))?;
    }
    for (i, row) in covariance.iter_mut().enumerate() {
        for (j, cell) in row.iter_mut().enumerate() {
            *cell = match i < 4 && j < 4 {
                true => {
                    quadratic(&by[i][0], &grid.covariance, &by[j][0])
                        + quadratic(&by[i][1], &stretch.covariance, &by[j][1])
                }
                false if i >= 4 && j >= 4 => stretch.covariance[i][j],
                false => 0.0,
            };
        }
    }
    Some(Calibration {
        stage_from_pixel: map(&by_view, &by_moves)?,
        covariance: Some(covariance),
        ..blank
    })
}

fn reading(calibration: &Calibration) -> Option<GridReading> {
    Some(GridReading {
        kx_px_per_m: Quantity::KxPxPerM.known(calibration)?,
        ky_px_per_m: Quantity::KyPxPerM.known(calibration)?,
        phi_deg: Quantity::PhiDeg.known(calibration)?,
    })
}

/// How much more the grid turned in the image than the stage said, between the two farthest rotations.
fn rotation(given: &Given) -> Option<Known> {
    let first = given.views.first()?;
    let about = first.grid.pixel_from_lattice.inverse()?;
    let turned: Vec<(f64, f64)> = given
        .views
        .iter()
        .filter(|v| v.turned || v.pose == first.pose)
        .filter_map(|v| {
            let seen = (v.grid.pixel_from_lattice * about).rotation_angle()?;
            Some((v.pose.theta_rad, seen))
        })
        .collect();
    let by_pose = |a: &&(f64, f64), b: &&(f64, f64)| a.0.total_cmp(&b.0);
    let (least, most) = (
        turned.iter().min_by(by_pose)?,
        turned.iter().max_by(by_pose)?,
    );
    let said = most.0 - least.0;
    // A mirrored image turns the other way.
    let value = ((most.1 - least.1) / said).abs() - 1.0;
    let by_view = first.grid.covariance;
    let direction = (0..4).map(|k| by_view[k][k]).sum::<f64>().sqrt() / 2.0 / first.grid.pitch_px();
    let sigma = direction.hypot(given.pose_sigma[2]) * 2f64.sqrt() / said;
    (sigma < ROTATION).then_some(Known { value, sigma })
}

fn reach_um(views: &[GridView]) -> [f64; 2] {
    let first = views.first().map_or([0.0; 2], |v| v.pose.x_m);
    [0, 1].map(|k| {
        let along = views.iter().map(|v| (v.pose.x_m[k] - first[k]).abs());
        1e6 * along.fold(0.0, f64::max)
    })
}
