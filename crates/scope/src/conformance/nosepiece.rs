//! Checks of a nosepiece.

use super::check::{Check, ensure, run, said};
use crate::{Axis, Instrument, ObjectiveId, by_immersion};

/// Nosepiece checks: every objective that works in what is on the specimen can be reached, unknown ones are refused.
pub fn check_nosepiece(scope: &Instrument) -> Vec<Check> {
    let gate = scope.gate();
    vec![
        run("every objective can be selected", || {
            let before = gate.current_objective().map_err(said)?;
            let home = gate.position().map_err(said)?;
            let mut all = gate.objectives().to_vec();
            let now = gate.immersions().map_err(said)?;
            let now = (now.len() == 1).then(|| now.first().copied()).flatten();
            // Nobody has to put oil on a specimen for this.
            if now.is_some() {
                all.retain(|o| Some(o.immersion) == now);
            }
            by_immersion(&mut all, now, |o| o);
            for objective in all {
                scope.select_objective(&objective.id).map_err(said)?;
            }
            // Back to the height only with the objective that was there.
            if let Some(id) = before {
                scope.select_objective(&id).map_err(said)?;
                if gate.info().axis(Axis::Z).is_some() {
                    scope.move_to(&home).map_err(said)?;
                }
            }
            Ok(())
        }),
        run("an unknown objective is refused", || {
            let unknown = ObjectiveId("no such objective".into());
            ensure(gate.start_change(&unknown).is_err(), || {
                "it was accepted".into()
            })
        }),
        run("magnifications and nominal scales are positive", || {
            for o in gate.objectives() {
                ensure(
                    o.magnification > 0.0
                        && o.nominal_um_per_px > 0.0
                        && o.numerical_aperture > 0.0,
                    || format!("{} states {o:?}", o.id),
                )?;
            }
            Ok(())
        }),
    ]
}
