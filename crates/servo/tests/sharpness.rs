//! Focus is part of arrival: a view that is less sharp than the saved one is brought to another height, once, and what stays so is told.

mod common;

use common::{Bench, Listener, PLACE_UM, bench_seeded, one_objective, options};
use scopeservo_geometry::SplitMix64;
use scopeservo_scope::{
    Axis, AxisRange, Camera, CameraInfo, CancelToken, Devices, Frame, Instrument, Length, Limits,
    PositiveZ, Rules, Samples, ScopeError, StagePose,
};
use scopeservo_servo::{
    Attempt, Calibrate, Calibration, Event, NoSink, Outcome, Remark, Reposition, Target, Verdict,
    VisionOptions, run,
};
use scopeservo_twin::{Config, DustConfig, SpecimenEvent, StageConfig, StageFault, Twin};
use std::sync::OnceLock;
use std::time::Duration;

/// Half of the depth of field of an aperture of 0.65, um.
const HALF_DEPTH_UM: f64 = 0.65;

/// A turntable, on which the slide is put back as high as it was.
fn turntable() -> Config {
    let mut config = one_objective().with_stage(StageConfig::xyz_theta());
    config.slide.seat_um = 0.0;
    config
}

fn calibration() -> &'static Calibration {
    static MADE: OnceLock<Calibration> = OnceLock::new();
    MADE.get_or_init(|| {
        let bench = bench_seeded(turntable(), 5);
        bench.save();
        let objective = bench.scope.gate().objectives()[0].clone();
        let vision = VisionOptions::default();
        let mut calibrate = Calibrate::new(objective, options().calibrate, vision);
        run(&mut calibrate, &bench.scope, &mut NoSink).unwrap()
    })
}

fn z_um(scope: &Instrument) -> f64 {
    scope.gate().position().unwrap().z.unwrap().um()
}

/// To where the middle of the view is so far out of focus: what only the simulator knows.
fn defocus(bench: &Bench, um: f64) {
    for _ in 0..4 {
        let off = bench.twin.truth_now().defocus_um - um;
        let side = bench.scope.gate().info().positive_z;
        let z_um = side.away(z_um(&bench.scope), off);
        let z = Some(Length::from_um(z_um));
        let to = StagePose {
            z,
            ..StagePose::default()
        };
        bench.scope.move_to(&to).unwrap();
    }
}

/// What a run came to.
struct Ended {
    outcome: Outcome,
    defocus_um: f64,
    off: (f64, f64),
}

impl Ended {
    fn again(&self) -> usize {
        let tried = |r: &&Remark| {
            let attempt = |r: &&Remark| match r {
                Remark::Tried { attempt, .. } => Some(attempt.clone()),
                _ => None,
            };
            matches!(attempt(r), Some(Attempt::FocusedAgain { .. }))
        };
        self.outcome.remarks.iter().filter(tried).count()
    }

    fn blurred_um(&self) -> Option<f64> {
        let told = |r: &Remark| match r {
            Remark::Blurred { defocus_um, .. } => Some(*defocus_um),
            _ => None,
        };
        self.outcome.remarks.iter().find_map(told)
    }
}

/// A view that was saved so far out of focus, and comes back with the focus of before.
struct Story {
    config: Config,
    saved_um: f64,
    /// Between saving and coming back.
    before: fn(&Bench),
    /// At each frame of the loop, by its number.
    on: fn(&Twin, usize),
    /// The slide is put back so far away.
    shift_um: [f64; 2],
}

impl Default for Story {
    fn default() -> Self {
        Self {
            config: turntable(),
            saved_um: 0.0,
            before: |_| {},
            on: |_, _| {},
            shift_um: [38.0, -45.0],
        }
    }
}

impl Story {
    fn begins(&self, seed: u64) -> (Bench, Target) {
        let bench = bench_seeded(self.config.clone(), seed);
        defocus(&bench, self.saved_um);
        let target = Target::save(&bench.scope, &VisionOptions::default(), &mut NoSink).unwrap();
        (bench, target)
    }

    fn ends(self, seed: u64) -> Ended {
        let (bench, target) = self.begins(seed);
        let truth = bench.twin.truth_now();
        let z = Length::from_um(z_um(&bench.scope));
        bench.scope.focus_found(&calibration().objective, z);
        bench.twin.remount(PLACE_UM, self.shift_um, 3.0, false);
        (self.before)(&bench);
        let outcome = comes_back(&bench.scope, target, &bench.twin, self.on);
        Ended {
            defocus_um: bench.twin.truth_now().defocus_um,
            off: bench.error_from(&truth),
            outcome,
        }
    }
}

fn comes_back(scope: &Instrument, target: Target, twin: &Twin, on: fn(&Twin, usize)) -> Outcome {
    let mut options = options();
    options.reuse_focus = true;
    let known = [(calibration().objective.clone(), calibration().clone())];
    let mut reposition = Reposition::new(target, options).with_calibrations(known);
    let mut frames = 0;
    let mut listener = Listener(|event: &Event| {
        if let Event::Iteration { .. } = event {
            on(twin, frames);
            frames += 1;
        }
    });
    run(&mut reposition, scope, &mut listener).unwrap()
}

fn rises(bench: &Bench, um: f64) {
    bench.twin.inject(SpecimenEvent::Height { um });
}

fn is_back(name: &str, ended: &Ended) {
    let (um, deg) = ended.off;
    let message = &ended.outcome.message;
    assert_eq!(ended.outcome.verdict, Verdict::Arrived, "{name}: {message}");
    assert!(um <= 1.0 && deg <= 0.02, "{name}: {um} um, {deg} deg");
}

/// Back, after another height was looked for, as sharp as half a depth of field allows.
fn is_sharp_again(name: &str, ended: &Ended) {
    is_back(name, ended);
    let message = &ended.outcome.message;
    assert_eq!(
        (ended.again(), ended.blurred_um()),
        (1, None),
        "{name}: {message}"
    );
    let off = ended.defocus_um;
    assert!(off.abs() <= HALF_DEPTH_UM, "{name}: {off} um: {message}");
}

#[test]
fn a_focus_that_is_used_again_and_does_not_hold_is_found_again() {
    type Before = fn(&Bench);
    let all: [(&str, Before); 5] = [
        ("3 higher", |b| rises(b, 3.0)),
        ("3 lower", |b| rises(b, -3.0)),
        ("1.2 higher", |b| rises(b, 1.2)),
        ("1.2 lower", |b| rises(b, -1.2)),
        ("6 lower", |b| rises(b, -6.0)),
    ];
    for (seed, (name, before)) in (5..).zip(all) {
        let story = Story {
            before,
            ..Story::default()
        };
        is_sharp_again(name, &story.ends(seed));
    }
}

/// The command began farther from the specimen, as with a lower objective: that is where a failed search goes back to.
#[test]
fn a_search_that_finds_nothing_sharper_leaves_the_height_at_which_the_run_stands() {
    let (bench, target) = Story::default().begins(5);
    let truth = bench.twin.truth_now();
    let saved_um = z_um(&bench.scope);
    let z = Length::from_um(saved_um);
    bench.scope.focus_found(&calibration().objective, z);
    let height = |um: f64| StagePose {
        z: Some(Length::from_um(um)),
        ..StagePose::default()
    };
    let side = bench.scope.gate().info().positive_z;
    let far_um = side.away(saved_um, 60.0);
    bench.scope.move_to(&height(far_um)).unwrap();
    bench.scope.command_begins();
    bench.scope.move_to(&height(saved_um)).unwrap();
    bench.twin.remount(PLACE_UM, [38.0, -45.0], 3.0, false);
    rises(&bench, -4.0);
    let mut options = options();
    options.reuse_focus = true;
    // No sweep finds anything.
    options.focus.min_contrast = 1e3;
    let known = [(calibration().objective.clone(), calibration().clone())];
    let mut reposition = Reposition::new(target, options).with_calibrations(known);
    let outcome = run(&mut reposition, &bench.scope, &mut NoSink).unwrap();
    let at_um = z_um(&bench.scope);
    let ended = Ended {
        defocus_um: bench.twin.truth_now().defocus_um,
        off: bench.error_from(&truth),
        outcome,
    };
    is_back("no sweep", &ended);
    assert_eq!(ended.again(), 1, "{}", ended.outcome.message);
    assert!(ended.blurred_um().is_some(), "{}", ended.outcome.message);
    assert!((at_um - saved_um).abs() < 20.0, "{at_um}, {saved_um}");
}

#[test]
fn what_is_within_half_a_depth_of_field_is_left_alone() {
    type Before = fn(&Bench);
    let all: [(&str, Before); 3] = [
        ("as it was", |_| {}),
        ("0.3 higher", |b| rises(b, 0.3)),
        ("0.3 lower", |b| rises(b, -0.3)),
    ];
    for (seed, (name, before)) in (11..).zip(all) {
        let ended = Story {
            before,
            ..Story::default()
        }
        .ends(seed);
        is_back(name, &ended);
        let told = (ended.again(), ended.blurred_um());
        assert_eq!(told, (0, None), "{name}: {}", ended.outcome.message);
    }
}

#[test]
fn what_drifts_out_of_focus_while_the_run_goes_on_is_seen_before_it_ends() {
    for (seed, frame) in [(5, 0), (6, 1), (7, 2)] {
        let on: fn(&Twin, usize) = match frame {
            0 => |twin, k| drifts(twin, k, 0),
            1 => |twin, k| drifts(twin, k, 1),
            _ => |twin, k| drifts(twin, k, 2),
        };
        let story = Story {
            on,
            ..Story::default()
        };
        is_sharp_again(&format!("at frame {frame}"), &story.ends(seed));
    }
}

fn drifts(twin: &Twin, k: usize, at: usize) {
    if k == at {
        twin.inject(SpecimenEvent::Height { um: 2.0 });
    }
}

#[test]
fn a_target_that_was_saved_out_of_focus_is_come_back_to_no_less_sharp() {
    type Before = fn(&Bench);
    let all: [(f64, Before); 3] = [
        (3.0, |b| rises(b, 2.0)),
        (3.0, |b| rises(b, -1.0)),
        (-3.0, |b| rises(b, -2.0)),
    ];
    for (seed, (saved_um, before)) in (5..).zip(all) {
        let story = Story {
            saved_um,
            before,
            ..Story::default()
        };
        let (ended, name) = (story.ends(seed), format!("{saved_um} um"));
        is_back(&name, &ended);
        assert_eq!(ended.blurred_um(), None, "{}", ended.outcome.message);
        let off = ended.defocus_um;
        assert!(off.abs() <= saved_um.abs() + HALF_DEPTH_UM, "{name}: {off}");
    }
}

#[test]
fn play_in_z_and_a_tilted_slide_do_not_keep_it_from_its_height() {
    let mut play = turntable();
    for axis in &mut play.stage.axes {
        if axis.axis == Axis::Z {
            axis.backlash = 8.0;
        }
    }
    for before in [|b: &Bench| rises(b, 2.5), |b: &Bench| rises(b, -2.5)] {
        let config = play.clone();
        let story = Story {
            config,
            before,
            ..Story::default()
        };
        is_sharp_again("play of 8 um", &story.ends(5));
    }
    // Play that the stage does not say.
    let unknown = Story {
        before: |b| {
            b.twin.fault(StageFault::Backlash {
                axis: Axis::Z,
                si: 8e-6,
            });
            rises(b, 2.5);
        },
        ..Story::default()
    };
    is_sharp_again("unknown play of 8 um", &unknown.ends(6));
    let mut tilted = turntable();
    tilted.slide.tilt_mrad = [5.0, 0.0];
    // Focused 0.6 mm beside the target: 3 um lower or higher.
    let story = Story {
        config: tilted,
        before: |b| {
            let here = b.scope.gate().position().unwrap();
            let x = here.x.map(|x| Length::from_um(x.um() + 600.0));
            b.scope.move_to(&StagePose { x, ..here }).unwrap();
            defocus(b, 0.0);
            let z = b.scope.gate().position().unwrap().z;
            b.scope.move_to(&StagePose { z, ..here }).unwrap();
        },
        ..Story::default()
    };
    is_sharp_again("a tilted slide", &story.ends(5));
}

#[test]
fn other_light_stain_noise_dust_and_what_lies_on_the_slide_are_no_blur() {
    type Before = fn(&Bench);
    let all: [(&str, Before); 4] = [
        ("bleached", |b| {
            b.twin.inject(SpecimenEvent::Bleach { factor: 0.6 })
        }),
        ("another stain", |b| {
            b.twin.inject(SpecimenEvent::counterstain())
        }),
        ("a bubble", |b| {
            let (centre_um, radius_um) = ([PLACE_UM[0] + 60.0, PLACE_UM[1]], 40.0);
            b.twin.inject(SpecimenEvent::Bubble {
                centre_um,
                radius_um,
            });
        }),
        ("dust", |b| {
            b.twin.settle_dust(&[DustConfig::default()], 3).unwrap();
        }),
    ];
    for (seed, (name, before)) in (5..).zip(all) {
        let ended = Story {
            before,
            ..Story::default()
        }
        .ends(seed);
        is_back(name, &ended);
        let told = (ended.again(), ended.blurred_um());
        assert_eq!(told, (0, None), "{name}: {}", ended.outcome.message);
    }
}

/// A camera whose images are made darker, or noisier, on their way.
struct Changed(Box<dyn Camera>, fn(f64, &mut SplitMix64) -> f64);

impl Camera for Changed {
    fn info(&self) -> &CameraInfo {
        self.0.info()
    }
    fn exposure(&self) -> Result<Duration, ScopeError> {
        self.0.exposure()
    }
    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
        self.0.set_exposure(exposure)
    }
    fn grab(&self) -> Result<Frame, ScopeError> {
        let mut frame = self.0.grab()?;
        let mut rng = SplitMix64::new(frame.sequence);
        let mut changed = |v: f64| (self.1)(v, &mut rng).clamp(0.0, 1.0);
        if let Samples::U8(all) = &mut frame.samples {
            for v in all {
                *v = (255.0 * changed(f64::from(*v) / 255.0)).round() as u8;
            }
        }
        Ok(frame)
    }
}

/// The same instrument with another camera, or within other limits, and the run on it.
fn elsewhere(
    (bench, target): (Bench, Target),
    camera: Option<fn(f64, &mut SplitMix64) -> f64>,
    ranges: Vec<AxisRange>,
) -> Ended {
    let truth = bench.twin.truth_now();
    let devices = bench.twin.devices();
    let camera =
        camera.map(|change| -> Box<dyn Camera> { Box::new(Changed(bench.twin.camera(), change)) });
    let devices = Devices {
        camera: camera.or(devices.camera),
        ..devices
    };
    let rules = Rules {
        limits: Limits { ranges },
        ..bench.twin.rules()
    };
    let scope = Instrument::new(devices, rules, CancelToken::new()).unwrap();
    let z = Length::from_um(z_um(&scope));
    scope.focus_found(&calibration().objective, z);
    bench.twin.remount(PLACE_UM, [38.0, -45.0], 3.0, false);
    let outcome = comes_back(&scope, target, &bench.twin, |_, _| {});
    Ended {
        defocus_um: bench.twin.truth_now().defocus_um,
        off: bench.error_from(&truth),
        outcome,
    }
}

#[test]
fn a_camera_that_shows_it_otherwise_is_no_blur() {
    type Change = fn(f64, &mut SplitMix64) -> f64;
    let all: [(&str, Change); 4] = [
        ("gamma 1.8", |v, _| v.powf(1.8)),
        ("gamma 0.6", |v, _| v.powf(0.6)),
        ("noise of 1 %", |v, rng| v + 0.01 * rng.normal()),
        ("a third of the light", |v, _| v / 3.0),
    ];
    for (seed, (name, change)) in (5..).zip(all) {
        let ended = elsewhere(Story::default().begins(seed), Some(change), Vec::new());
        is_back(name, &ended);
        let told = (ended.again(), ended.blurred_um());
        assert_eq!(told, (0, None), "{name}: {}", ended.outcome.message);
    }
}

#[test]
fn a_height_that_the_stage_may_not_go_to_leaves_a_blur_that_is_told() {
    for (seed, um) in [(5, 2.0), (6, 3.0), (7, 1.5)] {
        let begun = Story::default().begins(seed);
        let z = 1e-6 * z_um(&begun.0.scope);
        // The stage may only go farther from the specimen, which sinks.
        rises(&begun.0, -um);
        let (min, max) = match begun.0.scope.gate().info().positive_z {
            PositiveZ::Closer => (z - 5e-3, z + 0.5e-6),
            PositiveZ::Apart => (z - 0.5e-6, z + 5e-3),
        };
        let axis = Axis::Z;
        let ended = elsewhere(begun, None, vec![AxisRange { axis, min, max }]);
        is_back("not so high", &ended);
        let (told, off) = (ended.blurred_um(), ended.defocus_um.abs());
        let told = told.unwrap_or_else(|| panic!("{um}: {off} {}", ended.outcome.message));
        assert!(
            off > HALF_DEPTH_UM && (told - off).abs() <= 0.25 * off,
            "{told}, {off}"
        );
        assert_eq!(ended.again(), 1);
        assert!(
            ended.outcome.message.contains("less sharp"),
            "{}",
            ended.outcome.message
        );
    }
}
