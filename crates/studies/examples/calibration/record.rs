//! One calibration, against the truth.

use crate::arrival::arrivals;
use crate::instrument::{Bench, Design};
use crate::specimens::Specimens;
use scopeservo_geometry::Cholesky;
use scopeservo_scope::Frame;
use scopeservo_servo::{
    Calibrate, CalibrateOptions, Calibration, CalibrationMethod, Event, FrameRole, GridCheck,
    GridOptions, Sink, Stamped, VisionOptions, run,
};
use scopeservo_studies::rounds::Outcome;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// What came of a calibration.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Record {
    pub(crate) index: u64,
    /// The instrument in words.
    pub(crate) design: String,
    pub(crate) objective: String,
    pub(crate) play_um: f64,
    /// Why there is no calibration.
    pub(crate) refused: Option<String>,
    /// kx, ky (px/m), phi (deg), eta less the truth (mm), where the map can be read so.
    pub(crate) reading: Option<[f64; 5]>,
    /// The standard deviations that are stated of it.
    pub(crate) stated: Option<[f64; 5]>,
    /// Map row by row (m/px) and rotation centre (m), less the truth; and its covariance, row by row.
    pub(crate) off: Vec<f64>,
    pub(crate) covariance: Vec<f64>,
    /// Backlash of x and y less the truth, and its standard deviations, um.
    pub(crate) backlash_off_um: Option<[[f64; 2]; 2]>,
    /// Of single moves with this calibration: how far beside the wanted place they ended along x and y, um, and the covariance that was
    /// expected, xx, xy, yy, um^2.
    #[serde(default)]
    pub(crate) arrivals_um: Vec<[f64; 5]>,
    pub(crate) views: usize,
    pub(crate) moves: u64,
    /// On the instrument's clock, and of computing, simulation included.
    pub(crate) instrument_s: f64,
    pub(crate) computing_s: f64,
}

#[derive(Default)]
struct Views(usize);

impl Sink for Views {
    fn event(&mut self, stamped: Stamped) {
        self.0 += usize::from(matches!(stamped.event, Event::CalibrationView { .. }));
    }
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

/// Calibrates the instrument of a design; without a method, by a grid.
pub(crate) fn calibrated(
    index: u64,
    design: &Design,
    method: Option<CalibrationMethod>,
    specimens: &Specimens,
) -> Outcome<Record> {
    let bench = design.bench(index, specimens)?;
    let objective = bench.scope.gate().objectives()[0].clone();
    let mut views = Views::default();
    let before = (
        bench.scope.clock().now().seconds(),
        bench.scope.counters().moves,
    );
    let began = Instant::now();
    let made = match method {
        Some(method) => {
            let options = CalibrateOptions {
                method,
                ..CalibrateOptions::default()
            };
            let vision = VisionOptions::default();
            let mut calibrate = Calibrate::new(objective.clone(), options, vision);
            run(&mut calibrate, &bench.scope, &mut views)
        }
        None => {
            let options = GridOptions {
                pitch_um: design.pitch_um(),
                ..GridOptions::default()
            };
            let mut check = GridCheck::new(objective.clone(), options);
            run(&mut check, &bench.scope, &mut views).map(|report| report.calibration)
        }
    };
    let mut record = Record {
        index,
        design: design.words.clone(),
        objective: objective.id.0.clone(),
        play_um: design.play_um,
        refused: None,
        reading: None,
        stated: None,
        off: Vec::new(),
        covariance: Vec::new(),
        backlash_off_um: None,
        arrivals_um: Vec::new(),
        views: views.0,
        moves: bench.scope.counters().moves - before.1,
        instrument_s: bench.scope.clock().now().seconds() - before.0,
        computing_s: began.elapsed().as_secs_f64(),
    };
    match made {
        Ok(made) => {
            record.fill(&bench, design, &made)?;
            // Nothing else knows what a stage scatters.
            if made.scatter.is_some() {
                record.arrivals_um = arrivals(&bench, &made, index)?;
            }
        }
        Err(why) => record.refused = Some(why.to_string()),
    }
    Ok(record)
}

impl Record {
    fn fill(&mut self, bench: &Bench, design: &Design, made: &Calibration) -> Outcome<()> {
        let truth = bench.truth(made)?;
        let [[a, b], [c, d]] = made.stage_from_pixel.0;
        let [x, y] = made.rotation_centre_m.unwrap_or([truth[4], truth[5]]);
        let found = [a, b, c, d, x, y];
        let numbers = if made.rotation_centre_m.is_some() {
            6
        } else {
            4
        };
        let covariance = made.covariance.ok_or("no covariance")?;
        self.off = (0..numbers).map(|k| found[k] - truth[k]).collect();
        self.covariance = covariance[..numbers]
            .iter()
            .flat_map(|row| row[..numbers].to_vec())
            .collect();
        self.reading = made.reading().map(|r| {
            let eta_mm = [x - truth[4], y - truth[5]].map(|v| v * 1e3);
            [
                r.kx_px_per_m,
                r.ky_px_per_m,
                r.phi_rad.to_degrees(),
                eta_mm[0],
                eta_mm[1],
            ]
        });
        let sigma = |number: fn(&Calibration) -> Option<f64>| made.sigma_of(number).unwrap_or(0.0);
        let eta_mm = |k: usize| 1e3 * covariance[4 + k][4 + k].sqrt();
        self.stated = self.reading.map(|_| {
            [
                sigma(|c| Some(c.reading()?.kx_px_per_m)),
                sigma(|c| Some(c.reading()?.ky_px_per_m)),
                sigma(|c| Some(c.reading()?.phi_rad.to_degrees())),
                eta_mm(0),
                eta_mm(1),
            ]
        });
        self.backlash_off_um = made.backlash.map(|b| {
            let off = [b.x_m, b.y_m].map(|v| 1e6 * v - design.play_um);
            [off, [1e6 * b.sigma[0], 1e6 * b.sigma[1]]]
        });
        Ok(())
    }

    /// How far each number is from the truth, in its standard deviations.
    pub(crate) fn pulls(&self) -> Vec<f64> {
        let n = self.off.len();
        (0..n)
            .map(|k| self.off[k] / self.covariance[k * n + k].sqrt())
            .collect()
    }

    /// The square of the distance of all numbers together.
    pub(crate) fn distance_sq(&self) -> Option<f64> {
        let n = self.off.len();
        let solved = Cholesky::of(&self.covariance, n)?.solve(&self.off);
        Some(self.off.iter().zip(solved).map(|(a, b)| a * b).sum())
    }
}
