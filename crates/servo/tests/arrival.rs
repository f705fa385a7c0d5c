//! Whole runs on the simulated microscope: they arrive on every kind of stage, and say so only when it is true.

mod common;

use common::{Listener, PLACE_UM, bench, one_objective, options, run_through_json};
use scopeservo_scope::{Axis, CancelToken, Instrument, Kinematics};
use scopeservo_servo::{Event, Reason, Reposition, RepositionOptions, Verdict, run};
use scopeservo_twin::{AutoExposureConfig, Config, StageConfig, StageFault};

/// Saves a view, puts the slide back 45 um away and turned, and comes back.
fn come_back(config: Config, turn_deg: f64) -> (Verdict, (f64, f64), String) {
    let bench = bench(config);
    let (target, truth) = bench.save();
    bench.twin.remount(PLACE_UM, [38.0, -24.0], turn_deg, false);
    let outcome = bench.reposition(target).unwrap();
    (outcome.verdict, bench.error_from(&truth), outcome.message)
}

fn assert_arrives(config: Config, turn_deg: f64) {
    let name = format!("{:?} {}", config.stage.kinematics, config.stage.name);
    let (verdict, (um, deg), message) = come_back(config, turn_deg);
    assert_eq!(verdict, Verdict::Arrived, "{name}: {message}");
    assert!(um <= 1.0 && deg <= 0.02, "{name}: {um} um, {deg} deg");
}

#[test]
fn it_arrives_whichever_side_moves() {
    assert_arrives(one_objective(), 3.0);
    for kinematics in [
        Kinematics::SpecimenRotationOnTop,
        Kinematics::SpecimenXyOnTop,
    ] {
        let stage = StageConfig {
            kinematics,
            ..StageConfig::xyz_theta()
        };
        assert_arrives(one_objective().with_stage(stage), -3.0);
    }
}

#[test]
fn it_arrives_on_a_stage_with_play_whose_moves_then_end_from_one_side() {
    let mut stage = StageConfig::xyz_theta();
    for axis in &mut stage.axes {
        match axis.axis {
            Axis::X | Axis::Y => axis.backlash = 20.0,
            Axis::Rz => axis.backlash = 200.0,
            _ => {}
        }
    }
    assert_arrives(one_objective().with_stage(stage), 2.0);
}

#[test]
fn it_arrives_with_a_mirrored_camera() {
    let mut config = one_objective();
    config.mount.mirrored = true;
    config.mount.phi_deg = 31.0;
    assert_arrives(config, 2.0);
}

#[test]
fn it_arrives_with_a_cheap_camera_that_rolls_and_exposes_itself() {
    for settle_s in [0.05, 0.3, 2.0] {
        let mut config = one_objective();
        config.camera.rolling = true;
        config.camera.readout_ms = 30.0;
        config.camera.auto_exposure = Some(AutoExposureConfig {
            mean_level: 0.45,
            settle_s,
            most: 8.0,
        });
        assert_arrives(config, 3.0);
    }
}

#[test]
fn a_run_stored_and_restored_at_every_step_ends_as_if_it_had_not_been() {
    let go = |through_json: bool| {
        let bench = bench(one_objective());
        let (target, _) = bench.save();
        bench.twin.remount(PLACE_UM, [38.0, -24.0], 3.0, false);
        if through_json {
            run_through_json(target, &bench.scope)
        } else {
            bench.reposition(target).unwrap()
        }
    };
    assert_eq!(go(false), go(true));
}

#[test]
fn another_slide_is_not_found() {
    let bench = bench(one_objective());
    let (target, _) = bench.save();
    bench
        .twin
        .replace_specimen(std::sync::Arc::new(scopeservo_twin::specimen::Tissue::new(
            8,
        )));
    let outcome = bench.reposition(target).unwrap();
    assert_eq!(
        (outcome.verdict, outcome.reason),
        (Verdict::NotFound, Reason::TargetNotInView),
        "{}",
        outcome.message
    );
}

#[test]
fn a_stage_that_only_claims_to_move_never_arrives() {
    for axis in [Axis::X, Axis::Rz] {
        let bench = bench(one_objective());
        let (target, truth) = bench.save();
        bench.twin.remount(PLACE_UM, [38.0, -24.0], 3.0, false);
        bench
            .twin
            .fault(StageFault::StuckAxis { axis, stuck: true });
        let outcome = bench.reposition(target).unwrap();
        assert_ne!(
            outcome.verdict,
            Verdict::Arrived,
            "{axis}: {:?}",
            bench.error_from(&truth)
        );
    }
}

#[test]
fn losing_steps_on_the_way_is_made_good() {
    let bench = bench(one_objective());
    let (target, truth) = bench.save();
    bench.twin.remount(PLACE_UM, [38.0, -24.0], 3.0, false);
    bench.twin.fault(StageFault::LostSteps {
        axis: Axis::X,
        si: 20e-6,
    });
    let outcome = bench.reposition(target).unwrap();
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    assert!(bench.error_from(&truth).0 <= 1.0);
}

#[test]
fn a_focus_that_is_known_is_used_again_where_it_is_asked_and_moves_tell_what_they_promise() {
    let bench = bench(one_objective());
    let (target, truth) = bench.save();
    let go = |scope: &Instrument| {
        bench.twin.remount(PLACE_UM, [38.0, -24.0], 3.0, false);
        let options = RepositionOptions {
            reuse_focus: true,
            ..options()
        };
        let (mut sweeps, mut moves) = (0, Vec::new());
        let mut listener = Listener(|event: &Event| match event {
            Event::FocusSample { .. } => sweeps += 1,
            Event::Iteration {
                error,
                promised: Some(p),
                ..
            } => moves.push((*error, p.clone())),
            _ => {}
        });
        let mut reposition = Reposition::new(target.clone(), options);
        let outcome = run(&mut reposition, scope, &mut listener).unwrap();
        assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
        assert!(bench.error_from(&truth).0 <= 1.0);
        (sweeps, moves)
    };
    let (sweeps, moves) = go(&bench.scope);
    assert_eq!(sweeps, 0, "it was focused in this session");
    assert!(!moves.is_empty());
    for (seen, promised) in moves {
        let off = [0, 1].map(|k| seen.t_m[k] - promised.error.t_m[k]);
        let within = 4.0 * promised.sigma_m + 1e-6;
        assert!(f64::hypot(off[0], off[1]) <= within, "{off:?} {promised:?}");
        assert!(promised.sigma_m > 0.0 && promised.sigma_rad > 0.0);
    }
    // Another session knows of none.
    let twin = &bench.twin;
    let opened = Instrument::new(twin.devices(), twin.rules(), CancelToken::new()).unwrap();
    assert!(go(&opened).0 > 5);
}
