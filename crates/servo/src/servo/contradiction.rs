//! What may contradict a move.

use scopeservo_scope::Axis;
use serde::{Deserialize, Serialize};

/// Why a view is not where a move was to bring it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Contradiction {
    /// Nothing moved.
    NothingMoved,
    /// One axis stood while the others moved.
    AxisStands(Axis),
    /// One axis went the other way.
    AxisReversed(Axis),
    /// The plane went the other way: the camera is turned by 180 degrees, or both signs are wrong.
    Reversed,
    /// x went as y was told, and y as x.
    Swapped,
    /// The view went as far as it was told, in a direction turned by so much, rad: the camera was turned.
    Turned(f64),
    /// All went by this share of what was asked.
    Share(f64),
    /// The image shows the target so many times as large as this objective does: another is in, or pixels are binned otherwise.
    Scaled(f64),
    /// The camera shows images that are so many frames old.
    Late(u8),
    /// The view is somewhere else: steps were lost, the slide slipped, or something was moved by hand.
    Elsewhere,
}

/// Two angles (rad) or shares that differ by more are not of one cause.
const ALIKE: f64 = 0.15;

impl Contradiction {
    /// Whether an axis did not move that was told to: nobody knows what it does next.
    pub(crate) fn leaves_standing(self) -> bool {
        matches!(self, Self::NothingMoved | Self::AxisStands(_))
    }

    /// Whether it is read off a move, and not one of the few things that an instrument may do.
    pub(super) fn is_read_off(self) -> bool {
        matches!(self, Self::Turned(_) | Self::Share(_))
    }

    /// How much it says.
    fn says(self) -> u8 {
        match self {
            Self::Elsewhere => 0,
            Self::NothingMoved => 1,
            _ => 2,
        }
    }

    /// What this and a later one, of the next move, mean together. What is said later was seen nearer to, unless it says less: of one axis
    /// alone nobody can tell that the other moves. A turn and a share are read off one move, and count when the next says the same.
    pub(super) fn and(self, later: Self) -> Self {
        match (self, later) {
            (Self::Turned(a), Self::Turned(b)) if (b - a).sin().abs() > ALIKE => Self::Elsewhere,
            (Self::Share(a), Self::Share(b)) if (b - a).abs() > ALIKE => Self::Elsewhere,
            (Self::Turned(_), Self::Share(_)) | (Self::Share(_), Self::Turned(_)) => {
                Self::Elsewhere
            }
            (Self::Elsewhere, Self::Turned(_) | Self::Share(_)) => Self::Elsewhere,
            _ if later.says() < self.says() => self,
            _ => later,
        }
    }

    /// What it was where the next move did what it was to do: what would have gone wrong again did not.
    pub(super) fn once(self) -> Self {
        match self {
            Self::NothingMoved | Self::AxisStands(_) => self,
            _ => Self::Elsewhere,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Contradiction::*;
    use super::*;

    #[test]
    fn two_contradictions_are_of_one_cause_or_of_none() {
        assert_eq!(Turned(0.5).and(Turned(0.55)), Turned(0.55));
        assert_eq!(Turned(0.5).and(Turned(-0.5)), Elsewhere);
        assert_eq!(Turned(3.1).and(Turned(-3.1)), Turned(-3.1));
        assert_eq!(Share(0.5).and(Share(0.9)), Elsewhere);
        assert_eq!(Share(0.5).and(Turned(0.9)), Elsewhere);
        assert_eq!(Elsewhere.and(Share(1.8)), Elsewhere);
        assert_eq!(
            NothingMoved.and(AxisStands(Axis::X)),
            AxisStands(Axis::X),
            "seen nearer"
        );
        assert_eq!(AxisStands(Axis::X).and(Elsewhere), AxisStands(Axis::X));
        assert_eq!(Reversed.once(), Elsewhere);
        assert_eq!(AxisStands(Axis::Y).once(), AxisStands(Axis::Y));
    }
}
