//! Scatter and bias of the two-step calibration over many rounds, against the simulated microscope's hidden truth.
//!
//! `cargo run --release -p scopeservo-studies --example calibration -- [ROUNDS]`
//!
//! Each round stands at another place of the tissue. Exit code 1 when a bias exceeds 3 sd / sqrt(rounds) or a scatter
//! exceeds twice the paper's (Table II).

#![expect(clippy::print_stdout, reason = "a study prints its table")]

use scopeservo_studies::bench::Bench;
use scopeservo_twin::Config;

/// Table II: standard deviations of kx, ky (px/m), phi (deg), eta (mm) at 100x, 200x, 400x.
const PAPER_SD: [[f64; 5]; 3] = [
    [367.0, 414.0, 0.0198, 0.1072, 0.0511],
    [1351.0, 822.0, 0.0401, 0.1570, 0.1355],
    [3047.0, 2908.0, 0.0597, 0.2071, 0.1683],
];
const NAMES: [&str; 5] = [
    "kx_px_per_m",
    "ky_px_per_m",
    "phi_deg",
    "eta1_mm",
    "eta2_mm",
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let rounds: usize = std::env::args().nth(1).map_or(Ok(20), |a| a.parse())?;
    let bench = Bench::tissue(Config::realistic(), 1)?;
    let mut failed = false;
    println!("objective parameter truth mean bias sd paper_sd predicted_sd bias_over_sd_of_mean");
    for (objective, paper_sd) in bench.objectives().iter().zip(PAPER_SD) {
        let truth = bench.twin.true_calibration(objective).ok_or("no truth")?;
        let truth = [
            truth.kx,
            truth.ky,
            truth.phi_deg,
            truth.eta_mm[0],
            truth.eta_mm[1],
        ];
        let mut values: Vec<[f64; 5]> = Vec::new();
        let mut predicted = [0.0; 2];
        for round in 0..rounds {
            let at = [400.0 * round as f64, -300.0 * (round % 5) as f64];
            bench.twin.centre_specimen(at, 17.0 * round as f64);
            bench.focus(objective)?;
            let c = bench.calibrate(objective)?;
            let r = c
                .reading()
                .ok_or("the twin is not mirrored, yet the calibration is")?;
            let eta = c
                .rotation_centre_m
                .ok_or("the twin turns, yet has no rotation centre")?;
            values.push([
                r.kx_px_per_m,
                r.ky_px_per_m,
                r.phi_rad.to_degrees(),
                eta[0] * 1e3,
                eta[1] * 1e3,
            ]);
            let covariance = c.covariance.ok_or("no covariance")?;
            for k in 0..2 {
                predicted[k] += covariance[4 + k][4 + k] * 1e6 / rounds as f64;
            }
        }
        let n = rounds as f64;
        for k in 0..5 {
            let mean = values.iter().map(|v| v[k]).sum::<f64>() / n;
            let sd = (values.iter().map(|v| (v[k] - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
            let pull = (mean - truth[k]) / (sd / n.sqrt());
            let note = if k >= 3 {
                format!("{:.4}", predicted[k - 3].sqrt())
            } else {
                "-".into()
            };
            let bad = pull.abs() > 3.0 || sd > 2.0 * paper_sd[k];
            failed |= bad;
            println!(
                "{objective} {} {:.5} {mean:.5} {:.5} {sd:.5} {} {note} {pull:.2}{}",
                NAMES[k],
                truth[k],
                mean - truth[k],
                paper_sd[k],
                if bad { " FAILS" } else { "" }
            );
        }
    }
    if failed {
        std::process::exit(1);
    }
    Ok(())
}
