//! How sharp an image is. A measure is one type here, or anything that implements [`FocusMeasure`].

use serde::{Deserialize, Serialize};
use std::fmt::Debug;

/// Levels that an image is looked at on, at most: each is half as fine as the one before.
pub(crate) const LEVELS: usize = 5;

/// A measure of sharpness: the mean over an image of what some filter answers, at each pixel a power that noise adds to.
pub trait FocusMeasure: Debug + Send + Sync {
    /// In words, for reports.
    fn name(&self) -> &'static str;

    /// Whether it looks at the smoothed image on the finest level; else at the image as it came.
    fn smooths(&self) -> bool {
        true
    }

    /// The answer at the inner pixels of three rows of one length: for each pixel but the first and the last.
    fn row(&self, rows: [&[f32]; 3], answer: &mut [f32]);

    /// How much a unit of the noise's variance adds on each level.
    fn noise_gain(&self) -> [f64; LEVELS];

    /// So many neighbouring answers to noise count as one, on each level.
    fn correlation(&self) -> [f64; LEVELS];

    /// Twice as much light gives this power of two more: 2 for squares, 1 for sizes.
    fn order(&self) -> i32 {
        2
    }
}

/// Which measure a focus uses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// Squares of the Laplacian of the smoothed image.
    #[default]
    Laplacian,
    /// Squares of the gradient (Sobel) of the smoothed image.
    Tenengrad,
    /// Squares of the difference between two smoothed images.
    BandPower,
    /// Sizes of the Laplacian of the image as it came, the paper's section IV-B.1: with noise it measures noise.
    Paper,
}

impl Measure {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::Laplacian,
        Self::Tenengrad,
        Self::BandPower,
        Self::Paper,
    ];

    /// The measure.
    pub fn measure(self) -> &'static dyn FocusMeasure {
        match self {
            Self::Laplacian => &SmoothedLaplacian,
            Self::Tenengrad => &Tenengrad,
            Self::BandPower => &BandPower,
            Self::Paper => &PaperLaplacian,
        }
    }
}

fn laplacian([above, here, below]: [&[f32]; 3], x: usize) -> f32 {
    above[x] + below[x] + here[x - 1] + here[x + 1] - 4.0 * here[x]
}

#[derive(Debug)]
struct SmoothedLaplacian;

impl FocusMeasure for SmoothedLaplacian {
    fn name(&self) -> &'static str {
        "mean square of the smoothed Laplacian"
    }
    fn row(&self, rows: [&[f32]; 3], answer: &mut [f32]) {
        for (x, out) in (1..).zip(answer) {
            *out = laplacian(rows, x).powi(2);
        }
    }
    fn noise_gain(&self) -> [f64; LEVELS] {
        [1.40930e-2, 1.96056e-3, 4.30340e-4, 1.04232e-4, 2.58540e-5]
    }
    fn correlation(&self) -> [f64; LEVELS] {
        [5.68, 6.76, 7.03, 7.10, 7.11]
    }
}

#[derive(Debug)]
struct Tenengrad;

impl FocusMeasure for Tenengrad {
    fn name(&self) -> &'static str {
        "mean square of the smoothed gradient (Tenengrad)"
    }
    fn row(&self, [a, b, c]: [&[f32]; 3], answer: &mut [f32]) {
        for (x, out) in (1..).zip(answer) {
            let right = a[x + 1] + 2.0 * b[x + 1] + c[x + 1];
            let left = a[x - 1] + 2.0 * b[x - 1] + c[x - 1];
            let below = c[x - 1] + 2.0 * c[x] + c[x + 1];
            let above = a[x - 1] + 2.0 * a[x] + a[x + 1];
            *out = (right - left).powi(2) + (below - above).powi(2);
        }
    }
    fn noise_gain(&self) -> [f64; LEVELS] {
        [8.36592e-1, 1.45759e-1, 3.36089e-2, 8.23821e-3, 2.04949e-3]
    }
    fn correlation(&self) -> [f64; LEVELS] {
        [12.24, 14.48, 15.05, 15.19, 15.22]
    }
}

/// The mean of the eight neighbours, weighted as a Gaussian, taken off.
#[derive(Debug)]
struct BandPower;

impl FocusMeasure for BandPower {
    fn name(&self) -> &'static str {
        "power of a band of fine detail"
    }
    fn row(&self, [a, b, c]: [&[f32]; 3], answer: &mut [f32]) {
        for (x, out) in (1..).zip(answer) {
            let corners = a[x - 1] + a[x + 1] + c[x - 1] + c[x + 1];
            let sides = a[x] + c[x] + b[x - 1] + b[x + 1];
            *out = (0.75 * b[x] - 0.125 * sides - 0.0625 * corners).powi(2);
        }
    }
    fn noise_gain(&self) -> [f64; LEVELS] {
        [8.12074e-4, 1.14566e-4, 2.52171e-5, 6.11183e-6, 1.51624e-6]
    }
    fn correlation(&self) -> [f64; LEVELS] {
        [5.80, 6.89, 7.16, 7.23, 7.25]
    }
}

#[derive(Debug)]
struct PaperLaplacian;

impl FocusMeasure for PaperLaplacian {
    fn name(&self) -> &'static str {
        "mean size of the Laplacian (the paper's)"
    }
    fn smooths(&self) -> bool {
        false
    }
    fn row(&self, rows: [&[f32]; 3], answer: &mut [f32]) {
        for (x, out) in (1..).zip(answer) {
            *out = laplacian(rows, x).abs();
        }
    }
    /// The paper takes no noise off.
    fn noise_gain(&self) -> [f64; LEVELS] {
        [0.0; LEVELS]
    }
    fn correlation(&self) -> [f64; LEVELS] {
        [2.0; LEVELS]
    }
    fn order(&self) -> i32 {
        1
    }
}
