//! What a joint calibration tells of its views, for those who show it. Data flows out only: nothing here is read back.

use super::joint::Role;
use crate::kinematics::PlanarPose;
use scopeservo_geometry::{Correspondence, Vec2};
use scopeservo_registration::{NotFound, Registration};
use serde::{Deserialize, Serialize};

/// More matches than this are not told of a pair of views.
const TOLD_MATCHES: usize = 120;

/// A view of a chain: what it was for, where the stage was sent, and which earlier views it was compared with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChainView {
    /// The frame.
    pub sequence: u64,
    /// What it was for.
    pub role: Role,
    /// Where the stage was sent, in its own axes.
    pub asked: PlanarPose,
    /// The earlier views that it should overlap, the surest pair first.
    pub compared: Vec<ChainPair>,
}

/// A view compared with an earlier one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ChainPair {
    /// Index of the earlier view.
    pub with: usize,
    /// Places that look alike.
    pub matches: usize,
    /// Those that agree.
    pub inliers: usize,
    /// Why the view was not found there; `None` where it was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<NotFound>,
    /// Of the first pair: the places that agree, or look alike where none do, evenly thinned out: x, y in the view, x, y in the earlier one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<[f32; 4]>,
}

/// Where a view of a chain lies, in the stage's axes as they stand at the first view, m from there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ChainPlace {
    /// Where the stage was sent to look; a turn about the view's middle changes nothing. Where the rotation centre is not known yet, how far the
    /// stage was sent.
    pub at_m: Vec2,
    /// How far beside what the stage reported, its play taken off, the view lies as seen; `None` for views that were not solved for.
    pub off_m: Option<Vec2>,
}

impl ChainPair {
    /// What a registration to an earlier view says, with all the places that look `alike`.
    pub(super) fn of(with: usize, registration: &Registration, alike: &[Correspondence]) -> Self {
        let place = |c: &Correspondence| {
            let ([x, y], [u, v]) = (c.p_in_a, c.p_in_b);
            [x, y, u, v].map(|v| v as f32)
        };
        let reason = registration.outcome.as_ref().err().cloned();
        let places = match &reason {
            None => registration.pairs.clone(),
            Some(_) => alike.iter().map(place).collect(),
        };
        Self {
            with,
            matches: alike.len(),
            inliers: registration.inliers,
            reason,
            places: thinned(places),
        }
    }
}

/// At most so many of them, evenly taken.
fn thinned(places: Vec<[f32; 4]>) -> Vec<[f32; 4]> {
    let n = places.len();
    if n <= TOLD_MATCHES {
        return places;
    }
    let nth = |k: usize| places[k * n / TOLD_MATCHES];
    (0..TOLD_MATCHES).map(nth).collect()
}
