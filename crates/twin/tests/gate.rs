//! The motion gate around the simulated microscope, with its faults: random commands, and no rule broken.

mod common;

use common::{Bench, grey};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use scopeservo_scope::{
    Axis, AxisRange, ChangeRule, Limits, Motion, MotionGate, ObjectiveId, Rules, StagePose,
};
use scopeservo_twin::{Config, StageFault};

const LIMIT_UM: f64 = 3000.0;
const RETRACTED_UM: f64 = -1500.0;
/// The default of the twin's repeatability, several times over.
const SCATTER_UM: f64 = 2.0;

fn command(rng: &mut impl Rng, gate: &MotionGate, bench: &Bench) {
    let um = |rng: &mut _| RngExt::random_range(rng, -1.3 * LIMIT_UM..1.3 * LIMIT_UM) * 1e-6;
    match rng.random_range(0..12) {
        0..4 => {
            let to =
                [Axis::X, Axis::Y, Axis::Z]
                    .into_iter()
                    .fold(StagePose::default(), |to, axis| {
                        match rng.random_range(0..3) {
                            0 => to,
                            _ => to.with_si(axis, um(rng)),
                        }
                    });
            drop(gate.start_move(&to));
        }
        4 => drop(gate.start_move(&StagePose::default().with_si(Axis::Z, RETRACTED_UM * 1e-6))),
        5..7 => {
            let id = ["10x", "20x", "40x", "63x"][rng.random_range(0..4)];
            drop(gate.start_change(&ObjectiveId(id.into())));
        }
        7 => gate.stop().unwrap(),
        8 => {
            let axis = [Axis::X, Axis::Y, Axis::Z][rng.random_range(0..3)];
            bench.twin.fault(match rng.random_range(0..3) {
                0 => StageFault::StuckAxis {
                    axis,
                    stuck: rng.random_range(0..2) == 0,
                },
                1 => StageFault::Backlash { axis, si: 1e-6 },
                _ => StageFault::Drift {
                    um_per_s: [0.001, -0.001, 0.0],
                },
            });
        }
        _ => bench.sleep(rng.random_range(0.0..0.6)),
    }
}

#[test]
fn a_hundred_thousand_sequences_on_the_twin_break_no_rule() {
    let range = |axis| AxisRange {
        axis,
        min: -LIMIT_UM * 1e-6,
        max: LIMIT_UM * 1e-6,
    };
    let rules = Rules {
        limits: Limits {
            ranges: [Axis::X, Axis::Y, Axis::Z].map(range).into(),
        },
        ..Rules::travel_only(ChangeRule::Retracted {
            z: RETRACTED_UM * 1e-6,
            margin: 0.0,
        })
    };
    let mut rng = Pcg64Mcg::seed_from_u64(11);
    let bench = Bench::new(Config::realistic(), grey(0.5));
    let nosepiece = bench.twin.nosepiece();
    let gate = MotionGate::new(bench.twin.stage(), bench.twin.nosepiece(), rules).unwrap();
    let (mut moves, mut turns) = (0u64, 0u64);
    let mut turning_before = false;
    for sequence in 0..100_000 {
        for _ in 0..6 {
            command(&mut rng, &gate, &bench);
            let at = bench.stage.position().unwrap();
            let um = |axis| at.si(axis).unwrap() * 1e6;
            for axis in [Axis::X, Axis::Y, Axis::Z] {
                assert!(
                    um(axis).abs() <= LIMIT_UM + SCATTER_UM,
                    "{sequence}: {axis} at {}",
                    um(axis)
                );
            }
            let moving = bench.stage.poll().unwrap() == Motion::Moving;
            let turning = nosepiece.poll().unwrap() == Motion::Moving;
            assert!(!(moving && turning), "{sequence}: it moves while it turns");
            assert!(
                !turning || um(Axis::Z) <= RETRACTED_UM + SCATTER_UM,
                "{sequence}: it turns at {}",
                um(Axis::Z)
            );
            moves += u64::from(moving);
            turns += u64::from(turning && !turning_before);
            turning_before = turning;
        }
    }
    // Something must have happened for this to mean anything.
    assert!(moves > 100_000 && turns > 5_000, "{moves} {turns}");
}
