//! Something is wrong with the microscope, from the beginning of a calibration or from the middle on: it is named, nothing wrong is kept as
//! good, and the stage is where the rule says.

mod common;

use common::{Bench, PLACE_UM, one_objective, options};
use scopeservo_scope::{
    Axis, CancelToken, Clock, ErrorKind, Frame, Instrument, Motion, ScopeError, Stage, StageInfo,
    StagePose, VirtualClock,
};
use scopeservo_servo::{
    Calibrate, Calibration, Event, FrameRole, ServoError, Sink, Stamped, VisionOptions, run,
};
use scopeservo_twin::specimen::{Blank, Tissue};
use scopeservo_twin::{DriftingHair, DustConfig, StageConfig, StageFault, Twin};
use std::sync::{Arc, Mutex};

/// Does something to the microscope after a view.
struct After<'a> {
    twin: &'a Twin,
    view: usize,
    what: &'a dyn Fn(&Twin),
}

impl Sink for After<'_> {
    fn event(&mut self, stamped: Stamped) {
        if let Event::CalibrationView { index, .. } = stamped.event
            && index == self.view
        {
            (self.what)(self.twin);
        }
    }
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

type Wires = fn(StagePose) -> StagePose;
type Happens = Box<dyn Fn(&Twin)>;

/// A stage whose axes are wired otherwise than it says, and which says what it was told.
struct Wired {
    real: Box<dyn Stage>,
    info: StageInfo,
    wires: Wires,
    told: Mutex<StagePose>,
}

impl Stage for Wired {
    fn info(&self) -> &StageInfo {
        &self.info
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        Ok(*self.told.lock().unwrap())
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let mut told = self.told.lock().unwrap();
        *told = to.or(&told);
        self.real.start_move(&(self.wires)(*told))
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        self.real.poll()
    }
    fn stop(&self) -> Result<(), ScopeError> {
        self.real.stop()
    }
}

fn bench(wires: Wires) -> Bench {
    let config = one_objective().with_stage(StageConfig::xyz_theta());
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new());
    let twin = Twin::new(config, Arc::new(Tissue::new(5)), 5, clock).unwrap();
    let mut devices = twin.devices();
    let real = twin.stage();
    devices.stage = Some(Box::new(Wired {
        info: real.info().clone(),
        told: Mutex::new(real.position().unwrap()),
        real,
        wires,
    }));
    let cancel = CancelToken::new();
    let scope = Instrument::new(devices, twin.rules(), cancel.clone()).unwrap();
    twin.centre_specimen(PLACE_UM, 0.0);
    Bench {
        twin,
        scope,
        cancel,
    }
}

fn calibrate(bench: &Bench, view: usize, what: &dyn Fn(&Twin)) -> Result<Calibration, ServoError> {
    let objective = bench.scope.gate().objectives()[0].clone();
    let vision = VisionOptions::default();
    let mut calibrate = Calibrate::new(objective, options().calibrate, vision);
    let twin = &bench.twin;
    run(
        &mut calibrate,
        &bench.scope,
        &mut After { twin, view, what },
    )
}

/// What a calibration ends with when something happens after a view; where the images show it the stage says that it is back.
fn refused(wires: Wires, view: usize, what: impl Fn(&Twin)) -> ServoError {
    let bench = bench(wires);
    let error = calibrate(&bench, view, &what).unwrap_err();
    assert_eq!(error.kind(), scopeservo_servo::ErrorKind::Answer, "{error}");
    let at = bench.scope.gate().position().unwrap();
    for axis in [Axis::X, Axis::Y, Axis::Rz] {
        assert!(at.si(axis).unwrap().abs() < 1e-6, "{error}: {at:?}");
    }
    error
}

fn as_it_says(pose: StagePose) -> StagePose {
    pose
}

fn sticks(axis: Axis) -> impl Fn(&Twin) {
    move |twin| twin.fault(StageFault::StuckAxis { axis, stuck: true })
}

fn loses(axis: Axis, si: f64) -> impl Fn(&Twin) {
    move |twin| twin.fault(StageFault::LostSteps { axis, si })
}

#[test]
fn an_axis_that_stands_is_named() {
    // Those of the plane from the first move on, the rotation later too.
    for (axis, view) in [(Axis::X, 0), (Axis::Y, 0), (Axis::Rz, 0), (Axis::Rz, 8)] {
        let error = refused(as_it_says, view, sticks(axis));
        assert!(
            matches!(error, ServoError::AxisStands { axis: a, .. } if a == axis),
            "{axis} {view}: {error}"
        );
    }
}

#[test]
fn what_stops_slips_or_loses_steps_on_the_way_is_not_kept_as_good() {
    let cases: [(&str, usize, Happens); 8] = [
        ("x stops at a corner", 2, Box::new(sticks(Axis::X))),
        ("x stops before it turns", 7, Box::new(sticks(Axis::X))),
        ("y stops before it turns", 7, Box::new(sticks(Axis::Y))),
        ("x stops while it turns", 14, Box::new(sticks(Axis::X))),
        ("x loses 5 um", 7, Box::new(loses(Axis::X, 5e-6))),
        ("x loses 30 um at once", 0, Box::new(loses(Axis::X, 30e-6))),
        (
            "the rotation loses 1 deg",
            9,
            Box::new(loses(Axis::Rz, 0.0175)),
        ),
        (
            "the slide creeps",
            0,
            Box::new(|twin| {
                twin.fault(StageFault::Drift {
                    um_per_s: [0.0, 1.0, 0.0],
                });
            }),
        ),
    ];
    for (name, view, what) in cases {
        let error = refused(as_it_says, view, what);
        assert!(
            matches!(error, ServoError::ViewAstray { .. }),
            "{name}: {error}"
        );
    }
}

#[test]
fn axes_that_are_wired_otherwise_are_told_by_what_they_do() {
    type Is = fn(&ServoError) -> bool;
    let contradict: Is = |e| matches!(e, ServoError::AxesContradict { .. });
    let cases: [(&str, Wires, Is); 5] = [
        (
            "x and y swapped",
            |p| {
                p.with_si(Axis::X, p.si(Axis::Y).unwrap())
                    .with_si(Axis::Y, p.si(Axis::X).unwrap())
            },
            contradict,
        ),
        (
            "x reversed",
            |p| p.with_si(Axis::X, -p.si(Axis::X).unwrap()),
            contradict,
        ),
        (
            "the rotation reversed",
            |p| p.with_si(Axis::Rz, -p.si(Axis::Rz).unwrap()),
            contradict,
        ),
        (
            "both move x",
            |p| {
                p.with_si(Axis::X, p.si(Axis::X).unwrap() + p.si(Axis::Y).unwrap())
                    .with_si(Axis::Y, 0.0)
            },
            |e| matches!(e, ServoError::AxesAlike { .. }),
        ),
        (
            "y goes three quarters of the way",
            |p| p.with_si(Axis::Y, 0.75 * p.si(Axis::Y).unwrap()),
            |e| matches!(e, ServoError::AxesDiffer { .. }),
        ),
    ];
    for (name, wires, is) in cases {
        let error = refused(wires, 0, |_| {});
        assert!(is(&error), "{name}: {error}");
    }
    // Both go a quarter too far: another objective, or another unit.
    let too_far: Wires = |p| {
        p.with_si(Axis::X, 1.3 * p.si(Axis::X).unwrap())
            .with_si(Axis::Y, 1.3 * p.si(Axis::Y).unwrap())
    };
    let error = refused(too_far, 0, |_| {});
    assert!(
        matches!(error, ServoError::CalibrationImplausible { .. }),
        "{error}"
    );
}

#[test]
fn light_that_goes_off_and_glass_are_told() {
    let error = refused(as_it_says, 7, |twin| drop(twin.light().set_level(0.0)));
    assert!(
        matches!(error, ServoError::WentDark { views: 8, .. }),
        "{error}"
    );
    let bench = bench(as_it_says);
    bench.twin.replace_specimen(Arc::new(Blank));
    bench.twin.clean_window();
    let error = calibrate(&bench, 0, &|_| {}).unwrap_err();
    assert!(matches!(error, ServoError::BlankView { .. }), "{error}");
}

#[test]
fn a_wall_and_a_pulled_plug_leave_the_stage_where_it_is() {
    let wall = |twin: &Twin| {
        twin.fault(StageFault::Wall {
            axis: Axis::X,
            between: Some([-100e-6, 100e-6]),
        });
    };
    let config = one_objective().with_stage(StageConfig::xyz_theta());
    let own = common::bench(config.clone());
    let ended = calibrate(&own, 3, &wall).unwrap_err();
    let ServoError::Scope(error) = &ended else {
        panic!("{ended}")
    };
    assert!(
        matches!(error, ScopeError::NotArrived { axis: Axis::X, .. }),
        "{error}"
    );
    assert!((own.twin.truth_now().stage.si(Axis::X).unwrap() - 100e-6).abs() < 1e-6);
    let own = common::bench(config);
    let ended = calibrate(&own, 4, &|twin| twin.fault(StageFault::Unplugged(true))).unwrap_err();
    let ServoError::Scope(error) = &ended else {
        panic!("{ended}")
    };
    assert_eq!(error.kind(), ErrorKind::Fault, "{error}");
    assert!(own.twin.truth_now().stage.si(Axis::X).unwrap().abs() > 1e-6);
}

fn sigmas_off(bench: &Bench, made: &Calibration) -> [f64; 2] {
    let truth = bench.twin.true_calibration(&made.objective).unwrap();
    let (eta, variance) = (made.rotation_centre_m.unwrap(), made.covariance.unwrap());
    std::array::from_fn(|k| (eta[k] - truth.eta_mm[k] * 1e-3) / variance[4 + k][4 + k].sqrt())
}

/// What disturbs the images is either too much, and told, or it only makes the answer less certain.
#[test]
fn shaking_and_hairs_that_drift_make_no_answer_wrong() {
    let shakes =
        |um: f64| -> Happens { Box::new(move |twin| twin.fault(StageFault::Vibration { um })) };
    let hair = |radius_px: f64, px_per_s: [f64; 2]| -> Happens {
        Box::new(move |twin| {
            twin.fault(StageFault::Hair(Some(DriftingHair {
                at_px: [200.0, 240.0],
                px_per_s,
                radius_px,
                stretch: 40.0,
                angle_deg: 70.0,
                attenuation: 0.9,
            })));
        })
    };
    let cases = [
        ("shakes by 0.3 um", 0, shakes(0.3), Some(0.3)),
        (
            "shakes by 1 um from the middle on",
            7,
            shakes(1.0),
            Some(1.0),
        ),
        ("shakes by 3 um", 0, shakes(3.0), Some(3.0)),
        ("shakes by 10 um", 0, shakes(10.0), Some(10.0)),
        ("a hair", 0, hair(3.0, [10.0, 3.0]), None),
        ("a thick hair", 0, hair(12.0, [4.0, 0.0]), None),
        ("a thick hair, slowly", 0, hair(12.0, [0.5, 0.2]), None),
        (
            "a fibre that fills a third",
            3,
            hair(60.0, [3.0, 1.0]),
            None,
        ),
    ];
    for (name, view, what, shakes_um) in cases {
        let bench = bench(as_it_says);
        match calibrate(&bench, view, &what) {
            Ok(made) => {
                let off = sigmas_off(&bench, &made);
                assert!(off.iter().all(|o| o.abs() < 4.5), "{name}: {off:?}");
            }
            Err(error) => {
                let answer = scopeservo_servo::ErrorKind::Answer;
                assert_eq!(error.kind(), answer, "{name}: {error}");
                // What shakes is named, by how much: two sines, of 23 and 31 Hz.
                if let Some(um) = shakes_um {
                    let ServoError::ViewShakes { um: told, .. } = error else {
                        panic!("{name}: {error}")
                    };
                    assert!((0.5..1.5).contains(&(told / um)), "{name}: {error}");
                }
            }
        }
    }
}

/// Frames that are lost, and dust that settles, are no reason to fail.
#[test]
fn accidents_that_do_no_harm_do_none() {
    let dust = DustConfig {
        specks: 40,
        ..DustConfig::default()
    };
    let cases: [(&str, Happens); 3] = [
        (
            "frames are lost",
            Box::new(|twin| twin.fault(StageFault::DropFrames(3))),
        ),
        (
            "a frame is torn",
            Box::new(|twin| twin.fault(StageFault::TornFrame)),
        ),
        (
            "dust settles",
            Box::new(move |twin| twin.settle_dust(std::slice::from_ref(&dust), 9).unwrap()),
        ),
    ];
    for (name, what) in cases {
        let bench = bench(as_it_says);
        let made = calibrate(&bench, 7, &what).unwrap_or_else(|e| panic!("{name}: {e}"));
        let off = sigmas_off(&bench, &made);
        assert!(off.iter().all(|o| o.abs() < 4.5), "{name}: {off:?} sigmas");
    }
}
