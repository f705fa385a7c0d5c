//! What may contradict a move.

use scopeservo_scope::Axis;
use serde::{Deserialize, Serialize};

/// Why a view is not where a move was to bring it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Contradiction {
    /// Nothing moved, or the image does not change.
    NothingMoved,
    /// One axis stood while the others moved.
    AxisStands(Axis),
    /// One axis went the other way.
    AxisReversed(Axis),
    /// The plane went the other way: the camera is turned by 180 degrees, or both signs are wrong.
    Reversed,
    /// x went as y was told, and y as x.
    Swapped,
    /// All went by this share of what was asked.
    Share(f64),
    /// The view is somewhere else: steps were lost, the slide slipped, or something was moved by hand.
    Elsewhere,
}

impl Contradiction {
    /// Whether an axis did not move that was told to: nobody knows what it does next.
    pub(crate) fn leaves_standing(self) -> bool {
        matches!(self, Self::NothingMoved | Self::AxisStands(_))
    }

    /// How much it says.
    pub(super) fn says(self) -> u8 {
        match self {
            Self::Elsewhere => 0,
            Self::NothingMoved => 1,
            _ => 2,
        }
    }
}
