//! How well the path determines an instrument.

use crate::world::World;
use crate::{HOME, sigma};
use scopeservo_servo::joint::PathOptions;

#[test]
fn the_papers_instrument_at_400x_is_known_ten_times_as_well_as_in_the_paper() {
    for seed in 0..4 {
        let mut world = World::hexapod(seed);
        world.backlash = [2e-6, 2e-6, 1e-5];
        let run = world.calibrate(&PathOptions::default(), HOME);
        let [kx, ky, angle_deg, eta_x_um, eta_y_um] = sigma(&run.fit.unwrap());
        assert!(run.taken.len() <= 40);
        assert!(kx <= 3e-4 && ky <= 3e-4, "{kx} {ky}");
        assert!(angle_deg <= 0.006, "{angle_deg}");
        assert!(eta_x_um <= 5.0 && eta_y_um <= 5.0, "{eta_x_um} {eta_y_um}");
    }
}

#[test]
fn the_same_measurements_make_the_same_path_and_answer() {
    let run = || World::hexapod(7).calibrate(&PathOptions::default(), HOME);
    let (one, other) = (run(), run());
    assert_eq!((one.taken, one.fit), (other.taken, other.fit));
}

#[test]
fn less_scatter_ends_the_path_sooner_and_better() {
    // Its half-widths read as even distributions, as `AxisInfo::standard_deviation` does.
    let mut world = World::hexapod(1);
    world.scatter = world.scatter.map(|s| s / 3f64.sqrt());
    let run = world.calibrate(&PathOptions::default(), HOME);
    let views = run.taken.len();
    let [kx, ky, angle_deg, eta_x_um, eta_y_um] = sigma(&run.fit.unwrap());
    assert!(
        kx <= 1.6e-4 && ky <= 1.6e-4 && angle_deg <= 0.0035,
        "{kx} {ky} {angle_deg}"
    );
    assert!(eta_x_um <= 2.0 && eta_y_um <= 2.0, "{eta_x_um} {eta_y_um}");
    assert!(views < 40);
}
