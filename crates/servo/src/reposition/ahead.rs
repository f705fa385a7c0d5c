//! The objectives that may take over from one, and what is known of where they look.

use super::parcentric::{Beside, offset_um};
use crate::{Calibration, HandOver};
use scopeservo_scope::{Instrument, ObjectiveId};

/// Of the objectives of a run, in order, those after the one `here`: the highest first.
pub(super) fn hand_overs(
    scope: &Instrument,
    run: &[ObjectiveId],
    beside: &Beside<'_>,
    (here, target): (&Calibration, &Calibration),
) -> Vec<HandOver> {
    let below = run.iter().position(|id| *id == here.objective);
    let above = below.map_or(&run[..0], |at| &run[at + 1..]);
    let over = |id: &ObjectiveId| {
        let offset_um = offset_um([&here.objective, id], beside);
        let next = scope.objective(id).ok()?;
        Some(HandOver::between(here, next, offset_um, target))
    };
    above.iter().rev().filter_map(over).collect()
}
