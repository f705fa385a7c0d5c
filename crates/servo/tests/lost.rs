//! Frames in which the target is lost widen what is expected of the next one.

mod common;

use common::{Listener, PLACE_UM, bench, one_objective};
use scopeservo_features::GrayImage;
use scopeservo_registration::{NotFound, flipped};
use scopeservo_servo::{
    Calibrate, CalibrateOptions, Event, NoSink, Picture, Servo, ServoEnd, ServoOptions, ServoTask,
    VisionOptions, run,
};

/// Lays the slide anew between two frames, turned from `from_deg` to `to_deg`; tells how many frames were lost, and how
/// the loop ended.
fn turned_between_two_frames(from_deg: f64, to_deg: f64) -> (usize, ServoEnd, (f64, f64)) {
    let mut config = one_objective();
    // The view near the axis of the stage: turning it takes little travel.
    config.mount.eta_mm = [10.0, 1.0];
    let bench = bench(config);
    let (vision, options) = (VisionOptions::default(), ServoOptions::default());
    let (target, truth) = bench.save();
    let objective = bench.scope.gate().objectives()[0].clone();
    let mut calibrate = Calibrate::new(objective, CalibrateOptions::default(), vision.clone());
    let calibration = run(&mut calibrate, &bench.scope, &mut NoSink).unwrap();
    let beside = [PLACE_UM[0] + 20.0, PLACE_UM[1] - 10.0];
    bench.twin.centre_specimen(beside, from_deg);
    let (mut lost, mut turned) = (0, false);
    let mut sink = Listener(|event: &Event| match event {
        Event::Iteration { .. } if !turned => {
            turned = true;
            bench.twin.centre_specimen(beside, to_deg);
        }
        Event::Lost { .. } => lost += 1,
        _ => {}
    });
    let task = ServoTask {
        target: &target,
        view_calibration: &calibration,
        target_calibration: &calibration,
        vision: &vision,
        options: &options,
        law: None,
        hand_overs: &[],
        localizer: None,
    };
    let end = run(&mut Servo::default().on(&task), &bench.scope, &mut sink).unwrap();
    (lost, end, bench.error_from(&truth))
}

#[test]
fn a_target_that_is_there_as_a_mirror_image_only_is_told_so() {
    let bench = bench(one_objective());
    let (vision, options) = (VisionOptions::default(), ServoOptions::default());
    let (mut target, _) = bench.save();
    let frame = bench.scope.grab().unwrap();
    let image = GrayImage::new(frame.width, frame.height, frame.luminance()).unwrap();
    let image = flipped(&image).unwrap();
    let objective = bench.scope.gate().objectives()[0].clone();
    let mut calibrate = Calibrate::new(objective, CalibrateOptions::default(), vision.clone());
    let calibration = run(&mut calibrate, &bench.scope, &mut NoSink).unwrap();
    target.features = vision
        .engine
        .features(&image, vision.target_features)
        .unwrap();
    target.picture = Some(Picture::of(&image));
    for [x, y] in [[0.0, 0.0], [20.0, -10.0], [-15.0, 12.0]] {
        bench
            .twin
            .centre_specimen([PLACE_UM[0] + x, PLACE_UM[1] + y], 0.0);
        let task = ServoTask {
            target: &target,
            view_calibration: &calibration,
            target_calibration: &calibration,
            vision: &vision,
            options: &options,
            law: None,
            hand_overs: &[],
            localizer: None,
        };
        let end = run(&mut Servo::default().on(&task), &bench.scope, &mut NoSink).unwrap();
        let mirrored =
            matches!(end, ServoEnd::Lost(NotFound::Mirrored { inliers }) if inliers > 20);
        assert!(mirrored, "{end:?}");
    }
}

#[test]
fn a_slide_turned_between_two_frames_is_found_again_by_the_same_loop() {
    for (from_deg, to_deg, frames) in [(-10.0, 10.0, 1), (-15.0, 15.0, 2)] {
        let (lost, end, (um, deg)) = turned_between_two_frames(from_deg, to_deg);
        assert_eq!(lost, frames, "{to_deg}: {end:?}");
        assert!(matches!(end, ServoEnd::Converged(_)), "{to_deg}: {end:?}");
        assert!(um <= 1.0 && deg <= 0.05, "{um} um, {deg} deg");
    }
}
