//! Runs that were killed while they proved what they saw.

use super::*;

/// An instrument of a microscope, as after a kill.
fn opened(twin: &Twin, clock: &Arc<VirtualClock>) -> Instrument {
    let devices = scopeservo_scope::Devices {
        clock: clock.clone(),
        ..twin.devices()
    };
    Instrument::new(devices, twin.rules(), CancelToken::new()).unwrap()
}

/// Tissue on a microscope by whose clock all goes.
fn over_tissue(clock: &Arc<VirtualClock>) -> Bench {
    let tissue = Arc::new(scopeservo_twin::specimen::Tissue::new(7));
    let twin = Twin::new(by_hand(), tissue, 5, clock.clone()).unwrap();
    twin.centre_specimen(PLACE_UM, 0.0);
    Bench {
        scope: opened(&twin, clock),
        cancel: CancelToken::new(),
        twin,
    }
}

/// Steps a run until an event is one to stop at; what would be found of it after a kill.
fn killed_at(
    target: &Target,
    mut machine: Reposition,
    scope: &Instrument,
    here: impl Fn(&Event) -> bool,
) -> Reposition {
    let mut there = false;
    while !there {
        let mut sink = Listener(|event: &Event| there |= here(event));
        let ended = machine.step(scope, &mut sink).unwrap();
        assert_eq!(ended, Progress::Continue, "the run ended before");
    }
    let stored: Reposition =
        serde_json::from_str(&serde_json::to_string(&machine).unwrap()).unwrap();
    stored.with_target(target.clone())
}

#[test]
fn a_run_killed_after_its_step_aside_servos_on_and_arrives() {
    let clock = Arc::<VirtualClock>::default();
    let bench = over_tissue(&clock);
    bench.twin.settle_dust(&[hard_dust()], 3).unwrap();
    let aim = bench.twin.truth_now();
    for target in [save(&bench).unwrap(), save_still(&bench)] {
        let machine = Reposition::new(target.clone(), options()).with_calibrations([calibration()]);
        let stepped = |event: &Event| matches!(event, Event::SteppedAside { .. });
        let mut found = killed_at(&target, machine, &bench.scope, stepped);
        let off = bench.error_from(&aim).0;
        assert!(off > 5.0, "it was killed aside: {off} um");
        let outcome = run(&mut found, &opened(&bench.twin, &clock), &mut NoSink).unwrap();
        is_true(&bench, &outcome, &aim);
        assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    }
}

#[test]
fn a_clock_that_begins_anew_between_two_confirming_frames_does_not_confirm_early() {
    let clock = Arc::<VirtualClock>::default();
    let bench = over_tissue(&clock);
    let target = save(&bench).unwrap();
    bench.twin.remount(PLACE_UM, [38.0, -24.0], 1.0, false);
    let machine = Reposition::new(target.clone(), options()).with_calibrations([calibration()]);
    let passed = |event: &Event| {
        matches!(
            event,
            Event::Iteration {
                converged: true,
                ..
            }
        )
    };
    let mut found = killed_at(&target, machine, &bench.scope, passed);
    // All was switched off and on, and the view is still there.
    let since = clock.now().seconds();
    let clock = Arc::<VirtualClock>::default();
    let bench = over_tissue(&clock);
    assert!(clock.now().seconds() + 0.5 < since);
    let mut times = Vec::new();
    let outcome = loop {
        let mut sink = Listener(|event: &Event| {
            if passed(event) {
                times.push(clock.now().seconds());
            }
        });
        if let Progress::Done(outcome) = found.step(&bench.scope, &mut sink).unwrap() {
            break outcome;
        }
    };
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    let [first, .., last] = times[..] else {
        panic!("one frame after the clock began anew: {times:?}");
    };
    assert!(last - first >= 0.45, "{times:?}");
}
