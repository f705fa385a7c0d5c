//! A run that is killed after one objective has handed over, and before the next one has looked.

mod common;

use common::{PLACE_UM, options};
use scopeservo_scope::{CancelToken, Clock, Instrument, VirtualClock};
use scopeservo_servo::{
    Bring, Calibrate, FocusOptions, NoSink, Procedure, Progress, Reposition, ServoEnd, Target,
    Verdict, VisionOptions, run,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Twin};
use std::sync::Arc;

#[test]
fn a_run_killed_between_the_hand_over_and_the_next_objective_goes_on_and_arrives() {
    let mut config = Config::realistic();
    config.optics.remove(1);
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(config, Arc::new(Tissue::new(7)), 5, clock).unwrap();
    let opened = || Instrument::new(twin.devices(), twin.rules(), CancelToken::new()).unwrap();
    let scope = opened();
    twin.centre_specimen(PLACE_UM, 0.0);
    let mut known = Vec::new();
    for objective in scope.gate().objectives() {
        let (id, vision) = (objective.id.clone(), VisionOptions::default());
        let focus = Some(FocusOptions::default());
        let mut bring = Bring::new(id.clone(), focus, vision.clone());
        run(&mut bring, &scope, &mut NoSink).unwrap();
        let mut calibrate = Calibrate::new(objective.clone(), options().calibrate, vision);
        known.push((id, run(&mut calibrate, &scope, &mut NoSink).unwrap()));
    }
    // The strongest is in.
    let target = Target::save(&scope, &VisionOptions::default(), &mut NoSink).unwrap();
    let aim = twin.truth_now();
    twin.remount(PLACE_UM, [180.0, -150.0], 3.0, false);

    let mut machine = Reposition::new(target.clone(), options()).with_calibrations(known);
    let stored = |machine: &Reposition| serde_json::to_value(machine).unwrap();
    while stored(&machine)["done"].as_array().unwrap().is_empty() {
        let step = machine.step(&scope, &mut NoSink).unwrap();
        assert_eq!(step, Progress::Continue, "the run ended before");
    }
    let kept = stored(&machine);
    assert!(kept["done"][0]["end"]["handed_over"].is_object(), "{kept}");
    // What the next frame is to show is not lost with the program.
    assert!(kept["watch"]["promise"].is_object(), "{kept}");
    drop((machine, scope));

    let scope = opened();
    let found: Reposition = serde_json::from_value(kept).unwrap();
    let outcome = run(&mut found.with_target(target), &scope, &mut NoSink).unwrap();
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    assert_eq!(outcome.remarks, [], "{}", outcome.message);
    let ends: Vec<_> = outcome.magnifications.iter().map(|m| &m.end).collect();
    assert!(
        matches!(
            ends[..],
            [ServoEnd::HandedOver { .. }, ServoEnd::Converged(_)]
        ),
        "{ends:?}"
    );
    let now = twin.truth_now();
    let off = [0, 1].map(|k| now.centre_um[k] - aim.centre_um[k]);
    assert!(f64::hypot(off[0], off[1]) < 1.0, "{off:?}");
}
