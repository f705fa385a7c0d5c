//! From which side an axis arrives, so that its play is taken up at every view.

use super::model::axes;
use crate::kinematics::PlanarPose;

/// So many times the largest play an axis goes to take it up.
const RUN_UP: f64 = 1.5;
/// An axis that is asked for less stays where it is, m or rad: no stage that scatters by 0.1 um makes steps so small.
const STAYS: f64 = 1e-8;

/// A pose, but where an axis would hardly move, where it is.
pub(super) fn settled(from: &PlanarPose, to: &PlanarPose) -> PlanarPose {
    let stays = |from: f64, to: f64| if (to - from).abs() < STAYS { from } else { to };
    PlanarPose {
        x_m: [0, 1].map(|k| stays(from.x_m[k], to.x_m[k])),
        theta_rad: stays(from.theta_rad, to.theta_rad),
    }
}

/// How a pose is reached.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arrival {
    /// The pose to go through first.
    pub(super) via: Option<PlanarPose>,
    /// From which side each axis then comes.
    pub(super) approach: [i8; 3],
    /// Which axes move for it.
    pub(super) moved: [bool; 3],
}

/// How to get to a pose with all play taken up, from a pose that was reached so. An axis that turns back by less than its play may have
/// makes a run-up on the side where it came from, or where the stage may not go there on the other; with `same_side` so does each that turns
/// back. `None` where neither is allowed.
pub(super) fn arrive(
    from: Option<(&PlanarPose, [i8; 3])>,
    to: &PlanarPose,
    most_play: [f64; 3],
    same_side: bool,
    allowed: &dyn Fn(&PlanarPose) -> bool,
) -> Option<Arrival> {
    (0..8).find_map(|flipped: u8| {
        let (mut via, mut approach, mut moved) = (axes(to), [1; 3], [true; 3]);
        for k in 0..3 {
            let goal = axes(to)[k];
            let side = match from {
                None => None,
                Some((from, before)) => {
                    let way = goal - axes(from)[k];
                    let side = if way < 0.0 { -1 } else { 1 };
                    approach[k] = before[k];
                    moved[k] = way.abs() >= STAYS;
                    match way.abs() {
                        w if w < STAYS => Some(before[k]),
                        _ if side == before[k] => Some(side),
                        w if w >= most_play[k] && !same_side => Some(side),
                        _ => None,
                    }
                }
            };
            approach[k] = side.unwrap_or_else(|| {
                let run_up = if flipped >> k & 1 == 0 {
                    approach[k]
                } else {
                    -approach[k]
                };
                via[k] -= f64::from(run_up) * RUN_UP * most_play[k];
                run_up
            });
        }
        let via = PlanarPose {
            x_m: [via[0], via[1]],
            theta_rad: via[2],
        };
        allowed(&via).then_some(Arrival {
            via: (via != *to).then_some(via),
            approach,
            moved,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAY: [f64; 3] = [30e-6, 30e-6, 1e-4];

    fn pose(x: f64, y: f64) -> PlanarPose {
        PlanarPose {
            x_m: [x, y],
            theta_rad: 0.0,
        }
    }

    #[test]
    fn only_a_short_way_back_needs_a_run_up() {
        let here = pose(0.0, 0.0);
        let go = |to: &PlanarPose| {
            arrive(Some((&here, [1, -1, 1])), to, PLAY, false, &|_| true).unwrap()
        };
        assert_eq!(go(&pose(1e-6, -1e-6)).via, None);
        assert_eq!(go(&pose(-1e-4, 1e-4)).approach, [-1, 1, 1]);
        assert_eq!(go(&pose(-1e-4, 1e-4)).via, None);
        let to = pose(-1e-4, 0.0);
        let kept = arrive(Some((&here, [1, -1, 1])), &to, PLAY, true, &|_| true).unwrap();
        assert_eq!(
            (kept.via, kept.approach),
            (Some(pose(-1.45e-4, 0.0)), [1, -1, 1])
        );
        let short = go(&pose(-1e-5, 0.0));
        assert_eq!(
            (short.via, short.approach),
            (Some(pose(-5.5e-5, 0.0)), [1, -1, 1])
        );
    }

    #[test]
    fn the_first_view_is_reached_from_below_or_where_that_is_not_allowed_from_above() {
        let to = pose(0.0, 0.0);
        let below = arrive(None, &to, [30e-6, 30e-6, 0.0], false, &|_| true).unwrap();
        assert_eq!(below.via, Some(pose(-45e-6, -45e-6)));
        assert_eq!(below.approach, [1; 3]);
        let above = arrive(None, &to, PLAY, false, &|p| p.x_m[0] >= 0.0).unwrap();
        assert_eq!(above.approach, [-1, 1, 1]);
        assert_eq!(arrive(None, &to, PLAY, false, &|_| false), None);
    }
}
