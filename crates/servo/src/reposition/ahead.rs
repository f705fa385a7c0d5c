//! The objectives that may take over from one, and what is known of where they look.

use super::parcentric::offset_um;
use crate::{Calibration, HandOver, SwitchingReport};
use scopeservo_scope::{Instrument, ObjectiveId};
use std::collections::BTreeMap;

/// Of the objectives of a run, in order, those after the one `here`: the highest first. `trusted`: calibrations whose rotation centres tell where
/// each looks beside the others.
pub(super) fn hand_overs(
    scope: &Instrument,
    run: &[ObjectiveId],
    (trusted, switchings): (
        Option<&BTreeMap<ObjectiveId, Calibration>>,
        &[SwitchingReport],
    ),
    (here, target): (&Calibration, &Calibration),
) -> Vec<HandOver> {
    let below = run.iter().position(|id| *id == here.objective);
    let above = below.map_or(&run[..0], |at| &run[at + 1..]);
    let over = |id: &ObjectiveId| {
        let offset_um = offset_um([&here.objective, id], switchings, trusted);
        let next = scope.objective(id).ok()?;
        Some(HandOver::between(here, next, offset_um, target))
    };
    above.iter().rev().filter_map(over).collect()
}
