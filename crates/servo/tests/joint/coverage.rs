//! Whether the truth lies within what a calibration says of itself.

use crate::world::World;
use crate::{HOME, distance_sq};
use scopeservo_servo::joint::PathOptions;

/// x and y, m, and rotation, rad.
const BACKLASH: [[f64; 3]; 4] = [
    [0.0; 3],
    [2e-6, 2e-6, 1e-5],
    [5e-6, 5e-6, 2e-5],
    [20e-6, 20e-6, 8e-5],
];
const NAMES: [&str; 9] = ["bx", "by", "bt", "m11", "m12", "m21", "m22", "ex", "ey"];
/// Of chi-square with nine degrees of freedom.
const CHI_95: f64 = 16.919;

/// Shares of rounds in which each number, and all together, lay within 95 %; the mean of chi-square over its freedom.
fn coverage(index: u64, coupled: bool, rounds: u64) -> ([f64; 9], f64, f64) {
    let backlash = BACKLASH[index as usize];
    let options = PathOptions::default();
    let (mut within, mut jointly, mut chi) = ([0.0; 9], 0.0, 0.0);
    for seed in 0..rounds {
        let mut world = World::hexapod(1000 * (index + 1) + seed);
        (world.backlash, world.sticks) = (backlash, !coupled);
        // Every other drifts.
        world.drift = [[0.0; 2], [8e-9, -6e-9]][(seed % 2) as usize];
        let fit = world.calibrate(&options, HOME).fit.unwrap();
        let off = world.off(&fit);
        for k in 0..9 {
            within[k] += f64::from(u8::from(
                off[k].abs() < 1.96 * fit.covariance[k * 10].sqrt(),
            ));
        }
        jointly += f64::from(u8::from(distance_sq(&off, &fit).0 < CHI_95));
        chi += fit.chi_sq / fit.freedom;
    }
    let share = |n: f64| n / rounds as f64;
    (within.map(share), share(jointly), share(chi))
}

/// The share of 95 % intervals that hold the truth, within `slack` of 95 %.
fn check(index: u64, coupled: bool, rounds: u64, slack: f64) {
    let (within, jointly, chi) = coverage(index, coupled, rounds);
    let told = || {
        let all = NAMES
            .iter()
            .zip(within)
            .map(|(n, w)| format!("{n} {:.1}", 100.0 * w));
        format!(
            "{:?}: {}, jointly {:.1}, chi {chi:.3}",
            BACKLASH[index as usize],
            all.collect::<Vec<_>>().join(", "),
            100.0 * jointly
        )
    };
    let good = |share: f64| (share - 0.95).abs() <= slack;
    assert!(within.into_iter().all(good) && good(jointly), "{}", told());
    // What scatters is estimated with the rest, a little more than it does.
    assert!((0.85..1.0).contains(&chi), "{}", told());
}

// So few rounds scatter by 2.8 %, and of thirty such shares one is off by more than three times that.
#[test]
fn the_truth_lies_within_what_is_stated_without_play() {
    check(0, true, 60, 0.09);
}

#[test]
fn the_truth_lies_within_what_is_stated_with_play_of_5_um() {
    check(2, true, 60, 0.09);
}

#[test]
fn the_truth_lies_within_what_is_stated_where_axes_that_are_not_asked_stand() {
    check(1, false, 60, 0.09);
}

#[test]
#[ignore = "needs a minute: 500 rounds each scatter by 1 %"]
fn the_truth_lies_within_what_is_stated_in_92_to_98_of_100_rounds_whatever_the_play() {
    for index in 0..4 {
        check(index, true, 500, 0.03);
    }
    check(1, false, 500, 0.03);
}
