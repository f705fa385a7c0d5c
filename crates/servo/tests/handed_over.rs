//! From one objective to the next: killed in between, and by rotation centres that are not what they say.

mod common;

use common::{PLACE_UM, options};
use scopeservo_scope::{
    CancelToken, Clock, GateEvent, Instrument, ObjectiveId, Observer, VirtualClock,
};
use scopeservo_servo::{
    Bring, Calibrate, Calibration, FocusOptions, NoSink, Procedure, Progress, Reposition, ServoEnd,
    Target, Verdict, VisionOptions, run,
};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Twin};
use std::sync::Arc;

fn opened(twin: &Twin) -> Instrument {
    Instrument::new(twin.devices(), twin.rules(), CancelToken::new()).unwrap()
}

/// A microscope with two objectives, the strongest of which is in, and their calibrations.
fn calibrated() -> (Twin, Vec<(ObjectiveId, Calibration)>) {
    let mut config = Config::realistic();
    config.optics.remove(1);
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(config, Arc::new(Tissue::new(7)), 5, clock).unwrap();
    let scope = opened(&twin);
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
    (twin, known)
}

#[test]
fn a_run_killed_between_the_hand_over_and_the_next_objective_goes_on_and_arrives() {
    let (twin, known) = calibrated();
    let scope = opened(&twin);
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

    let scope = opened(&twin);
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

/// The stage is retracted then, and nobody knows any more where it stood but what was written down before.
#[test]
fn a_run_killed_while_the_objective_changes_goes_on_where_the_next_one_is_in_focus() {
    for at_turn in [false, true] {
        let (twin, known) = calibrated();
        let cancel = CancelToken::new();
        let scope = Instrument::new(twin.devices(), twin.rules(), cancel.clone()).unwrap();
        let target = Target::save(&scope, &VisionOptions::default(), &mut NoSink).unwrap();
        let aim = twin.truth_now();
        let z_um = |scope: &Instrument| scope.gate().position().unwrap().z.unwrap().um();
        let saved_um = z_um(&scope);
        twin.remount(PLACE_UM, [180.0, -150.0], 3.0, false);
        let mut machine = Reposition::new(target.clone(), options()).with_calibrations(known);
        let stored = |machine: &Reposition| serde_json::to_value(machine).unwrap();
        // Before the change to the strongest has been made: behind the retreat, or when it has turned.
        let kill: Observer = Arc::new(move |event| {
            let now = match &event {
                GateEvent::Changed { to } => at_turn && to.0 == "40x",
                GateEvent::ChangeBegan { to } => !at_turn && to.0 == "40x",
                _ => false,
            };
            if now {
                cancel.cancel();
            }
        });
        scope.gate().observe(Some(kill));
        let mut kept = stored(&machine);
        while machine.step(&scope, &mut NoSink).is_ok() {
            kept = stored(&machine);
        }
        assert!(kept["done"][0]["end"]["handed_over"].is_object(), "{kept}");
        drop((machine, scope));

        let scope = opened(&twin);
        let away_um = (z_um(&scope) - saved_um).abs();
        assert!(away_um > 1000.0, "retracted: {away_um}");
        let found: Reposition = serde_json::from_value(kept).unwrap();
        let mut found = found.with_target(target).after_a_kill();
        let outcome = run(&mut found, &scope, &mut NoSink).unwrap();
        assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
        let now = twin.truth_now();
        let off = [0, 1].map(|k| now.centre_um[k] - aim.centre_um[k]);
        assert!(f64::hypot(off[0], off[1]) < 1.0, "{off:?}");
    }
}

/// The rotation centre of one calibration is off as the paper's scatter has it, and it says to know it to a micrometre: by that the next objective
/// looks 0.3 mm aside, which is out of its view.
#[test]
fn rotation_centres_that_disagree_more_than_a_nosepiece_does_lose_no_target() {
    for off_m in [[3e-4, 0.0], [-1.4e-4, 2.2e-4], [0.0, -4e-4]] {
        let (twin, known) = calibrated();
        let scope = opened(&twin);
        let known = known.into_iter().map(|(id, calibration)| {
            let moved = |centre: [f64; 2]| [centre[0] + off_m[0], centre[1] + off_m[1]];
            let rotation_centre_m = match id.0.as_str() {
                "40x" => calibration.rotation_centre_m.map(moved),
                _ => calibration.rotation_centre_m,
            };
            let calibration = Calibration {
                rotation_centre_m,
                ..calibration
            };
            (id, calibration)
        });
        let target = Target::save(&scope, &VisionOptions::default(), &mut NoSink).unwrap();
        let aim = twin.truth_now();
        twin.remount(PLACE_UM, [180.0, -150.0], 3.0, false);
        let mut run_back = Reposition::new(target, options()).with_calibrations(known);
        let outcome = run(&mut run_back, &scope, &mut NoSink).unwrap();
        assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
        let now = twin.truth_now();
        let off = [0, 1].map(|k| now.centre_um[k] - aim.centre_um[k]);
        assert!(f64::hypot(off[0], off[1]) < 1.0, "{off:?}");
    }
}
