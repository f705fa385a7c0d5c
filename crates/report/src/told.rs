//! The parts of a run as its events tell them.

use scopeservo_geometry::Affine2;
use scopeservo_scope::ObjectiveId;
use scopeservo_servo::{
    Calibration, ChainPlace, ChainView, FocusResult, FocusSweep, LocatedBy, Phase, PixelsSeen,
    PoseError, Promised, Velocity,
};

/// One frame of the servo in which the target was seen.
pub(crate) struct Iteration<'a> {
    pub(crate) iteration: usize,
    pub(crate) sequence: u64,
    pub(crate) error: &'a PoseError,
    pub(crate) velocity: &'a Velocity,
    pub(crate) target_from_view: &'a Affine2,
    pub(crate) by: LocatedBy,
    pub(crate) inliers: usize,
    pub(crate) matches: usize,
    pub(crate) sigma_px: f64,
    pub(crate) pairs: &'a [[f32; 4]],
    pub(crate) converged: bool,
    pub(crate) pixels: Option<&'a PixelsSeen>,
    /// Where the move before was to lead.
    pub(crate) promised: Option<&'a Promised>,
}

impl Iteration<'_> {
    /// By what it was located, where that is not what features look like.
    pub(crate) fn located_by(&self) -> &'static str {
        match self.by {
            LocatedBy::Features => "",
            LocatedBy::Arrangement => "; by how few features lie",
            LocatedBy::Correlation => "; by correlation, as features said nothing",
        }
    }
}

/// One frame in which it was not.
pub(crate) struct Lost {
    pub(crate) iteration: usize,
    pub(crate) sequence: u64,
    pub(crate) reason: String,
}

/// The servo at one magnification.
pub(crate) struct Magnification<'a> {
    pub(crate) objective: &'a ObjectiveId,
    pub(crate) calibration: Option<&'a Calibration>,
    pub(crate) iterations: Vec<Iteration<'a>>,
    pub(crate) lost: Vec<Lost>,
}

impl Magnification<'_> {
    /// (iteration, sequence) of every frame, in order.
    pub(crate) fn frames(&self) -> Vec<(usize, u64)> {
        let seen = self.iterations.iter().map(|i| (i.iteration, i.sequence));
        let lost = self.lost.iter().map(|l| (l.iteration, l.sequence));
        let mut all: Vec<_> = seen.chain(lost).collect();
        all.sort_unstable();
        all
    }

    pub(crate) fn by_sequence(&self, sequence: u64) -> Option<&Iteration<'_>> {
        self.iterations.iter().find(|i| i.sequence == sequence)
    }
}

/// One focus sweep.
pub(crate) struct Sweep<'a> {
    pub(crate) objective: Option<&'a ObjectiveId>,
    /// (height um, sharpness).
    pub(crate) samples: Vec<[f64; 2]>,
    pub(crate) result: Option<&'a FocusResult>,
    /// Its coarse scan in motion.
    pub(crate) in_motion: Option<&'a FocusSweep>,
}

/// One view of a chain of views.
pub(crate) struct Look<'a> {
    /// How many views before it.
    pub(crate) index: usize,
    /// Whether it was recognised in an earlier one.
    pub(crate) found: bool,
    pub(crate) chain: &'a ChainView,
}

/// Where a chain's views lie, and which were registered to which.
#[derive(Clone, Copy)]
pub(crate) struct Ended<'a> {
    pub(crate) places: &'a [ChainPlace],
    pub(crate) pairs: &'a [[usize; 2]],
    pub(crate) left_out: &'a [usize],
}

/// One calibration.
pub(crate) struct Calibrating<'a> {
    pub(crate) objective: &'a ObjectiveId,
    pub(crate) shifts_px: Vec<Option<[f64; 2]>>,
    /// Of a joint calibration.
    pub(crate) looks: Vec<Look<'a>>,
    pub(crate) ended: Option<Ended<'a>>,
    /// With its residual in pixels and the views used.
    pub(crate) made: Option<(&'a Calibration, f64, usize)>,
}

/// A stretch of time.
pub(crate) struct Span<'a> {
    pub(crate) leg: usize,
    pub(crate) phase: Phase,
    pub(crate) objective: &'a ObjectiveId,
    pub(crate) from_s: f64,
    pub(crate) to_s: f64,
}
