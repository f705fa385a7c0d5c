//! Why a tilt was not told, or not levelled.

use crate::words::way_in_words;
use scopeservo_scope::{Axis, ObjectiveId, um_in_words};
use thiserror::Error;

/// Why a tilt was not told, or not levelled. The stage is back where it began.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum LevelError {
    /// Too little of the view has structure to tell how it is tilted.
    #[error(
        "the tilt could not be seen with {objective}: {seen} parts of the view show a focus of their own, and {needed} are needed. Go to a place \
         with tissue all over"
    )]
    TiltUnseen {
        /// The active objective.
        objective: ObjectiveId,
        /// Parts that do.
        seen: usize,
        /// Needed.
        needed: usize,
    },
    /// The stage was tipped, and the tilt stayed as it was.
    #[error(
        "{axis} was sent {}, and the tilt of the view stayed as it was: {axis} stands, or tips something else. Look whether it is switched on, \
         free and not held",
        way_in_words(*axis, *asked)
    )]
    TiltStays {
        /// The axis.
        axis: Axis,
        /// How far it was sent, rad.
        asked: f64,
    },
    /// The stage was tipped by a little, and the focus went farther than any lever explains.
    #[error(
        "{axis} was sent {}, and the focus went {shift_um:.0} um away, farther than a lever of {lever_mm:.0} mm explains: it turns farther than it \
         says, so look at its unit before it moves again",
        way_in_words(*axis, *asked)
    )]
    TipsTooFar {
        /// The axis.
        axis: Axis,
        /// How far it was sent, rad.
        asked: f64,
        /// How far the focus went, um.
        shift_um: f64,
        /// The longest lever that is believed, mm.
        lever_mm: f64,
    },
    /// Levelling made nothing better.
    #[error(
        "the view was not levelled: a corner lay {} out of focus before and {} after the last turn. The stage is back \
         where it began. Look for play in its tilting axes and for a slide that does not lie flat",
        um_in_words(*before_um, 2),
        um_in_words(*after_um, 2)
    )]
    NotLevelled {
        /// Defocus of the worst corner before, um.
        before_um: f64,
        /// And after.
        after_um: f64,
    },
    /// There is no room away from the specimen to tip behind.
    #[error(
        "{axis} was not turned: the stage must retreat by {retreat_um:.0} um before, as the slide may come nearer by that, and has no room for it. \
         Raise the limits of z, or state a shorter lever"
    )]
    NoRoom {
        /// The axis.
        axis: Axis,
        /// How far the stage would retreat, um.
        retreat_um: f64,
    },
}
