//! Every kind of instrument: mirrored, turned, skewed; whichever side moves; without rotation.

use crate::world::{World, paper_400x};
use crate::{HOME, distance_sq, sigma};
use scopeservo_geometry::Mat2;
use scopeservo_scope::Kinematics;
use scopeservo_servo::PlanarPose;
use scopeservo_servo::joint::{Pair, PathOptions, View, fit};

/// Of chi-square: 1 in 1000 is above, by degrees of freedom.
fn chi_999(freedom: usize) -> f64 {
    match freedom {
        6 => 22.46,
        9 => 27.88,
        54 => 91.87,
        _ => panic!("{freedom}"),
    }
}

fn check(world: &mut World, start: PlanarPose, what: &str) {
    let run = world.calibrate(&PathOptions::default(), start);
    let fit = run.fit.unwrap();
    assert!(
        run.taken.len() <= 40 && run.taken.iter().all(|t| t.found),
        "{what}"
    );
    assert!(fit.left_out.is_empty(), "{what}");
    let (distance_sq, count) = distance_sq(&world.off(&fit), &fit);
    assert!(
        distance_sq < chi_999(count),
        "{what}: {distance_sq} of {count}"
    );
    assert!((fit.chi_sq / fit.freedom - 1.0).abs() < 0.4, "{what}");
    let [kx, ky, angle_deg, eta_x_um, eta_y_um] = sigma(&fit);
    assert!(
        kx < 3e-4 && ky < 3e-4 && angle_deg < 0.008,
        "{what}: {kx} {ky} {angle_deg}"
    );
    assert!(
        eta_x_um < 5.0 && eta_y_um < 5.0,
        "{what}: {eta_x_um} {eta_y_um}"
    );
}

#[test]
fn any_rotation_hand_anisotropy_and_skew_is_found() {
    for step in 0..12 {
        for hand in [1.0, -1.0] {
            let mut world = World::hexapod(50 + step);
            world.backlash = [3e-6, 1e-6, 1e-5];
            let angle = (30.0 * step as f64 + 7.0).to_radians();
            let shape = Mat2([[1.0, 0.01], [0.0, 1.005 * hand]]);
            world.optics.stage_from_pixel = Mat2::rotation(angle) * shape * 0.505e-6;
            check(&mut world, HOME, &format!("{step} {hand}"));
        }
    }
}

#[test]
fn it_does_not_matter_which_side_moves_nor_where_it_begins() {
    for kinematics in [
        Kinematics::MovesMicroscope,
        Kinematics::SpecimenRotationOnTop,
        Kinematics::SpecimenXyOnTop,
    ] {
        for (seed, start_deg) in [(1, 0.0f64), (2, 5.0), (3, -20.0)] {
            let mut world = World::hexapod(seed);
            world.kinematics = kinematics;
            world.backlash = [2e-6, 4e-6, 1e-5];
            world.optics.centre_m = [3e-3, -2e-3];
            world.reach = [20e-3, 20e-3, 3.0];
            let start = PlanarPose {
                x_m: [1e-3, -4e-3],
                theta_rad: start_deg.to_radians(),
            };
            check(&mut world, start, &format!("{kinematics:?} {start_deg}"));
        }
    }
}

#[test]
fn a_stage_without_rotation_has_no_rotation_centre() {
    for kinematics in [Kinematics::MovesMicroscope, Kinematics::SpecimenXyOnTop] {
        let mut world = World::hexapod(9);
        world.kinematics = kinematics;
        world.turns = false;
        world.backlash = [2e-6, 4e-6, 0.0];
        world.optics.centre_m = [0.0; 2];
        check(&mut world, HOME, &format!("{kinematics:?}"));
    }
}

#[test]
fn a_short_travel_and_a_corner_of_it_are_kept_to() {
    const SEEDS: usize = 6;
    let mut off_sq = 0.0;
    for seed in 1..=SEEDS {
        let mut world = World::hexapod(seed as u64);
        world.optics.centre_m = [20e-3, 1e-3];
        world.reach = [0.6e-3, 0.9e-3, 2f64.to_radians()];
        let start = PlanarPose {
            x_m: [0.2e-3, -0.3e-3],
            theta_rad: 0.0,
        };
        // The world asserts that nothing goes beyond.
        let run = world.calibrate(&PathOptions::default(), start);
        let fit = run.fit.unwrap();
        off_sq += distance_sq(&world.off(&fit), &fit).0;
        assert!(sigma(&fit)[3] < 100.0);
    }
    assert!(off_sq < chi_999(9 * SEEDS), "{off_sq}");
}

#[test]
fn objectives_share_the_backlash_and_but_for_a_little_the_rotation_centre() {
    let mut worlds = [World::hexapod(21), World::hexapod(22)];
    let eta = paper_400x().centre_m;
    worlds[1].optics.stage_from_pixel = worlds[1].optics.stage_from_pixel * 2.0;
    worlds[1].optics.centre_m = [eta[0] + 9e-6, eta[1] - 12e-6];
    // The second one looks at a cross only.
    let options = [40, 18].map(|most_views| PathOptions {
        most_views,
        ..PathOptions::default()
    });
    let (mut views, mut pairs) = (Vec::new(), Vec::new());
    for (optics, world) in worlds.iter_mut().enumerate() {
        world.backlash = [3e-6, 1e-6, 1e-5];
        let run = world.calibrate(&options[optics], HOME);
        let first = views.len();
        let at = |view: View| View { optics, ..view };
        views.extend(run.taken.iter().map(|t| at(t.view)));
        pairs.extend(run.pairs.iter().map(|p| Pair {
            fixed: first + p.fixed,
            found: first + p.found,
            ..*p
        }));
    }
    let fit = fit(&worlds[0].priors(), &views, &pairs).unwrap();
    let mut off = worlds[0].off(&fit);
    let second = fit.instrument.optics[1];
    let map = worlds[1].optics.stage_from_pixel - second.stage_from_pixel;
    off.extend(map.0.as_flattened());
    off.extend([0, 1].map(|k| worlds[1].optics.centre_m[k] - second.centre_m[k]));
    let (distance_sq, count) = distance_sq(&off, &fit);
    assert_eq!(count, 15);
    // Of chi-square with 15 degrees of freedom 1 in 1000 is above.
    assert!(distance_sq < 37.7, "{distance_sq}");
    let sigma_m = fit.optics_covariance(1)[4][4].sqrt();
    assert!(sigma_m < 16e-6, "{sigma_m}");
}

#[test]
fn an_arm_ends_where_there_is_nothing_to_see_and_the_rest_goes_on() {
    let mut world = World::hexapod(5);
    world.backlash = [2e-6, 4e-6, 1e-5];
    world.extent_m = 0.45e-3;
    let run = world.calibrate(&PathOptions::default(), HOME);
    let fit = run.fit.unwrap();
    assert_eq!(run.taken.iter().filter(|t| !t.found).count(), 4);
    assert!(distance_sq(&world.off(&fit), &fit).0 < chi_999(9));
    assert!(
        sigma(&fit)[0] < 6e-4 && sigma(&fit)[3] < 5.0,
        "{:?}",
        sigma(&fit)
    );
}
