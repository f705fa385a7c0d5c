//! Joint calibration in a world of numbers.

mod accuracy;
mod coverage;
mod instruments;
mod reference;
mod together;
mod world;
mod wrong_pair;

use scopeservo_geometry::{Cholesky, Mat2};
use scopeservo_servo::PlanarPose;
use scopeservo_servo::joint::{JointFit, Optics};

const HOME: PlanarPose = PlanarPose {
    x_m: [0.0; 2],
    theta_rad: 0.0,
};

/// Sizes of a pixel along x and y, m, and the angle of the map, rad.
fn reading(optics: &Optics) -> [f64; 3] {
    let m = optics.stage_from_pixel;
    let hand = Mat2::diagonal(1.0, m.det().signum());
    let column = |k: usize| f64::hypot(m.0[0][k], m.0[1][k]);
    [column(0), column(1), (m * hand).rotation_angle().unwrap()]
}

/// Standard deviations of kx and ky, relative, and of the angle, deg; of the centre, um.
fn sigma(fit: &JointFit) -> [f64; 5] {
    let optics = fit.instrument.optics[0];
    let c = fit.optics_covariance(0);
    let base = reading(&optics);
    let by: Vec<[f64; 3]> = (0..4)
        .map(|k| {
            let mut other = optics;
            other.stage_from_pixel.0[k / 2][k % 2] += 1e-12;
            let moved = reading(&other);
            [0, 1, 2].map(|r| (moved[r] - base[r]) / 1e-12)
        })
        .collect();
    let of = |r: usize| {
        let all = (0..4).flat_map(|i| (0..4).map(move |j| (i, j)));
        let variance: f64 = all.map(|(i, j)| by[i][r] * c[i][j] * by[j][r]).sum();
        variance.sqrt()
    };
    [
        of(0) / base[0],
        of(1) / base[1],
        of(2).to_degrees(),
        c[4][4].sqrt() * 1e6,
        c[5][5].sqrt() * 1e6,
    ]
}

/// Square of the distance of a fit's numbers from others, in its standard deviations; of how many numbers.
fn distance_sq(off: &[f64], fit: &JointFit) -> (f64, usize) {
    let n = off.len();
    let there: Vec<usize> = (0..n).filter(|k| fit.covariance[k * n + k] > 0.0).collect();
    let covariance: Vec<f64> = there
        .iter()
        .flat_map(|i| there.iter().map(move |j| fit.covariance[i * n + j]))
        .collect();
    let off: Vec<f64> = there.iter().map(|k| off[*k]).collect();
    let whitened = Cholesky::of(&covariance, there.len()).unwrap().solve(&off);
    (
        off.iter().zip(whitened).map(|(a, b)| a * b).sum(),
        there.len(),
    )
}
