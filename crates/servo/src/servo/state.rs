//! What a servo loop remembers from frame to frame.

use super::blur::Blur;
use super::convergence::Convergence;
use super::expected::Expected;
use super::places::MayLieAt;
use super::watch::Watch;
use crate::PoseError;
use crate::proof::Proof;
use serde::{Deserialize, Serialize};

/// The loop's state.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Servo {
    pub(super) convergence: Convergence,
    pub(super) expected: Expected,
    pub(super) proof: Proof,
    #[serde(default)]
    pub(super) watch: Watch,
    /// The stage cannot turn as far as the target is turned, and may leave that.
    #[serde(default)]
    pub(super) leaves_angle: bool,
    /// Moves came no nearer, and go to their goals from below since.
    #[serde(default)]
    pub(super) from_below: bool,
    /// The error where the target was last seen, before a move that lost it.
    #[serde(default)]
    pub(super) last_seen: Option<PoseError>,
    /// How blurred the last frame was beside the target, where that could be told.
    #[serde(default)]
    pub(super) blur: Option<Blur>,
    /// Where the target may lie, after it was not found.
    #[serde(default)]
    pub(super) may_lie_at: Option<MayLieAt>,
}

impl Servo {
    /// Goes on with what another process had begun.
    pub(crate) fn go_on_after_a_kill(&mut self) {
        self.convergence.go_on_after_a_kill();
    }
}
