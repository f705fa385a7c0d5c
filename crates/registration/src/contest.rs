//! Which of two transforms is right, asked of the pixels: places that only one of them explains decide, a defect, a die's number, an odd cell
//! in a grid.

use crate::likeness::{Comparison, Pair};
use crate::rival::shifted;
use crate::turns::turned;
use crate::{Estimate, Rival};
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, Vec2};

/// A transform that explains this share of what the other explains repeats it.
const REPEATS: f64 = 0.5;
/// More patches must speak for a transform than against it, by this many standard deviations of what noise alone does to their number.
const DECIDED_SIGMAS: f64 = 3.5;
/// A shift divides a longer one up to so often.
const MOST_PERIODS: u32 = 16;
/// Under a period of its own a specimen looks alike in at least this share of the structured patches.
const WHOLE_PERIOD: f64 = 0.8;
/// A period shorter than this, pixels, is below what patches can tell.
const SHORTEST_PX: f64 = 3.0;

/// A rival that nothing tells from the transform that was found, if there is one: the nearest, which of a lattice is its period. Asked are
/// `rivals`, those by the target's periods, and when none of them is open those by its turns. Patches count whose place in the view `counts`.
/// `trusted`: what decides for the transform is not itself fixed to the camera.
pub fn undecided(
    pictures: &Pair,
    first: &Estimate,
    (target, periods_px): (&GrayImage, &[Vec2]),
    rivals: &[Rival],
    trusted: bool,
    counts: impl Fn(Vec2) -> bool,
) -> Option<Rival> {
    let transform = &first.target_from_view;
    let open = |rivals: &[Rival], unsure_px: f64| {
        open(pictures, transform, (rivals, unsure_px), trusted, &counts)
    };
    let shifted = shifted(first, periods_px);
    open(&[&shifted, rivals].concat(), 0.0).or_else(|| {
        let (turned, unsure_px) = turned(first, target, periods_px);
        open(&turned, unsure_px)
    })
}

/// The nearest of some rivals, whose places are known to so many pixels of the target, that nothing tells from the first transform.
fn open(
    pictures: &Pair,
    first: &Affine2,
    (rivals, unsure_px): (&[Rival], f64),
    trusted: bool,
    counts: impl Fn(Vec2) -> bool,
) -> Option<Rival> {
    let is_open = |rival: &&Rival| {
        let second = pictures.refined(&rival.target_from_view, unsure_px);
        let seen = pictures
            .compare(first, &second, &counts)
            .unwrap_or_default();
        let repeats = seen.first > 0 && seen.both as f64 >= REPEATS * seen.first as f64;
        if !repeats && !rival.significant {
            return false;
        }
        !(decides(&seen) && (trusted || !repeats))
    };
    let length = |r: &Rival| f64::hypot(r.shift_px[0], r.shift_px[1]);
    let open = rivals.iter().filter(is_open);
    let nearest = open.min_by(|a, b| length(a).total_cmp(&length(b)))?;
    Some(shortest(pictures, first, nearest))
}

/// Whether the patches that only one explains decide for the first.
fn decides(seen: &Comparison) -> bool {
    let [yes, no] = [seen.first_only, seen.second_only].map(|n| n as f64);
    yes - no > DECIDED_SIGMAS * (yes + no).sqrt()
}

/// The shortest shift that divides a rival's and under which the images look alike as well.
fn shortest(pictures: &Pair, first: &Affine2, rival: &Rival) -> Rival {
    let shifted = |periods: u32| {
        let shift_px = rival.shift_px.map(|s| s / f64::from(periods));
        let [x, y] = first.offset;
        Rival {
            target_from_view: Affine2 {
                offset: [x + shift_px[0], y + shift_px[1]],
                ..*first
            },
            shift_px,
            turn_rad: 0.0,
            ..*rival
        }
    };
    let alike = |shorter: &Rival| {
        let seen = pictures.compare(first, &shorter.target_from_view, |_| true);
        seen.is_some_and(|s| {
            s.structured > 0 && s.both as f64 >= WHOLE_PERIOD * s.structured as f64
        })
    };
    let shorter = (2..=MOST_PERIODS).rev().map(shifted);
    shorter
        .filter(|r| f64::hypot(r.shift_px[0], r.shift_px[1]) > SHORTEST_PX)
        .find(alike)
        .unwrap_or(*rival)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_patches_decide_only_against_none_and_noise_decides_nothing() {
        let seen = |first_only, second_only| Comparison {
            structured: 1000,
            first: 900 + first_only,
            first_only,
            second_only,
            both: 900,
        };
        assert!(!decides(&seen(0, 0)));
        assert!(!decides(&seen(5, 1)));
        assert!(decides(&seen(16, 0)));
        assert!(!decides(&seen(60, 50)));
        assert!(decides(&seen(300, 100)));
        assert!(!decides(&seen(0, 30)));
    }
}
