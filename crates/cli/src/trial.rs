//! What only pictures tell about a stage, as findings of `doctor --allow-motion` and `driver check`.

use crate::doctor::Finding;
use scopeservo_scope::Instrument;
use scopeservo_servo::{Drift, ServoError, VisionOptions, drift_seen, scale_seen};

/// A view that moves by more than this many of its pixels in a second is nothing to come back to: half of what counts as arrived.
const DRIFTS_PX_PER_S: f64 = 0.4;

fn finding(name: &str, outcome: Result<String, String>) -> Finding {
    let ok = outcome.is_ok();
    Finding {
        name: name.into(),
        ok,
        said: outcome.unwrap_or_else(|said| said),
    }
}

/// Looks whether the view stands, and whether the stage moves as far as it says. `false` as second when it must not move any farther.
pub(crate) fn of_pictures(scope: &Instrument) -> (Vec<Finding>, bool) {
    let vision = VisionOptions::default();
    let view = finding("the view stands", stands(drift_seen(scope, &vision)));
    let name = "the picture moves as far as the stage says";
    let objective = match scope.gate().current_objective() {
        Ok(Some(objective)) => objective,
        // Nobody knows which scale to expect.
        Ok(None) => return (vec![view], true),
        Err(error) => return (vec![view, finding(name, Err(error.to_string()))], true),
    };
    let seen = scale_seen(scope, &objective, &vision);
    let too_far = matches!(seen, Err(ServoError::MovesTooFar { .. }));
    let scale = seen.map_err(|e| e.to_string()).and_then(|seen| {
        let told = format!("{:.3} um per pixel with {objective}", seen.um_per_px);
        match seen.as_told {
            true => Ok(told),
            false => Err(format!(
                "{told}, which does not fit: look at the unit of the stage, at um_per_px of the objective, and at which objective is in"
            )),
        }
    });
    (vec![view, finding(name, scale)], !too_far)
}

fn stands(seen: Result<Drift, ServoError>) -> Result<String, String> {
    let drift = seen.map_err(|e| e.to_string())?;
    let told = format!("it moves by {:.2} pixels a second", drift.px_per_s);
    match drift.px_per_s > DRIFTS_PX_PER_S && drift.px_per_s > 3.0 * drift.sigma_px_per_s {
        true => Err(format!(
            "{told} while the stage stands: wait until the instrument is warm, and see that the slide and the focus drive hold"
        )),
        false => Ok(told),
    }
}
