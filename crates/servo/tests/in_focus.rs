//! A view that is about to be saved is looked at: is it in focus? One that is blurred is told, and left where it was.

mod common;

use common::{Bench, bench, bench_over, one_objective};
use scopeservo_scope::{Axis, Frame, StagePose};
use scopeservo_servo::{
    Event, FocusOptions, FrameRole, InFocus, Procedure, Progress, Sink, Stamped, VisionOptions, run,
};
use scopeservo_twin::{Blank, Config};
use std::sync::Arc;

/// What was told, and how many frames it took.
#[derive(Default)]
struct Listener {
    told: Vec<Event>,
    frames: usize,
}

impl Sink for Listener {
    fn event(&mut self, stamped: Stamped) {
        if let Event::Blurred { .. } = stamped.event {
            self.told.push(stamped.event);
        }
    }

    fn frame(&mut self, _: &Frame, _: FrameRole) {
        self.frames += 1;
    }
}

fn z_um(bench: &Bench) -> f64 {
    1e6 * bench.scope.gate().position().unwrap().si(Axis::Z).unwrap()
}

fn go_z(bench: &Bench, um: f64) {
    let to = StagePose::default().with_si(Axis::Z, um * 1e-6);
    bench.scope.move_to(&to).unwrap();
}

/// Moves z until the truth says so, the last time towards the specimen or away from it.
fn put_at(bench: &Bench, defocus_um: f64, towards: bool) {
    // Positive z brings them closer, and too close is positive.
    let aside = if towards { -40.0 } else { 40.0 };
    for _ in 0..4 {
        let goal = z_um(bench) + defocus_um - bench.twin.truth_now().defocus_um;
        go_z(bench, goal + aside);
        go_z(bench, goal);
    }
    for _ in 0..3 {
        let off = defocus_um - bench.twin.truth_now().defocus_um;
        if (off > 0.0) == towards {
            go_z(bench, z_um(bench) + off);
        }
    }
}

fn procedure(bench: &Bench) -> InFocus {
    let objective = bench.scope.gate().objectives()[0].id.clone();
    InFocus::new(objective, FocusOptions::default(), VisionOptions::default())
}

fn look(bench: &Bench) -> Listener {
    let mut heard = Listener::default();
    run(&mut procedure(bench), &bench.scope, &mut heard).unwrap();
    heard
}

fn with_play(um: f64) -> Config {
    let mut config = one_objective();
    for axis in &mut config.stage.axes {
        if axis.axis == Axis::Z {
            axis.backlash = um;
        }
    }
    config
}

#[test]
fn a_view_in_focus_is_told_by_few_frames_and_stays_so() {
    let bench = bench(one_objective());
    put_at(&bench, 0.1, true);
    let heard = look(&bench);
    assert_eq!(heard.told, []);
    assert!(heard.frames <= 12, "{} frames", heard.frames);
    let end = bench.twin.truth_now().defocus_um;
    assert!(end.abs() < 0.4, "{end} um");
}

#[test]
fn a_blurred_view_is_told_with_how_far_and_which_way_and_left_as_it_was() {
    for (defocus_um, play_um) in [(12.0, 0.0), (-9.0, 0.0), (11.0, 3.0)] {
        let bench = bench(with_play(play_um));
        put_at(&bench, defocus_um, true);
        let began = z_um(&bench);
        let heard = look(&bench);
        let [
            Event::Blurred {
                sharper_by_um,
                features,
                features_there,
                ..
            },
        ] = &heard.told[..]
        else {
            panic!("{defocus_um}: {:?}", heard.told);
        };
        assert!(
            (sharper_by_um + defocus_um).abs() < 1.0,
            "{defocus_um}: {sharper_by_um}"
        );
        assert!(features_there > features);
        assert!((z_um(&bench) - began).abs() < 0.3);
        let end = bench.twin.truth_now().defocus_um;
        assert!((end - defocus_um).abs() < 0.5, "{defocus_um}: {end}");
    }
}

#[test]
fn a_sharp_view_stays_sharp_where_the_drive_has_play() {
    // Reached from the specimen's side, where the same number is another height.
    let bench = bench(with_play(4.0));
    put_at(&bench, 0.0, false);
    let before = bench.twin.truth_now().defocus_um;
    assert!(before.abs() < 0.3, "{before}");
    assert_eq!(look(&bench).told, []);
    let end = bench.twin.truth_now().defocus_um;
    assert!(end.abs() < 0.5, "{end} um");
}

#[test]
fn where_nothing_tells_nothing_is_said_and_the_stage_is_back() {
    let bench = bench_over(one_objective(), Arc::new(Blank), Vec::new());
    put_at(&bench, 12.0, true);
    let began = z_um(&bench);
    let heard = look(&bench);
    assert_eq!(heard.told, []);
    let end = z_um(&bench);
    assert!(
        (end - began).abs() < 0.3,
        "{began} to {end}: {} frames",
        heard.frames
    );
}

#[test]
fn it_goes_on_from_its_stored_state() {
    let bench = bench(one_objective());
    put_at(&bench, 12.0, true);
    let mut heard = Listener::default();
    let mut machine = procedure(&bench);
    loop {
        let stored = serde_json::to_string(&machine).unwrap();
        assert!(stored.len() < 20_000, "{}", stored.len());
        machine = serde_json::from_str(&stored).unwrap();
        if let Progress::Done(()) = machine.step(&bench.scope, &mut heard).unwrap() {
            break;
        }
    }
    assert_eq!(heard.told.len(), 1);
}
