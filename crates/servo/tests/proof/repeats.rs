//! What repeats itself, and what does not rest.

use super::*;

#[test]
fn a_lattice_is_refused_at_saving_and_a_target_of_one_is_ambiguous() {
    for pitch_um in [8.0, 20.0, 60.0] {
        let bench = over(lattice(pitch_um, 0.0), &[]);
        let refusal = save(&bench).unwrap_err();
        let ServoError::Repeats { rival, .. } = &refusal else {
            panic!("{pitch_um}: {refusal}");
        };
        // The period that is named is one of the lattice.
        let um = rival.shift_px.map(|v| v * 0.51 / pitch_um);
        for periods in um {
            assert!(
                (periods - periods.round()).abs() < 0.1,
                "{pitch_um}: {um:?}"
            );
        }
        let aim = bench.twin.truth_now();
        let target = save_still(&bench);
        bench
            .twin
            .remount(PLACE_UM, [0.45 * pitch_um, 1.55 * pitch_um], 0.0, false);
        let (outcome, _) = go(&bench, target);
        is_true(&bench, &outcome, &aim);
        assert_ne!(
            outcome.verdict,
            Verdict::Arrived,
            "{pitch_um}: {}",
            outcome.message
        );
    }
}

#[test]
fn disorder_tells_a_lattice_apart() {
    for pitch_um in [34.0, 40.0] {
        let bench = over(lattice(pitch_um, 0.05), &[]);
        let aim = bench.twin.truth_now();
        let target = save(&bench).unwrap_or_else(|e| panic!("{pitch_um}: {e}"));
        bench.twin.remount(PLACE_UM, [30.0, -18.0], 0.5, false);
        let (outcome, _) = go(&bench, target);
        is_true(&bench, &outcome, &aim);
        assert_eq!(
            outcome.verdict,
            Verdict::Arrived,
            "{pitch_um}: {}",
            outcome.message
        );
    }
}

/// Turned by a quarter about the cell that is missing it looks the same, and the saved place lies elsewhere: 70 um away the run once arrived.
#[test]
fn a_lattice_turned_about_its_missing_cell_is_never_arrived_at_elsewhere() {
    for turn_deg in [90.0, 180.0, -90.0] {
        let config = LatticeConfig {
            pitch_um: 50.0,
            odd_cell: Some([7, 2]),
            ..LatticeConfig::default()
        };
        let bench = over(Arc::new(Lattice::new(config).unwrap()), &[]);
        let target = save_still(&bench);
        bench.twin.remount(PLACE_UM, [30.0, -18.0], turn_deg, false);
        let (outcome, _) = go(&bench, target);
        assert_ne!(
            outcome.verdict,
            Verdict::Arrived,
            "{turn_deg}: {}",
            outcome.message
        );
    }
}

#[test]
fn a_view_that_drifts_is_refused_with_its_speed() {
    let bench = over(Arc::new(scopeservo_twin::specimen::Tissue::new(7)), &[]);
    let target = save(&bench).unwrap();
    bench.twin.remount(PLACE_UM, [38.0, -24.0], 1.0, false);
    bench.twin.fault(StageFault::Drift {
        um_per_s: [1.0, 0.0, 0.0],
    });
    let (outcome, _) = go(&bench, target);
    assert_eq!(
        (outcome.verdict, outcome.reason),
        (Verdict::Refused, Reason::Drifting),
        "{}",
        outcome.message
    );
    assert!(
        outcome.message.contains("um per second"),
        "{}",
        outcome.message
    );
}

/// Tissue in which the whole target is there twice, 500 um apart: the weakest objective sees both.
#[test]
fn a_target_that_is_there_twice_in_the_widest_view_is_ambiguous() {
    let mut stage = StageConfig::xyz_theta();
    stage.axes.retain(|a| a.axis != Axis::Z);
    let config = Config::realistic().with_stage(stage);
    let twice = MadeSpecimen::Twice(TwiceConfig {
        seed: 7,
        original_um: PLACE_UM,
        copy_um: [PLACE_UM[0] + 500.0, PLACE_UM[1]],
        size_um: [450.0, 350.0],
    });
    let bench = bench_over(config, twice.make().unwrap(), Vec::new());
    let mut known = Vec::new();
    for objective in bench.scope.gate().objectives().to_vec() {
        bench.scope.select_objective(&objective.id).unwrap();
        let (options, vision) = (options().calibrate, VisionOptions::default());
        let mut calibrate = Calibrate::new(objective.clone(), options, vision);
        let made = run(&mut calibrate, &bench.scope, &mut NoSink).unwrap();
        known.push((objective.id, made));
    }
    bench.twin.centre_specimen(PLACE_UM, 0.0);
    let target = save(&bench).unwrap();
    bench.twin.remount(PLACE_UM, [-220.0, 60.0], 1.0, false);
    let mut reposition = Reposition::new(target, options()).with_calibrations(known);
    let outcome = run(&mut reposition, &bench.scope, &mut NoSink).unwrap();
    assert_eq!(
        (outcome.verdict, outcome.reason),
        (Verdict::Ambiguous, Reason::Ambiguous),
        "{}",
        outcome.message
    );
    let end = &outcome.magnifications.last().unwrap().end;
    let ServoEnd::Ambiguous { rival, um_per_px } = end else {
        panic!("{end:?}");
    };
    let away_um = um_per_px * f64::hypot(rival.shift_px[0], rival.shift_px[1]);
    assert!(
        (away_um - 500.0).abs() < 20.0,
        "the other place is named: {away_um}"
    );
}
