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

/// What the gate was asked to begin, and did.
enum Begun {
    Move(StagePose),
    Turn,
}

const AXES: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];

fn fault(rng: &mut impl Rng) -> StageFault {
    let axis = AXES[rng.random_range(0..3)];
    match rng.random_range(0..8) {
        0 => StageFault::StuckAxis {
            axis,
            stuck: rng.random_range(0..2) == 0,
        },
        1 => StageFault::Backlash { axis, si: 1e-6 },
        2 => StageFault::Drift {
            um_per_s: [0.001, -0.001, 0.0],
        },
        3 => StageFault::Wall {
            axis,
            between: (rng.random_range(0..2) == 0).then_some([-1e-3, 1e-3]),
        },
        4 | 5 => StageFault::TakesAlong {
            axis,
            along: AXES[rng.random_range(0..3)],
            si: rng.random_range(-1..2) as f64 * 4e-4,
        },
        6 => StageFault::Misreports {
            axis,
            si: [0.0, 0.0, 2e-4, -5e-4, 1.0][rng.random_range(0..5)],
        },
        _ => StageFault::IgnoresStop(rng.random_range(0..4) == 0),
    }
}

fn command(rng: &mut impl Rng, gate: &MotionGate, bench: &Bench) -> Option<Begun> {
    let um = |rng: &mut _| RngExt::random_range(rng, -1.3 * LIMIT_UM..1.3 * LIMIT_UM) * 1e-6;
    let go = |to: StagePose| gate.start_move(&to).is_ok().then_some(Begun::Move(to));
    match rng.random_range(0..13) {
        0..4 => {
            let to = AXES.into_iter().fold(StagePose::default(), |to, axis| {
                match rng.random_range(0..3) {
                    0 => to,
                    _ => to.with_si(axis, um(rng)),
                }
            });
            return go(to);
        }
        4 => {
            let beyond_um = RETRACTED_UM - SCATTER_UM;
            return go(StagePose::default().with_si(Axis::Z, beyond_um * 1e-6));
        }
        5..7 => {
            let id = ["10x", "20x", "40x", "63x"][rng.random_range(0..4)];
            let turned = gate.start_change(&ObjectiveId(id.into()));
            return turned.is_ok().then_some(Begun::Turn);
        }
        7 => gate.stop().unwrap(),
        8 => bench.twin.fault(fault(rng)),
        9 => {
            // Where the gate says that the stage arrived, it says so itself.
            if bench.stage.poll() == Ok(Motion::Settled)
                && let Ok(at) = gate.arrived()
            {
                assert_eq!(Ok(at), bench.stage.position());
            }
        }
        _ => bench.sleep(rng.random_range(0.0..0.6)),
    }
    None
}

/// Where it says it is, um.
fn said_um(bench: &Bench) -> [f64; 3] {
    let at = bench.stage.position().unwrap();
    AXES.map(|axis| at.si(axis).unwrap() * 1e6)
}

/// Whether a move that began at a place, as the stage says, was one that may begin there.
fn may_begin(from_um: [f64; 3], to: &StagePose) -> bool {
    let goal_um: [f64; 3] =
        std::array::from_fn(|k| to.si(AXES[k]).map_or(from_um[k], |si| si * 1e6));
    let moved: Vec<usize> = (0..3)
        .filter(|&k| to.si(AXES[k]).is_some_and(|si| si * 1e6 != from_um[k]))
        .collect();
    let out = |um: f64, slack: f64| um.abs() > LIMIT_UM + slack;
    let outside: Vec<usize> = (0..3).filter(|&k| out(from_um[k], SCATTER_UM)).collect();
    let nearer = |k: &usize| goal_um[*k].abs() < from_um[*k].abs();
    let goals_inside = moved
        .iter()
        .all(|&k| !out(goal_um[k], 1e-6) || nearer(&k) && out(from_um[k], 0.0));
    let retreat = moved == [2] && goal_um[2] < from_um[2];
    let too_near = from_um[2] > LIMIT_UM + SCATTER_UM;
    let back = outside.iter().all(|k| moved.contains(k) && nearer(k))
        || moved.iter().all(|k| outside.contains(k) && nearer(k));
    goals_inside && (outside.is_empty() || retreat || (!too_near && back))
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
            ranges: AXES.map(range).into(),
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
    let (mut moves, mut turns, mut outside) = (0u64, 0u64, 0u64);
    for sequence in 0..100_000 {
        for _ in 0..6 {
            let from_um = said_um(&bench);
            let begun = command(&mut rng, &gate, &bench);
            match begun {
                Some(Begun::Move(to)) => {
                    moves += 1;
                    outside += u64::from(from_um.iter().any(|um| um.abs() > LIMIT_UM + SCATTER_UM));
                    assert!(
                        may_begin(from_um, &to),
                        "{sequence}: {to} from {from_um:?} um"
                    );
                }
                Some(Begun::Turn) => {
                    turns += 1;
                    assert!(
                        from_um[2] <= RETRACTED_UM + 1.0 + 1e-6,
                        "{sequence}: it turns at {from_um:?} um"
                    );
                    let inside = from_um.iter().all(|um| um.abs() <= LIMIT_UM + SCATTER_UM);
                    assert!(inside, "{sequence}: it turns at {from_um:?} um");
                }
                None => {}
            }
            let moving = bench.stage.poll().unwrap() == Motion::Moving;
            let turning = nosepiece.poll().unwrap() == Motion::Moving;
            assert!(!(moving && turning), "{sequence}: it moves while it turns");
        }
    }
    // Something must have happened for this to mean anything.
    assert!(
        moves > 20_000 && turns > 2_000 && outside > 500,
        "{moves} {turns} {outside}"
    );
}
