//! Where a command began, for a stage that a stop or a fault left elsewhere.

use crate::answer::Answer;
use scopeservo_protocol::Place;
use scopeservo_scope::{Axis, Instrument, StagePose};
use serde_json::{Value, json};

/// Axes that are nearer than this to where they were are there, um and deg.
const THERE: f64 = 1.0;
const THERE_DEG: f64 = 0.01;

/// Tells where the command's first move found the stage, and how it comes back there.
pub(crate) fn tell(scope: &Instrument, answer: &Answer) {
    let (Some(began), Some(here)) = (scope.began(), scope.gate().last_reported()) else {
        return;
    };
    let left = |axis: &Axis| {
        let least = if axis.is_rotation() { THERE_DEG } else { THERE };
        let way = began
            .si(*axis)
            .zip(here.si(*axis))
            .map(|(from, to)| from - to);
        way.is_some_and(|way| axis.to_display(way).abs() >= least)
    };
    if !Axis::ALL.iter().any(left) {
        return;
    }
    answer.put(json!({"began_at": Place::from(&began)}));
    // Nearer to the specimen it goes by the user's own command, after a look.
    let across = |axis: &Axis| *axis != Axis::Z && left(axis);
    let back = Axis::ALL.iter().filter(|axis| across(axis));
    let back = back.fold(StagePose::default(), |to, axis| {
        began.si(*axis).map_or(to, |si| to.with_si(*axis, si))
    });
    let flags = flags(&back);
    match flags.is_empty() {
        true => tell!("scopeservo: the command began at {began}"),
        false => tell!(
            "scopeservo: the command began at {began}. When nothing is in the way, `scopeservo stage go {flags}` takes it back"
        ),
    }
}

/// A place as options of `stage go`.
fn flags(place: &StagePose) -> String {
    let Ok(Value::Object(keys)) = serde_json::to_value(Place::from(place)) else {
        return String::new();
    };
    let flags = keys.iter().filter_map(|(key, value)| {
        let value = value.as_f64()?;
        Some(format!("--{} {value:.3}", key.replace('_', "-")))
    });
    flags.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::{CancelToken, Clock, VirtualClock};
    use scopeservo_twin::specimen::Blank;
    use scopeservo_twin::{Config, Twin};
    use std::sync::Arc;

    #[test]
    fn a_stage_that_was_left_elsewhere_has_a_way_back_that_goes_no_nearer() {
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
        let twin = Twin::new(Config::realistic(), Arc::new(Blank), 1, clock).unwrap();
        let scope = Instrument::new(twin.devices(), twin.rules(), CancelToken::new()).unwrap();
        let answer = Answer::new(true);
        let at = |x: f64, z: f64| StagePose::default().with_si(Axis::X, x).with_si(Axis::Z, z);
        tell(&scope, &answer);
        scope.move_to(&at(0.0, 0.0)).unwrap();
        tell(&scope, &answer);
        assert_eq!(answer.object().get("began_at"), None);
        scope.move_to(&at(1e-4, -5e-4)).unwrap();
        tell(&scope, &answer);
        let began = &answer.object()["began_at"];
        assert!(began["x_um"].as_f64().unwrap().abs() < 1.0, "{began}");
        let place = at(-2.5e-4, 0.0).with_si(Axis::Rz, 0.5f64.to_radians());
        assert_eq!(flags(&place), "--rz-deg 0.500 --x-um -250.000 --z-um 0.000");
    }
}
