//! Where a pattern slide is looked at: so that from one view to the next no period can be mistaken.

use serde::{Deserialize, Serialize};

/// The first move goes so many periods: less than half of one, however the camera is turned and whatever the scale.
const FIRST: f64 = 0.35;
/// The next one goes so many times as far as the last, at most,
const MOST: f64 = 8.0;
/// and at least. A stage that scatters too much for that, by a 28th of a period, is none for this grid: its first moves could be taken for
/// longer ones.
const LEAST: f64 = 2.8;
/// No view lies farther than this from the axis of rotation, m; and no two are turned by more against each other, rad.
const LEVER_M: f64 = 0.3;
const WIDEST_RAD: f64 = 0.02;

/// A move from where the stage began.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Move {
    /// None: the first view.
    Home,
    /// Along x (0) or y (1), m.
    Along { axis: usize, by_m: f64 },
    /// About z, rad.
    Turn { by_rad: f64 },
}

/// How much farther than the last move the next one may go, when arrivals scatter by `sigma_m`: where it ends is then known to within half a
/// period by three standard deviations, sqrt 2 times the scatter for each of the two. `None` where that is not enough.
fn growth(pitch_m: f64, sigma_m: f64) -> Option<f64> {
    let growth = pitch_m / (10.0 * sigma_m.max(1e-12));
    (growth >= LEAST).then(|| growth.min(MOST))
}

/// Along both axes, both ways, farther and farther up to `reach_m`. `None` for a stage that scatters too much.
pub(super) fn translations(pitch_m: f64, sigma_m: f64, reach_m: f64) -> Option<Vec<Move>> {
    let growth = growth(pitch_m, sigma_m)?;
    let along = |axis, by_m| Move::Along { axis, by_m };
    let mut length_m = FIRST * pitch_m;
    let mut moves = vec![Move::Home, along(0, length_m), along(1, length_m)];
    while length_m < reach_m {
        length_m = (growth * length_m).min(reach_m);
        let ways = [(0, 1.0), (1, 1.0), (0, -1.0), (1, -1.0)];
        moves.extend(ways.map(|(axis, sign)| along(axis, sign * length_m)));
    }
    Some(moves)
}

/// The first rotation: wherever the axis is, the view moves by less than half a period.
pub(super) fn first_turn(pitch_m: f64) -> Move {
    Move::Turn {
        by_rad: FIRST * pitch_m / LEVER_M,
    }
}

/// The rotations after one by `last_rad`, which showed the axis `lever_m` away; arrivals scatter by `sigma_m` and `sigma_rad`. None after the
/// widest, which sweeps the view by `reach_m`.
pub(super) fn next_turns(
    pitch_m: f64,
    (sigma_m, sigma_rad): (f64, f64),
    (last_rad, lever_m): (f64, f64),
    reach_m: f64,
) -> Vec<Move> {
    let widest = WIDEST_RAD.min(reach_m / lever_m.max(1e-9));
    let swept = sigma_m.hypot(sigma_rad * lever_m.min(LEVER_M));
    let Some(growth) = growth(pitch_m, swept) else {
        return Vec::new();
    };
    if last_rad < 0.0 || last_rad >= widest {
        return Vec::new();
    }
    let next = (growth * last_rad).min(widest);
    let turn = |by_rad| Move::Turn { by_rad };
    match next < widest {
        true => vec![turn(next)],
        false => vec![turn(next), turn(-next)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moves_grow_from_less_than_half_a_period_to_the_reach_both_ways() {
        let moves = translations(20e-6, 0.1e-6, 1e-3).unwrap();
        assert_eq!(
            moves[..2],
            [
                Move::Home,
                Move::Along {
                    axis: 0,
                    by_m: 7e-6
                }
            ]
        );
        for axis in [0, 1] {
            let of = |m: &Move| match m {
                Move::Along { axis: a, by_m } if *a == axis => Some(*by_m),
                _ => None,
            };
            let lengths: Vec<f64> = moves.iter().filter_map(of).collect();
            assert!(lengths.contains(&1e-3) && lengths.contains(&-1e-3));
            let up: Vec<f64> = lengths.into_iter().filter(|l| *l > 0.0).collect();
            assert!(up.windows(2).all(|w| w[1] <= MOST * w[0] * 1.000_001));
        }
        assert_eq!(translations(20e-6, 1e-6, 1e-3), None);
    }

    #[test]
    fn turns_widen_until_the_view_sweeps_the_reach() {
        let Move::Turn { mut by_rad } = first_turn(20e-6) else {
            panic!()
        };
        assert!(by_rad * LEVER_M < 10e-6);
        for _ in 0..20 {
            let next = next_turns(20e-6, (0.1e-6, 2e-6), (by_rad, 0.125), 1e-3);
            match next[..] {
                [Move::Turn { by_rad: wider }] => by_rad = wider,
                [Move::Turn { by_rad: a }, Move::Turn { by_rad: b }] => {
                    assert!((a - 8e-3).abs() < 1e-9 && b == -a);
                    return;
                }
                _ => panic!("{next:?}"),
            }
        }
        panic!("never the widest");
    }
}
