//! A grid against a calibration of the same objective.

use super::optics::{Quantity, within_a_turn};
use super::report::{GridReport, Known};
use crate::Calibration;
use serde::{Deserialize, Serialize};

/// Two numbers disagree when they are farther apart than so many of their joint standard deviations.
const SIGMAS: f64 = 3.0;

/// One number, twice.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Compared {
    /// Which.
    pub quantity: Quantity,
    /// By the grid.
    pub grid: Known,
    /// By the calibration.
    pub calibration: Known,
    /// The calibration's less the grid's.
    pub difference: f64,
    /// The same in joint standard deviations.
    pub off_sigmas: f64,
    /// Whether it is within three of them.
    pub agrees: bool,
}

/// A calibration as a grid sees it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Whether all does.
    pub agrees: bool,
    /// Whether both say the same of whether the image is mirrored against the stage.
    pub same_hand: bool,
    /// Number by number.
    pub compared: Vec<Compared>,
}

/// Compares all numbers that both know: the paper's three where both have its handedness, else those of the map.
pub fn compare_with(report: &GridReport, calibration: &Calibration) -> Comparison {
    use Quantity::*;
    let by_grid = &report.calibration;
    let same_hand =
        (by_grid.stage_from_pixel.det() > 0.0) == (calibration.stage_from_pixel.det() > 0.0);
    let of_map = match by_grid.reading().and(calibration.reading()) {
        Some(_) => [KxPxPerM, KyPxPerM, PhiDeg],
        None => [XUmPerPx, YUmPerPx, ImageXDeg],
    };
    let all = of_map.into_iter().chain([SkewDeg, CentreXUm, CentreYUm]);
    let compared: Vec<Compared> = all
        .filter_map(|quantity| {
            let (grid, calibration) = (quantity.known(by_grid)?, quantity.known(calibration)?);
            Some(compared(quantity, grid, calibration))
        })
        .collect();
    Comparison {
        agrees: same_hand && compared.iter().all(|c| c.agrees),
        same_hand,
        compared,
    }
}

fn compared(quantity: Quantity, grid: Known, calibration: Known) -> Compared {
    let difference = calibration.value - grid.value;
    let difference = match quantity.is_angle() {
        true => within_a_turn(difference),
        false => difference,
    };
    let off_sigmas = difference.abs() / grid.sigma.hypot(calibration.sigma);
    Compared {
        quantity,
        grid,
        calibration,
        difference,
        off_sigmas,
        agrees: off_sigmas <= SIGMAS,
    }
}
