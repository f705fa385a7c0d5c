use super::*;

fn exact() -> StageState {
    StageState::new(StageConfig::hexapod().exact(), 1, 0.0)
}

fn x(um: f64) -> StagePose {
    StagePose::default().with_si(Axis::X, um * 1e-6)
}

#[test]
fn ten_millimetres_take_a_second_and_settle_in_a_tenth() {
    let mut s = exact();
    s.start_move(&x(10_000.0), 0.0).unwrap();
    assert!((s.truth(0.51)[0] - 5e-3).abs() < 1e-5);
    assert_eq!(s.motion(1.11), Motion::Moving);
    assert_eq!(s.motion(1.121), Motion::Settled);
    assert!((s.reported(2.0).si(Axis::X).unwrap() - 10e-3).abs() < 1e-15);
}

#[test]
fn the_speed_profile_rises_without_a_jump_and_arrives() {
    for (whole, ramp) in [(1.0, 0.1), (0.04, 0.02), (1.0, 0.0)] {
        let mut last = 0.0;
        for i in 0..=1000 {
            let s = trapezoid(whole * f64::from(i) / 1000.0, whole, ramp);
            assert!(s >= last && s - last < 0.0031, "{whole} {ramp} {i}");
            last = s;
        }
        assert!((last - 1.0).abs() < 1e-12);
    }
}

#[test]
fn moves_that_go_by_another_map_go_by_it_and_say_what_they_were_told() {
    let to = |x: f64, y: f64, rz: f64| {
        let pose = StagePose::default().with_si(Axis::X, x).with_si(Axis::Y, y);
        pose.with_si(Axis::Rz, rz)
    };
    let mut s = exact();
    s.start_move(&to(1e-3, 2e-3, 0.01), 0.0).unwrap();
    // Exchanged, the other way round and nine tenths of it: from where it stands.
    s.go([[0.0, 1.0], [-0.9, 0.0]], 0.5);
    s.start_move(&to(2e-3, 5e-3, 0.03), 2.0).unwrap();
    let (middle, is, said) = (s.truth(2.2), s.truth(9.0), s.reported(9.0));
    assert!((is[0] - (1e-3 + 3e-3)).abs() < 1e-12 && (is[1] - (2e-3 - 0.9e-3)).abs() < 1e-12);
    assert!((is[5] - 0.02).abs() < 1e-12);
    assert!((said.si(Axis::Y).unwrap() - 5e-3).abs() < 1e-12);
    // On the way, not at once.
    assert!(middle[0] > 1.1e-3 && middle[0] < 3.9e-3, "{}", middle[0]);
    // Mended: from there on as told.
    s.go([[1.0, 0.0], [0.0, 1.0]], 1.0);
    s.start_move(&to(1e-3, 5e-3, 0.03), 10.0).unwrap();
    assert!((s.truth(20.0)[0] - 3e-3).abs() < 1e-12);
}

#[test]
fn arrivals_scatter_inside_the_data_sheet() {
    let mut config = StageConfig::hexapod();
    config.drift_um_per_s = [0.0; 3];
    config.vibration_um = 0.0;
    config.ambient_um = 0.0;
    let mut s = StageState::new(config, 5, 0.0);
    let mut errors = Vec::new();
    for i in 0..200 {
        let t = f64::from(i);
        s.start_move(&x(if i % 2 == 0 { 50.0 } else { 0.0 }), t)
            .unwrap();
        let (said, is) = (s.reported(t + 0.9), s.truth(t + 0.9));
        errors.push((is[0] - said.si(Axis::X).unwrap()) * 1e6);
        assert!(
            is[5].abs() <= 3e-6 && is[5] != 0.0,
            "a hexapod scatters in all axes"
        );
    }
    let (min, max) = errors
        .iter()
        .fold((0f64, 0f64), |(a, b), &e| (a.min(e), b.max(e)));
    assert!(
        min >= -0.15 && max <= 0.15 && min < -0.13 && max > 0.13,
        "{min} {max}"
    );
}

#[test]
fn with_play_the_side_of_approach_matters() {
    let mut s = exact();
    s.set_backlash(Axis::X, 2e-6);
    s.start_move(&x(100.0), 0.0).unwrap();
    let below = s.truth(1.0)[0];
    s.start_move(&x(200.0), 1.0).unwrap();
    s.start_move(&x(100.0), 2.0).unwrap();
    let above = s.truth(3.0)[0];
    assert!((above - below - 2e-6).abs() < 1e-12);
    assert!((s.reported(3.0).si(Axis::X).unwrap() - 100e-6).abs() < 1e-15);
}

#[test]
fn lost_steps_and_stuck_axes_are_not_reported() {
    let mut s = exact();
    s.lose_steps(Axis::Y, 5e-6);
    assert!((s.truth(0.0)[1] - 5e-6).abs() < 1e-15);
    assert_eq!(s.reported(0.0).si(Axis::Y), Some(0.0));
    s.stick(Axis::X, true, 0.0);
    s.start_move(&x(40.0), 0.0).unwrap();
    assert_eq!(s.truth(1.0)[0], 0.0);
    assert!((s.reported(1.0).si(Axis::X).unwrap() - 40e-6).abs() < 1e-15);
    s.stick(Axis::X, false, 1.0);
    assert!((s.truth(1.0)[0] - 40e-6).abs() < 1e-15);
}

#[test]
fn drift_goes_on_from_where_it_was() {
    let mut s = exact();
    s.set_drift([1.0, 0.0, 0.0], 0.0);
    s.set_drift([0.0, 2.0, 0.0], 10.0);
    let at = s.truth(20.0);
    assert!((at[0] - 10e-6).abs() < 1e-15 && (at[1] - 20e-6).abs() < 1e-15);
}

#[test]
fn shaking_decays_while_settling() {
    let mut config = StageConfig::hexapod().exact();
    config.vibration_um = 1.0;
    let mut s = StageState::new(config, 2, 0.0);
    s.start_move(&x(1000.0), 0.0).unwrap();
    let most = |from: f64| {
        (0..200)
            .map(|i| (s.truth(from + f64::from(i) * 1e-4)[1]).abs())
            .fold(0f64, f64::max)
    };
    let (moving, settled) = (most(0.05), most(0.22));
    assert!(
        moving > 0.5e-6 && settled < 0.02e-6 && settled > 0.0,
        "{moving} {settled}"
    );
}

#[test]
fn stop_holds_the_present_place() {
    let mut s = exact();
    s.start_move(&x(10_000.0), 0.0).unwrap();
    assert!(matches!(
        s.start_move(&x(0.0), 0.3),
        Err(ScopeError::Busy { .. })
    ));
    s.stop(0.5);
    assert_eq!(s.motion(0.5), Motion::Stopped);
    let here = s.truth(0.5)[0];
    assert!(here > 4e-3 && here < 6e-3);
    assert_eq!(s.truth(5.0)[0], here);
    assert!(
        (s.truth(0.25)[0] - 2.4e-3).abs() < 1e-5,
        "history before the stop"
    );
}

#[test]
fn what_cannot_be_is_refused() {
    let mut s = StageState::new(StageConfig::xy().exact(), 1, 0.0);
    let z = StagePose::default().with_si(Axis::Z, 0.0);
    assert_eq!(
        s.start_move(&z, 0.0),
        Err(ScopeError::NoSuchAxis { axis: Axis::Z })
    );
    assert!(matches!(
        s.start_move(&x(1e6), 0.0),
        Err(ScopeError::OutsideLimits { .. })
    ));
    assert!(matches!(
        s.start_move(&x(f64::NAN), 0.0),
        Err(ScopeError::NotFinite { .. })
    ));
}

#[test]
fn rotation_alone_is_scattered_only_with_its_own_axis_on_stacked_stages() {
    let mut config = StageConfig::xyz_theta();
    config.ambient_um = 0.0;
    config.vibration_um = 0.0;
    config.drift_um_per_s = [0.0; 3];
    let mut s = StageState::new(config, 9, 0.0);
    let before = s.truth(0.0);
    s.start_move(&StagePose::default().with_si(Axis::Rz, 0.1), 0.0)
        .unwrap();
    let after = s.truth(9.0);
    assert_eq!(before[0], after[0]);
    assert!((after[5] - 0.1).abs() < 50e-6 && after[5] != 0.1);
}
