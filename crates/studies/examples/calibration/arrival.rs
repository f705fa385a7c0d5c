//! Single moves with a calibration: where they end, against what was expected.

use crate::instrument::Bench;
use scopeservo_geometry::{Mat2, SplitMix64, Vec2};
use scopeservo_scope::{Axis, StagePose};
use scopeservo_servo::{Calibration, Motion2, PlanarPose, pose_after};
use scopeservo_studies::rounds::Outcome;
use scopeservo_twin::Truth;

const MOVES: usize = 8;
/// A place is chosen within this share of the shorter side of the field from its middle, and turned by so much.
const REACH: f64 = 0.45;
const TURN_RAD: f64 = 0.0175;
/// So many times its play each axis goes below its goal first.
const RUN_UP: f64 = 1.5;

/// Some moves that bring a place of the view into its middle: how far beside it they end in stage axes, x and y, um, and the covariance that
/// was expected, xx, xy, yy, um^2.
pub(crate) fn arrivals(bench: &Bench, made: &Calibration, seed: u64) -> Outcome<Vec<[f64; 5]>> {
    let mut rng = SplitMix64::new(0xA88 + seed);
    let mut within = |half: f64| half * (2.0 * rng.uniform() - 1.0);
    let [w, h] = made.image_size_px.map(|v| v as f64);
    let middle = [(w - 1.0) / 2.0, (h - 1.0) / 2.0];
    let mut out = Vec::new();
    let here = bench.scope.gate().position()?;
    go(bench, made, &here)?;
    for _ in 0..MOVES {
        let radius = REACH * w.min(h);
        let p = [within(radius), within(radius)];
        let turn_rad = made.rotation_centre_m.map_or(0.0, |_| within(TURN_RAD));
        let seen = bench.twin.truth_now();
        let place_um = seen.specimen([middle[0] + p[0], middle[1] + p[1]]);
        let here = bench.scope.gate().position()?;
        let goal = goal(bench, made, (p, turn_rad), &here);
        if bench.scope.gate().allowed(&[goal])? != [true] {
            continue;
        }
        go(bench, made, &goal)?;
        let ended = bench.twin.truth_now();
        let Mat2([[xx, xy], [_, yy]]) = made
            .move_covariance_m2(p, turn_rad)
            .ok_or("no covariance")?;
        let pixel = pixel_of(&ended, place_um)?;
        let [x, y] = made.stage_from_pixel * [pixel[0] - middle[0], pixel[1] - middle[1]];
        out.push([1e6 * x, 1e6 * y, 1e12 * xx, 1e12 * xy, 1e12 * yy]);
    }
    Ok(out)
}

/// Where a place of the specimen is seen, px.
fn pixel_of(truth: &Truth, place_um: Vec2) -> Outcome<Vec2> {
    let [[a, b, x], [c, d, y]] = truth.specimen_from_pixel;
    let inverse = Mat2([[a, b], [c, d]])
        .inverse()
        .ok_or("a view without a size")?;
    Ok(inverse * [place_um[0] - x, place_um[1] - y])
}

/// Where to go so that what is `p` pixels from the middle comes into it, the view turned.
fn goal(
    bench: &Bench,
    made: &Calibration,
    (p, turn_rad): (Vec2, f64),
    here: &StagePose,
) -> StagePose {
    let eta = made.rotation_centre_m.unwrap_or_default();
    let from_eta = made.stage_from_pixel * p;
    let turned = Mat2::rotation(turn_rad) * eta;
    let motion = Motion2 {
        alpha_rad: turn_rad,
        d_m: [0, 1].map(|k| eta[k] + from_eta[k] - turned[k]),
    };
    let kinematics = bench.scope.gate().info().kinematics;
    pose_after(kinematics, &PlanarPose::from(here), &motion).request(here)
}

/// Goes there, with the play that is known taken up from below.
fn go(bench: &Bench, made: &Calibration, goal: &StagePose) -> Outcome<()> {
    let [x, y, rz] = made.backlash.map_or([0.0; 3], |b| [b.x_m, b.y_m, b.rz_rad]);
    let mut via = *goal;
    for (axis, play) in [(Axis::X, x), (Axis::Y, y), (Axis::Rz, rz)] {
        if let Some(at) = goal.si(axis) {
            via = via.with_si(axis, at - RUN_UP * play.max(0.0));
        }
    }
    if bench.scope.gate().allowed(&[via])? == [true] {
        bench.scope.move_to(&via)?;
    }
    bench.scope.move_to(goal)?;
    Ok(())
}
