//! Stages that do not do what they say: each misbehaves in one way, with the answer that it must get.

mod misbehaving;

use misbehaving::{Bench, Make, Wrong};
use scopeservo_scope::conformance::{Check, check_stage};
use scopeservo_scope::{Axis, ErrorKind, Motion, PositiveZ, ScopeError, StagePose};
use scopeservo_servo::{
    Bring, Calibrate, CalibrateOptions, Focus, FocusOptions, ServoError, VisionOptions, drift_seen,
    scale_seen,
};
use scopeservo_twin::StageFault;
use scopeservo_twin::specimen::Blank;
use std::sync::Arc;

fn bench() -> Bench {
    Bench::new(Make::default())
}

fn focus(bench: &Bench) -> Focus {
    let objective = bench.scope.gate().objectives()[0].clone();
    Focus::new(objective, FocusOptions::default())
}

fn calibrate(bench: &Bench) -> Calibrate {
    let objective = bench.scope.gate().objectives()[0].clone();
    Calibrate::new(
        objective,
        CalibrateOptions::default(),
        VisionOptions::default(),
    )
}

fn scope_error(error: ServoError) -> ScopeError {
    match error {
        ServoError::Scope(error) => error,
        ServoError::StaysNear { error, .. } => scope_error(*error),
        other => panic!("{other}"),
    }
}

#[test]
fn a_stage_that_does_not_get_there_is_a_fault() {
    type Case = (Wrong, Axis);
    let in_focus: [Case; 5] = [
        (Wrong::Wall(Axis::Z, [-1e4, -4.0]), Axis::Z),
        (Wrong::Mirrored(Axis::Z), Axis::Z),
        (Wrong::SaysZero, Axis::Z),
        (Wrong::SaysOtherSign, Axis::Z),
        (Wrong::SettlesEarly, Axis::Z),
    ];
    let in_calibration: [Case; 8] = [
        (Wrong::Wall(Axis::X, [-20.0, 1e4]), Axis::X),
        (Wrong::Wall(Axis::X, [-1e4, 20.0]), Axis::X),
        (Wrong::Share(0.5), Axis::X),
        (Wrong::Share(1.25), Axis::X),
        (Wrong::Mirrored(Axis::X), Axis::X),
        (Wrong::RunsOn(500.0), Axis::X),
        (Wrong::SaysOfX(150.0), Axis::X),
        (Wrong::Says(500.0), Axis::X),
    ];
    let cases = in_focus.iter().map(|case| (case, true));
    for ((wrong, axis), focuses) in cases.chain(in_calibration.iter().map(|case| (case, false))) {
        let bench = bench();
        bench.goes_wrong(*wrong);
        let ended = match focuses {
            true => bench.run(focus(&bench)).map(drop),
            false => bench.run(calibrate(&bench)).map(drop),
        };
        let error = scope_error(ended.expect_err("it must not succeed"));
        assert!(
            matches!(&error, ScopeError::NotArrived { axis: a, .. } if a == axis),
            "{wrong:?}: {error}"
        );
        assert_eq!(error.kind(), ErrorKind::Fault);
        assert!(bench.log().stops > 0, "{wrong:?}");
    }
}

#[test]
fn an_obstacle_is_met_once_and_told_with_the_goal_and_the_place() {
    let bench = bench();
    bench.goes_wrong(Wrong::Wall(Axis::Z, [-1e4, -4.0]));
    let error = bench.run(focus(&bench)).unwrap_err();
    assert!(
        error.to_string().contains("z was sent to ")
            && error.to_string().contains("settled at -4.0 um"),
        "{error}"
    );
    let into = |to: &&StagePose| to.si(Axis::Z).is_some_and(|z| z * 1e6 > -4.0 + 1.0);
    assert_eq!(bench.log().goals.iter().filter(into).count(), 1);
    // It began at 0, and the obstacle keeps it farther away.
    assert!(bench.true_um(Axis::Z) < -3.0);
}

#[test]
fn a_stage_that_stops_on_its_way_or_never_settles_is_a_fault() {
    type Is = fn(&ScopeError) -> bool;
    let cases: [(Wrong, Is); 3] = [
        (Wrong::StopsShort, |e| {
            matches!(e, ScopeError::MoveAborted { .. })
        }),
        (Wrong::NeverSettles, |e| {
            matches!(e, ScopeError::Timeout { .. })
        }),
        (Wrong::FailsNearer(-100.0), |e| {
            matches!(e, ScopeError::Device { .. })
        }),
    ];
    for (wrong, is) in cases {
        let bench = bench();
        bench.goes_wrong(wrong);
        let error = scope_error(bench.run(focus(&bench)).unwrap_err());
        assert!(is(&error), "{wrong:?}: {error}");
    }
}

#[test]
fn a_place_outside_the_travel_or_nowhere_is_a_fault() {
    for um in [1e300, 9e6, -9e6, f64::NAN, f64::INFINITY] {
        let bench = bench();
        bench.goes_wrong(Wrong::SaysOfX(um));
        let axis = Axis::X;
        for ended in [
            bench.run(focus(&bench)).map(drop),
            bench.run(calibrate(&bench)).map(drop),
            bench.scope.gate().position().map(drop).map_err(Into::into),
            bench
                .scope
                .gate()
                .check(&StagePose::default())
                .map_err(Into::into),
        ] {
            let error = scope_error(ended.unwrap_err());
            assert!(
                matches!(error, ScopeError::ImpossiblePlace { axis: a, .. } if a == axis),
                "{um}: {error}"
            );
            assert!(error.to_string().len() < 300, "{error}");
        }
        assert!(bench.log().goals.is_empty(), "{um}");
    }
}

#[test]
fn an_axis_that_goes_along_past_its_limit_stops_the_work() {
    let bench = Bench::new(Make {
        z_um: [-2500.0, 60.0],
        ..Make::default()
    });
    bench.goes_wrong(Wrong::LiftsZ(30.0));
    let began = bench.true_um(Axis::Z);
    let error = scope_error(bench.run(calibrate(&bench)).unwrap_err());
    assert!(matches!(error, ScopeError::Strayed { .. }), "{error}");
    assert!(
        error.to_string().contains("outside -2500.0 to 60.0 um"),
        "{error}"
    );
    // It was taken back from where it had been lifted to.
    let z = bench.true_um(Axis::Z);
    assert!(z < began + 1.0, "{z}, and it began at {began}");
}

#[test]
fn a_stage_that_stands_outside_only_comes_back() {
    let bench = Bench::new(Make {
        x_um: [-200.0, 200.0],
        z_um: [-100.0, 60.0],
        ..Make::default()
    });
    let to = |axis, um: f64| StagePose::default().with_si(axis, um * 1e-6);
    let said = |place: &StagePose| bench.scope.move_to(place).unwrap_err();
    bench.put_um(Axis::X, 500.0);
    for ended in [
        bench.run(focus(&bench)).map(drop),
        bench.run(calibrate(&bench)).map(drop),
    ] {
        assert_eq!(scope_error(ended.unwrap_err()).kind(), ErrorKind::Refused);
    }
    let sideways = said(&to(Axis::Z, 10.0));
    assert!(
        matches!(sideways, ScopeError::StandsOutside { .. }),
        "{sideways}"
    );
    assert!(matches!(
        said(&to(Axis::X, 600.0)),
        ScopeError::OutsideLimits { .. }
    ));
    assert!(matches!(
        said(&to(Axis::X, -300.0)),
        ScopeError::OutsideLimits { .. }
    ));
    assert!(bench.log().goals.is_empty());
    // Nearer, straight away from the specimen, and back inside.
    for place in [to(Axis::X, 400.0), to(Axis::Z, -50.0), to(Axis::X, 200.0)] {
        bench.scope.move_to(&place).unwrap();
    }
    // Too near to the specimen there is one way only.
    bench.put_um(Axis::Z, 90.0);
    let across = said(&to(Axis::X, 0.0));
    assert!(
        matches!(across, ScopeError::StandsOutside { .. }),
        "{across}"
    );
    bench.scope.move_to(&to(Axis::Z, 50.0)).unwrap();
    bench.scope.move_to(&to(Axis::X, 0.0)).unwrap();
    // Beyond the far end the way is back.
    bench.put_um(Axis::Z, -900.0);
    assert!(matches!(
        said(&to(Axis::Z, -950.0)),
        ScopeError::OutsideLimits { .. }
    ));
    bench.scope.move_to(&to(Axis::Z, -90.0)).unwrap();
}

#[test]
fn a_stage_that_only_pretends_to_move_is_seen_by_the_pictures() {
    let bench = bench();
    bench.goes_wrong(Wrong::Pretends);
    let focused = bench.run(focus(&bench)).unwrap_err();
    assert!(matches!(focused, ServoError::NoFocus { .. }), "{focused}");
    let calibrated = bench.run(calibrate(&bench)).unwrap_err();
    assert!(
        matches!(calibrated, ServoError::AxisStands { axis: Axis::X, .. }),
        "{calibrated}"
    );
}

#[test]
fn play_that_the_encoder_does_not_see_is_no_fault() {
    let bench = Bench::new(Make {
        play_um: 20.0,
        ..Make::default()
    });
    let found = bench.run(focus(&bench)).unwrap();
    let said = bench.scope.gate().position().unwrap().si(Axis::Z).unwrap() * 1e6;
    assert_eq!(found.z_um, Some(said));
    // What it says is not where it is.
    assert!((bench.true_um(Axis::Z) - said).abs() > 5.0);
    assert!(bench.twin.truth_now().defocus_um.abs() < 2.0);
    bench.run(calibrate(&bench)).unwrap();
}

/// What fails, from how far away from the twin's focus it begins, um, and how it is done.
type Failure = (&'static str, f64, fn(&Bench) -> Result<(), ServoError>);

const FAILURES: [Failure; 7] = [
    ("blank glass", 0.0, |b| {
        b.twin.replace_specimen(Arc::new(Blank));
        b.run(focus(b)).map(drop)
    }),
    ("the focus lies far beyond the sweep", 600.0, |b| {
        b.run(focus(b)).map(drop)
    }),
    ("the camera fails in the sweep", 0.0, |b| {
        b.pictures_left(6);
        b.run(focus(b)).map(drop)
    }),
    ("the stage refuses a part of the sweep", 30.0, |b| {
        b.goes_wrong(Wrong::RefusesNearer(-5.0));
        b.run(focus(b)).map(drop)
    }),
    ("the stage fails in a part of the sweep", 30.0, |b| {
        b.goes_wrong(Wrong::FailsNearer(-5.0));
        b.run(focus(b)).map(drop)
    }),
    ("there is an obstacle", 30.0, |b| {
        let wall = match b.scope.gate().info().positive_z {
            PositiveZ::Closer => [-1e4, -7.0],
            PositiveZ::Apart => [7.0, 1e4],
        };
        b.goes_wrong(Wrong::Wall(Axis::Z, wall));
        b.run(focus(b)).map(drop)
    }),
    ("it is focused, and then not calibrated", 25.0, |b| {
        let id = b.scope.gate().objectives()[0].id.clone();
        let options = Some(FocusOptions::default());
        b.run(Bring::new(id, options, VisionOptions::default()))?;
        b.goes_wrong(Wrong::Mirrored(Axis::X));
        b.run(calibrate(b)).map(drop)
    }),
];

#[test]
fn a_failed_focus_or_calibration_leaves_the_stage_no_nearer_than_the_command_began() {
    for positive_z in [PositiveZ::Closer, PositiveZ::Apart] {
        for ((case, away_um, fails), play_um) in FAILURES
            .into_iter()
            .flat_map(|failure| [(failure, 0.0), (failure, 4.0)])
        {
            let bench = Bench::new(Make {
                positive_z,
                play_um,
                ..Make::default()
            });
            bench.put_um(Axis::Z, positive_z.away(0.0, away_um));
            let said_um = || bench.scope.gate().position().unwrap().si(Axis::Z).unwrap() * 1e6;
            let (said, truth) = (said_um(), bench.true_um(Axis::Z));
            let ended = fails(&bench);
            assert!(ended.is_err(), "{case}, {positive_z:?}: it did not fail");
            let goals = bench.log().goals.clone();
            let nearest = goals
                .iter()
                .filter_map(|to| to.si(Axis::Z))
                .map(|z| positive_z.nearer_by(z * 1e6, said))
                .fold(f64::NEG_INFINITY, f64::max);
            assert!(nearest > 5.0, "{case}, {positive_z:?}: it was never nearer");
            let nearer = positive_z.nearer_by(said_um(), said);
            assert!(
                nearer < 1e-3,
                "{case}, {positive_z:?}: {nearer} um nearer, as it says"
            );
            // Both arrivals scatter by 0.1 um.
            let nearer = positive_z.nearer_by(bench.true_um(Axis::Z), truth);
            assert!(
                nearer < 0.3,
                "{case}, {positive_z:?}: {nearer} um nearer, in truth"
            );
        }
    }
}

#[test]
fn no_sweep_passes_its_bound_towards_the_specimen() {
    for positive_z in [PositiveZ::Closer, PositiveZ::Apart] {
        for (half_range_um, nearest_um) in [(40.0, 120.0), (40.0, 40.0), (20.0, 5.0)] {
            // The focus lies nearer than any sweep goes: all rise towards it.
            let bench = Bench::new(Make {
                positive_z,
                ..Make::default()
            });
            let began = positive_z.away(0.0, 150.0);
            bench.put_um(Axis::Z, began);
            let objective = bench.scope.gate().objectives()[0].clone();
            let options = FocusOptions {
                half_range_um,
                nearest_um,
                min_contrast: 1.0,
                ..FocusOptions::default()
            };
            let _ = bench.run(Focus::new(objective, options));
            let log = bench.log();
            let heights = log.goals.iter().filter_map(|to| to.si(Axis::Z));
            let nearest = heights
                .map(|z| positive_z.nearer_by(z * 1e6, began))
                .fold(f64::NEG_INFINITY, f64::max);
            assert!(nearest > 0.0, "nothing was tried");
            assert!(
                nearest < nearest_um + 1e-3,
                "{nearest} um, and {nearest_um} are allowed"
            );
        }
    }
}

#[test]
fn a_stop_is_told_to_have_been_seen_or_to_have_been_ignored() {
    let to = StagePose::default().with_si(Axis::X, 2.9e-3);
    let obedient = bench();
    obedient.stop_after(20);
    let error = obedient.scope.move_to(&to).unwrap_err();
    let at = obedient.scope.gate().position().unwrap();
    assert_eq!(error, ScopeError::Interrupted { at: Some(at) });
    assert!(
        error.to_string().contains(&format!("stands still at {at}")),
        "{error}"
    );

    let deaf = Bench::new(Make {
        x_um: [-5e4, 5e4],
        ..Make::default()
    });
    deaf.goes_wrong(Wrong::IgnoresStop);
    deaf.stop_after(20);
    let far = StagePose::default().with_si(Axis::X, 4.9e-2);
    let error = deaf.scope.move_to(&far).unwrap_err();
    assert_eq!(error, ScopeError::StillMoves { device: "stage" });
    assert!(error.to_string().contains("emergency stop"), "{error}");
    assert_eq!(deaf.scope.gate().poll(), Ok(Motion::Moving));
}

fn failed(checks: Vec<Check>) -> Vec<(&'static str, String)> {
    let failed = checks
        .into_iter()
        .filter_map(|c| Some((c.name, c.outcome.err()?)));
    failed.collect()
}

#[test]
fn the_suite_finds_walls_to_either_side_axes_that_go_along_and_stages_that_go_on() {
    let sound = bench();
    assert_eq!(failed(check_stage(&sound.scope)), []);
    let moves = "every axis moves to either side, reads back, and takes no other along";
    for (wrong, check, word) in [
        (Wrong::Wall(Axis::X, [-20.0, 1e4]), moves, "x was sent to"),
        (Wrong::Wall(Axis::X, [-1e4, 20.0]), moves, "x was sent to"),
        (Wrong::Wall(Axis::Y, [-20.0, 1e4]), moves, "y was sent to"),
        (Wrong::Wall(Axis::Y, [-1e4, 20.0]), moves, "y was sent to"),
        (Wrong::Wall(Axis::Z, [-1e4, -4.0]), moves, "z was sent to"),
        (Wrong::Wall(Axis::Z, [-10.0, 1e4]), moves, "z was sent to"),
        (Wrong::LiftsZ(30.0), moves, "x was moved, and z went along"),
        (Wrong::LiftsZ(-30.0), moves, "x was moved, and z went along"),
        (Wrong::Share(0.5), moves, "x was sent to"),
        (
            Wrong::Creeps(6.0),
            "the stage stays where it arrived",
            "went on",
        ),
    ] {
        let bench = bench();
        bench.goes_wrong(wrong);
        let failed = failed(check_stage(&bench.scope));
        assert!(
            failed
                .iter()
                .any(|(name, said)| *name == check && said.contains(word)),
            "{wrong:?}: {failed:?}"
        );
    }
}

#[test]
fn a_unit_that_is_wrong_by_a_thousand_is_seen_before_it_goes_far() {
    let vision = VisionOptions::default();
    let look = |wrong| {
        let bench = bench();
        bench.run(focus(&bench)).unwrap();
        bench.goes_wrong(wrong);
        let id = bench.scope.gate().objectives()[0].id.clone();
        let seen = scale_seen(&bench.scope, &id, &vision);
        let Wrong::Unit(times) = wrong else {
            return (seen, 0.0);
        };
        let log = bench.log();
        let went = log.goals.iter().filter_map(|to| to.si(Axis::X));
        let farthest_um = went.map(|x| x.abs() * times * 1e6).fold(0.0, f64::max);
        (seen, farthest_um)
    };
    let (sound, _) = look(Wrong::Nothing);
    let sound = sound.unwrap();
    assert!(
        sound.as_told && (sound.um_per_px / 0.508 - 1.0).abs() < 0.1,
        "{sound:?}"
    );
    let (short, _) = look(Wrong::Unit(1e-3));
    assert!(
        matches!(short, Err(ServoError::PictureStays { .. })),
        "{short:?}"
    );
    let (long, went_um) = look(Wrong::Unit(1e3));
    assert!(
        matches!(long, Err(ServoError::MovesTooFar { .. })),
        "{long:?}"
    );
    assert!(went_um < 200.0, "{went_um}");
}

#[test]
fn a_view_that_drifts_is_seen_to() {
    let vision = VisionOptions::default();
    let bench = bench();
    bench.run(focus(&bench)).unwrap();
    let still = drift_seen(&bench.scope, &vision).unwrap();
    assert!(still.px_per_s < 0.2, "{still:?}");
    bench.twin.fault(StageFault::Drift {
        um_per_s: [1.0, 0.0, 0.0],
    });
    let drift = drift_seen(&bench.scope, &vision).unwrap();
    assert!((drift.px_per_s * 0.508 - 1.0).abs() < 0.2, "{drift:?}");
}
