//! Following a view that is known: where the next frame lies against a reference of the same scale, in a millisecond.
//!
//! Phase correlation at a quarter of the resolution tells the shift, then similarity, gain and offset are aligned at a quarter and at half
//! of it by inverse composition (Baker, Matthews, IJCV 2004), robustly, on the pixel with the most structure of each cell. A [`Tracker`] allocates nothing
//! while it follows.

mod align;
mod level;
mod motion;
mod shift;

use crate::Estimate;
use align::{Aligned, Patch};
use level::reduce;
use motion::Motion;
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, Mat2, Vec2};
use shift::Shifts;
use thiserror::Error;

/// Pixels of the image that make one of each level, and iterations there.
const QUARTER: (usize, usize) = (4, 6);
const HALF: (usize, usize) = (2, 4);
/// Pixels with structure that are aligned, at each level, about.
const POINTS: usize = 4500;
/// Smaller images are not followed.
const LEAST_SIDE: usize = 128;
/// What agrees less than this, as a correlation, is not the reference.
const LEAST_CORRELATION: f64 = 0.6;
/// nor what sees less than this share of the points,
const LEAST_SEEN: f64 = 0.25;
/// nor what turned or scaled by more than this.
const MOST_TURN: f64 = 0.1;

/// Why a frame is not followed.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum Lost {
    /// Its size is another one.
    #[error("the frame has another size than the reference")]
    Size,
    /// It shows something else, or lies too far away.
    #[error(
        "the frame does not show the reference near where it was (correlation {correlation:.2})"
    )]
    Elsewhere {
        /// What remains of it, 1 for what is the same.
        correlation: f64,
    },
}

/// Follows one reference.
pub struct Tracker {
    size: [usize; 2],
    shifts: Shifts,
    quarter: Patch,
    half: Patch,
    /// The frame at both levels.
    frame: [Vec<f32>; 2],
}

impl Tracker {
    /// `None` for a reference that is too small, or has nothing in it.
    pub fn new(reference: &GrayImage) -> Option<Self> {
        let size = [reference.width(), reference.height()];
        if size[0].min(size[1]) < LEAST_SIDE {
            return None;
        }
        let plane = |every: usize| vec![0.0f32; (size[0] / every) * (size[1] / every)];
        let mut frame = [plane(HALF.0), plane(QUARTER.0)];
        levels(reference, &mut frame);
        let quarter = size.map(|n| n / QUARTER.0);
        let half = size.map(|n| n / HALF.0);
        Some(Self {
            size,
            shifts: Shifts::new(&frame[1], quarter),
            quarter: Patch::new(&frame[1], quarter, POINTS)?,
            half: Patch::new(&frame[0], half, POINTS)?,
            frame,
        })
    }

    /// Where a frame lies: pixel of the reference from pixel of the frame. Nothing is allocated.
    ///
    /// # Errors
    /// Why it is not followed.
    pub fn follow(&mut self, frame: &GrayImage) -> Result<Estimate, Lost> {
        if [frame.width(), frame.height()] != self.size {
            return Err(Lost::Size);
        }
        levels(frame, &mut self.frame);
        let shift = self.shifts.of(&self.frame[1]);
        let rough = Motion::shift(shift);
        let aligned = self.quarter.align(&self.frame[1], rough, QUARTER.1);
        let ratio = (QUARTER.0 / HALF.0) as f32;
        let between = between_levels(self.size);
        let aligned = self
            .half
            .align(&self.frame[0], aligned.motion.finer(ratio, between), HALF.1);
        self.judged(&aligned)
    }

    fn judged(&self, aligned: &Aligned) -> Result<Estimate, Lost> {
        let correlation = aligned.correlation;
        let Motion { a, b, .. } = aligned.motion;
        let stays = f64::from((a - 1.0).abs().max(b.abs())) <= MOST_TURN;
        if !(correlation >= LEAST_CORRELATION && aligned.seen >= LEAST_SEEN && stays) {
            return Err(Lost::Elsewhere { correlation });
        }
        estimate(aligned, self.size).ok_or(Lost::Elsewhere { correlation })
    }
}

/// Half and quarter of an image.
fn levels(image: &GrayImage, levels: &mut [Vec<f32>; 2]) {
    let (w, h) = (image.width(), image.height());
    let [half, quarter] = levels;
    reduce(image.data(), [w, h], half);
    reduce(half, [w / 2, h / 2], quarter);
}

/// The middle of a level of `every` pixels, pixels of the image: what does not fill a pixel of it is cut off at the end.
fn middle(size: [usize; 2], every: usize) -> Vec2 {
    size.map(|n| ((n / every * every) as f64 - 1.0) / 2.0)
}

/// The middle of the quarter seen from that of the half, pixels of the half.
fn between_levels(size: [usize; 2]) -> [f32; 2] {
    let (quarter, half) = (middle(size, QUARTER.0), middle(size, HALF.0));
    [0, 1].map(|k| ((quarter[k] - half[k]) / HALF.0 as f64) as f32)
}

/// Reference from frame, in pixels of the images.
fn estimate(aligned: &Aligned, size: [usize; 2]) -> Option<Estimate> {
    let Motion { a, b, shift } = aligned.motion;
    let [a, b] = [a, b].map(f64::from);
    let middle = middle(size, HALF.0);
    let linear = Mat2([[a, -b], [b, a]]);
    let at = linear * middle;
    let frame_from_reference = Affine2 {
        linear,
        offset: [0, 1].map(|k| middle[k] + f64::from(shift[k]) * HALF.0 as f64 - at[k]),
    };
    let target_from_view = frame_from_reference.inverse()?;
    // To first order the inverse is off by as much, the other way.
    let centre = size.map(|n| (n as f64 - 1.0) / 2.0);
    let of = |[da, db, dx, dy]: [f64; 4]| {
        let at = [
            da * centre[0] - db * centre[1],
            db * centre[0] + da * centre[1],
        ];
        [da, -db, dx - at[0], db, da, dy - at[1]]
    };
    let pixel = HALF.0 as f64;
    let units: [[f64; 6]; 4] = [
        of([1.0, 0.0, 0.0, 0.0]),
        of([0.0, 1.0, 0.0, 0.0]),
        of([0.0, 0.0, pixel, 0.0]),
        of([0.0, 0.0, 0.0, pixel]),
    ];
    let c = &aligned.covariance;
    let covariance = std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let terms = (0..16).map(|k| c[k / 4][k % 4] * units[k / 4][i] * units[k % 4][j]);
            terms.sum()
        })
    });
    let sigma_px = pixel * (0.5 * (c[2][2] + c[3][3])).sqrt();
    let radius_sq = centre[0] * centre[0] + centre[1] * centre[1];
    Some(Estimate {
        target_from_view,
        covariance,
        sigma_px,
        corner_sigma_px: (sigma_px * sigma_px + radius_sq * c[0][0].max(c[1][1])).sqrt(),
        sigma_angle_rad: c[1][1].sqrt(),
    })
}
