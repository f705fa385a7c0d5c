//! What may be broken, and what a run is to say of it.

use scopeservo_geometry::{Mat2, SplitMix64};
use scopeservo_scope::{Axis, ObjectiveId};
use scopeservo_servo::Calibration;
use scopeservo_twin::{StageFault, Twin};

/// When it breaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum When {
    /// Before the run begins.
    Start,
    /// After the first frame in which the target was seen.
    Middle,
    /// At every move.
    EachMove,
}

/// What a run is to come to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Ends {
    /// Stopped, or arrived and told; back at the start unless it arrived.
    ToldAndBack,
    /// The same, standing where it was seen.
    Told,
    /// It must arrive, and tell.
    ArrivesAndTells,
    /// It must arrive.
    Arrives,
}

/// One kind of trouble.
pub(crate) struct Kind {
    pub(crate) name: &'static str,
    pub(crate) when: When,
    pub(crate) ends: Ends,
    /// What a run may call it.
    pub(crate) right: &'static [&'static str],
    pub(crate) what: What,
}

/// What is done.
pub(crate) enum What {
    Twin(fn(&Twin, &mut SplitMix64)),
    /// The calibrations that the run is given.
    Calibration(fn(&ObjectiveId, Calibration) -> Calibration),
    /// The gate's limits end on the way.
    Limit,
}

fn goes(twin: &Twin, xy: [[f64; 2]; 2], rz: f64) {
    twin.fault(StageFault::Goes { xy, rz });
}

fn sticks(twin: &Twin, axis: Axis) {
    twin.fault(StageFault::StuckAxis { axis, stuck: true });
}

/// Somewhere else by this to twice this, um.
fn pushed(twin: &Twin, rng: &mut SplitMix64, um: f64) {
    let (far_m, way) = (
        um * 1e-6 * (1.0 + rng.uniform()),
        std::f64::consts::TAU * rng.uniform(),
    );
    for (axis, si) in [(Axis::X, far_m * way.cos()), (Axis::Y, far_m * way.sin())] {
        twin.fault(StageFault::LostSteps { axis, si });
    }
}

/// The objective that says it is in, by its number.
fn said(twin: &Twin) -> usize {
    let now = twin.truth_now().objective;
    let all = &twin.config().optics;
    all.iter().position(|o| o.id.0 == now).unwrap_or(0)
}

/// The paper's convergence range: for 10x, 20x and 40x.
fn range(objective: &ObjectiveId, of: [f64; 3]) -> f64 {
    match objective.0.as_str() {
        "10x" => of[0],
        "20x" => of[1],
        _ => of[2],
    }
}

fn mapped(calibration: Calibration, map: Mat2) -> Calibration {
    Calibration {
        stage_from_pixel: map * calibration.stage_from_pixel,
        ..calibration
    }
}

const STANDS_X: &[&str] = &["AxisStands(X)", "NothingMoved", "nothing_moves"];
const OBJECTIVE: &[&str] = &["Scaled", "wrong_objective"];

fn of_the_stage() -> Vec<Kind> {
    use Ends::{ArrivesAndTells, Told, ToldAndBack};
    use When::{EachMove, Middle, Start};
    let kind = |name, when, ends, right, what| Kind {
        name,
        when,
        ends,
        right,
        what: What::Twin(what),
    };
    vec![
        kind(
            "x the other way",
            Start,
            ToldAndBack,
            &["AxisReversed(X)"],
            |t, _| {
                goes(t, [[-1.0, 0.0], [0.0, 1.0]], 1.0);
            },
        ),
        kind(
            "y the other way",
            Start,
            ToldAndBack,
            &["AxisReversed(Y)"],
            |t, _| {
                goes(t, [[1.0, 0.0], [0.0, -1.0]], 1.0);
            },
        ),
        kind(
            "x and y exchanged",
            Start,
            ToldAndBack,
            &["Swapped"],
            |t, _| {
                goes(t, [[0.0, 1.0], [1.0, 0.0]], 1.0);
            },
        ),
        kind("x stands, from the start", Start, Told, STANDS_X, |t, _| {
            sticks(t, Axis::X)
        }),
        kind("x stands, in the middle", Middle, Told, STANDS_X, |t, _| {
            sticks(t, Axis::X)
        }),
        kind(
            "rotation stands",
            Start,
            Told,
            &["AxisStands(Rz)"],
            |t, _| {
                sticks(t, Axis::Rz);
            },
        ),
        kind(
            "x stands and says so",
            Middle,
            Told,
            &["x was sent to"],
            |t, _| {
                let x = t.truth_now().stage.si(Axis::X).unwrap_or(0.0);
                let between = Some([x - 1e-6, x + 1e-6]);
                t.fault(StageFault::Wall {
                    axis: Axis::X,
                    between,
                });
            },
        ),
        kind(
            "moves 10 % short",
            Start,
            ArrivesAndTells,
            &["drifted", "Share(0.9", "beside, -0."],
            |t, _| {
                goes(t, [[0.9, 0.0], [0.0, 0.9]], 0.9);
            },
        ),
        kind(
            "moved by hand",
            Middle,
            ToldAndBack,
            &["Elsewhere", "beside"],
            |t, rng| {
                pushed(t, rng, 40.0);
            },
        ),
        kind(
            "slide slips",
            EachMove,
            ToldAndBack,
            &["Elsewhere", "beside"],
            |t, rng| {
                pushed(t, rng, 15.0);
            },
        ),
    ]
}

fn of_the_camera() -> Vec<Kind> {
    use Ends::{Arrives, Told, ToldAndBack};
    use When::{Middle, Start};
    let kind = |name, when, ends, right, what| Kind {
        name,
        when,
        ends,
        right,
        what: What::Twin(what),
    };
    // Where a stage cannot turn so far it is all the same whether the slide is turned or the camera.
    let turned: &[&str] = &["Reversed", "Turned", "outside_limits", "cannot_reach"];
    vec![
        kind(
            "camera turned by 180 deg",
            Start,
            ToldAndBack,
            turned,
            |t, _| {
                t.fault(StageFault::CameraTurned(180.0));
            },
        ),
        kind(
            "camera turned by 15 to 60 deg",
            Start,
            ToldAndBack,
            turned,
            |t, rng| {
                let deg = 15.0 + 45.0 * rng.uniform();
                t.fault(StageFault::CameraTurned(deg));
            },
        ),
        kind("pixels binned", Start, ToldAndBack, OBJECTIVE, |t, _| {
            t.fault(StageFault::Binned(2));
        }),
        kind(
            "camera frozen, from the start",
            Start,
            ToldAndBack,
            &["frozen"],
            |t, _| {
                t.fault(StageFault::FrozenCamera(true));
            },
        ),
        kind(
            "camera frozen, in the middle",
            Middle,
            ToldAndBack,
            &["frozen"],
            |t, _| {
                t.fault(StageFault::FrozenCamera(true));
            },
        ),
        kind(
            "images 3 late, from the start",
            Start,
            ToldAndBack,
            &["Late", "stale_images"],
            |t, _| {
                t.fault(StageFault::StaleFrames(3));
            },
        ),
        kind(
            "images 3 late, in the middle",
            Middle,
            ToldAndBack,
            &["Late", "stale_images"],
            |t, _| {
                t.fault(StageFault::StaleFrames(3));
            },
        ),
        kind("three frames lost", Middle, Arrives, &[], |t, _| {
            t.fault(StageFault::DropFrames(3));
        }),
        kind("camera silent", Middle, Told, &["camera"], |t, _| {
            t.fault(StageFault::SilentCamera(true));
        }),
        kind(
            "another objective, from the start",
            Start,
            ToldAndBack,
            OBJECTIVE,
            |t, _| {
                t.fault(StageFault::InBeam(Some(1)));
            },
        ),
        kind(
            "another objective, in the middle",
            Middle,
            ToldAndBack,
            OBJECTIVE,
            |t, _| {
                t.fault(StageFault::InBeam(Some(1)));
            },
        ),
        kind(
            "nosepiece does not turn",
            Start,
            ToldAndBack,
            OBJECTIVE,
            |t, _| {
                t.fault(StageFault::InBeam(Some(said(t))));
            },
        ),
    ]
}

/// All of them.
pub(crate) fn all() -> Vec<Kind> {
    let kind = |name, ends, right, what| Kind {
        name,
        when: When::Start,
        ends,
        right,
        what,
    };
    let drifts =
        |name, right, how| kind(name, Ends::ArrivesAndTells, right, What::Calibration(how));
    let mut all = of_the_stage();
    all.extend(of_the_camera());
    all.extend([
        kind(
            "a limit on the way",
            Ends::Told,
            &["cannot_reach"],
            What::Limit,
        ),
        drifts("scales 6 % off", &["drifted"], |_, c| {
            mapped(c, Mat2::diagonal(1.06, 1.06))
        }),
        drifts(
            "lowest scale 6 % off",
            &["scales disagree", "drifted"],
            |id, c| {
                let by = range(id, [0.94, 1.0, 1.0]);
                mapped(c, Mat2::diagonal(by, by))
            },
        ),
        drifts("angles off by 8.9, 4.1, 1.9 deg", &["drifted"], |id, c| {
            let deg: f64 = range(id, [8.9, 4.1, 1.9]);
            mapped(c, Mat2::rotation(deg.to_radians()))
        }),
        drifts("centres off by 9.1, 4.4, 2.1 mm", &["drifted"], |id, c| {
            let off_m = 1e-3 * range(id, [9.1, 4.4, 2.1]);
            let centre = c.rotation_centre_m.map(|[x, y]| [x + off_m, y - off_m]);
            Calibration {
                rotation_centre_m: centre,
                ..c
            }
        }),
    ]);
    all
}
