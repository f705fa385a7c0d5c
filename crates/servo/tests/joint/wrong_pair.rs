//! A registration that is wrong counts for nothing and is named.
//!
//! From 8 px on: on an arm nothing but the stage speaks against a pair, and its scatter of 0.4 um at the paper's lever arm hides what is
//! wrong by less. Of all 80 pairs, each in turn 1, 2, 3, 5 and 8 px off, 81, 87, 93, 95 and 100 % are named; those that are not move a
//! number by up to 14 standard deviations.

use crate::HOME;
use crate::world::World;
use scopeservo_servo::joint::{JointFit, PathOptions, Role};

/// The most that a number of a fit is from that of another, in the fit's own standard deviations.
fn moved(world: &World, fit: &JointFit, other: &JointFit) -> f64 {
    let off = world.off(fit);
    let each = off.iter().zip(world.off(other)).enumerate();
    each.map(|(k, (a, b))| (a - b).abs() / fit.covariance[k * 10].sqrt())
        .fold(0.0, f64::max)
}

#[test]
fn one_wrong_pair_is_named_and_does_not_move_the_answer() {
    for seed in 0..3 {
        let mut world = World::hexapod(70 + seed);
        world.backlash = [2e-6, 2e-6, 1e-5];
        let run = world.calibrate(&PathOptions::default(), HOME);
        let right = run.fit.unwrap();
        let count = run.pairs.len();
        for (n, off_px) in [8.0, 30.0, 120.0, -400.0].into_iter().enumerate() {
            for step in 0..6 {
                let wrong = (5 + 17 * n + step * count / 6) % count;
                let mut pairs = run.pairs.clone();
                pairs[wrong].centre_px[n % 2] += off_px;
                let fit = world.solve(&run.taken, &pairs).unwrap();
                let what = format!("{seed}: pair {wrong} of {count} off by {off_px} px");
                assert_eq!(fit.left_out, [wrong], "{what}");
                // It is as if the pair had never been: what it said is lost, and the deviations say so.
                pairs.remove(wrong);
                let without = world.solve(&run.taken, &pairs).unwrap();
                assert!(moved(&world, &fit, &without) < 0.1, "{what}");
                assert!(moved(&world, &fit, &right) < 3.0, "{what}");
            }
        }
    }
}

#[test]
fn a_turned_pair_that_is_wrong_by_its_angle_is_named() {
    let mut world = World::hexapod(80);
    let run = world.calibrate(&PathOptions::default(), HOME);
    let turned = |k: &usize| matches!(run.taken[run.pairs[*k].found].role, Role::Sweep { .. });
    let wrong = (0..run.pairs.len()).find(turned).unwrap();
    let mut pairs = run.pairs.clone();
    pairs[wrong].angle_rad += 0.01;
    assert_eq!(world.solve(&run.taken, &pairs).unwrap().left_out, [wrong]);
}

#[test]
fn several_wrong_pairs_are_all_named() {
    let mut world = World::hexapod(81);
    let run = world.calibrate(&PathOptions::default(), HOME);
    let wrong = [3, 20, 41, 60];
    let mut pairs = run.pairs.clone();
    for (n, k) in wrong.into_iter().enumerate() {
        pairs[k].centre_px[n % 2] += 20.0 + 30.0 * n as f64;
    }
    assert_eq!(world.solve(&run.taken, &pairs).unwrap().left_out, wrong);
}
