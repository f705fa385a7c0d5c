//! A first guess of the maps, in closed form and whatever some pairs say.

use super::equations::Problem;
use super::model::{Instrument, Optics, Unknowns};
use super::sight::sight;
use scopeservo_geometry::{Mat2, Vec2};

/// A pair whose views are turned from each other by less shows the map without the rotation centre, rad.
const UNTURNED_RAD: f64 = 1e-7;
/// Moves shorter than this share of the longest count for nothing.
const LEAST_MOVE: f64 = 0.25;
/// Two moves whose parallelogram has a smaller share of its rectangle lie on a line.
const LEAST_SINE: f64 = 0.2;

/// Moves of one optics and the shifts they show: m in stage axes at the pose, px.
fn moves(problem: &Problem, optics: usize) -> Vec<(Vec2, Vec2)> {
    let of = |v: usize| {
        sight(
            problem.priors.kinematics,
            &problem.views[v].reported,
            [0.0; 2],
        )
    };
    let mut moves = Vec::new();
    for pair in problem.pairs {
        let both = [pair.fixed, pair.found];
        let [a, b] = both.map(of);
        let unturned = (b.phi_rad - a.phi_rad).abs() < UNTURNED_RAD;
        if unturned && both.iter().all(|v| problem.views[*v].optics == optics) {
            let moved_m = [b.s_m[0] - a.s_m[0], b.s_m[1] - a.s_m[1]];
            moves.push((Mat2::rotation(-a.phi_rad) * moved_m, pair.centre_px));
        }
    }
    // What hardly moves shows the backlash and the scatter.
    let length = |(moved_m, _): &(Vec2, Vec2)| f64::hypot(moved_m[0], moved_m[1]);
    let longest = moves.iter().map(length).fold(0.0, f64::max);
    moves.retain(|moved| length(moved) >= LEAST_MOVE * longest);
    moves
}

/// The map that the moves agree on: of all that two of them determine, the one with the least median residual.
fn stage_from_pixel(moves: &[(Vec2, Vec2)]) -> Option<Mat2> {
    let columns = |a: Vec2, b: Vec2| Mat2([[a[0], b[0]], [a[1], b[1]]]);
    let length = |v: Vec2| f64::hypot(v[0], v[1]);
    let mut best: Option<(f64, Mat2)> = None;
    for (k, (moved_m, moved_px)) in moves.iter().enumerate() {
        for (other_m, other_px) in &moves[..k] {
            let (stage, pixel) = (columns(*moved_m, *other_m), columns(*moved_px, *other_px));
            if stage.det().abs() <= LEAST_SINE * length(*moved_m) * length(*other_m) {
                continue;
            }
            let Some(map) = pixel.inverse().map(|inverse| stage * inverse) else {
                continue;
            };
            let mut off: Vec<f64> = moves
                .iter()
                .map(|(m, px)| {
                    let seen = map * *px;
                    length([seen[0] - m[0], seen[1] - m[1]])
                })
                .collect();
            let middle = off.len() / 2;
            let (_, median, _) = off.select_nth_unstable_by(middle, f64::total_cmp);
            if best.is_none_or(|(least, _)| *median < least) {
                best = Some((*median, map));
            }
        }
    }
    best.map(|(_, map)| map)
}

/// The views where they were reported, no backlash, and the maps of the moves without rotation. `None` where these lie on a line.
pub(super) fn start(problem: &Problem) -> Option<Unknowns> {
    let count = 1 + problem.views.iter().map(|v| v.optics).max()?;
    let optics = (0..count).map(|o| {
        Some(Optics {
            stage_from_pixel: stage_from_pixel(&moves(problem, o))?,
            centre_m: [0.0; 2],
        })
    });
    Some(Unknowns {
        poses: problem.views.iter().map(|v| v.reported).collect(),
        drift: [0.0; 2],
        instrument: Instrument {
            backlash: [0.0; 3],
            optics: optics.collect::<Option<_>>()?,
        },
    })
}
