//! A control law of a few lines, in a file of its own, runs the servo.

mod common;

use common::{Listener, PLACE_UM, bench, one_objective};
use scopeservo_servo::{
    Calibrate, CalibrateOptions, Calibration, ControlLaw, Event, Law, PoseEstimate, Proportional,
    Servo, ServoEnd, ServoOptions, ServoTask, Velocity, VisionOptions, run,
};

/// Halves the error, and takes all of it away when it is near.
struct NearThenAll;

impl ControlLaw for NearThenAll {
    fn velocity(&self, estimate: &PoseEstimate, view: &Calibration) -> Velocity {
        let near = estimate.error.distance_um() < 10.0;
        let lambda = if near { 1.0 } else { 0.5 };
        Proportional { lambda }.velocity(estimate, view)
    }
}

#[test]
fn a_control_law_is_one_file() {
    let bench = bench(one_objective());
    let (vision, options) = (VisionOptions::default(), ServoOptions::default());
    let (target, truth) = bench.save();
    let objective = bench.scope.gate().objectives()[0].clone();
    let mut calibrate = Calibrate::new(objective, CalibrateOptions::default(), vision.clone());
    let mut shares = Vec::new();
    let mut sink = Listener(|event: &Event| {
        if let Event::Iteration {
            error, velocity, ..
        } = event
        {
            shares.push(velocity.distance_um() / error.distance_um());
        }
    });
    let calibration = run(&mut calibrate, &bench.scope, &mut sink).unwrap();
    bench.twin.remount(PLACE_UM, [38.0, -24.0], 1.0, false);
    let task = ServoTask {
        target: &target,
        view_calibration: &calibration,
        target_calibration: &calibration,
        vision: &vision,
        options: &options,
        law: Some(&NearThenAll),
        hand_overs: &[],
        localizer: None,
    };
    // A loop with its task is a procedure like any other.
    let end = run(&mut Servo::default().on(&task), &bench.scope, &mut sink).unwrap();
    assert!(matches!(end, ServoEnd::Converged(_)), "{end:?}");
    let (um, deg) = bench.error_from(&truth);
    assert!(um <= 1.0 && deg <= 0.02, "{um} um, {deg} deg");
    for share in [0.5, 1.0] {
        assert!(
            shares.iter().any(|s| (s - share).abs() < 1e-9),
            "{shares:?}"
        );
    }
    assert!(shares.len() < 15, "{} frames", shares.len());
}

#[test]
fn options_name_their_law_and_older_ones_have_the_papers() {
    let read = |text: &str| serde_json::from_str::<ServoOptions>(text).unwrap();
    let (older, named) = (
        read(r#"{"lambda": 0.3}"#),
        read(r#"{"lambda": 0.3, "law": "proportional"}"#),
    );
    assert_eq!(older, named);
    assert_eq!(older.law, Law::Proportional);
    assert_eq!(ServoOptions::default().law, Law::Direct);
    let kept = serde_json::to_string(&ServoOptions::default()).unwrap();
    assert_eq!(read(&kept), ServoOptions::default());
}
