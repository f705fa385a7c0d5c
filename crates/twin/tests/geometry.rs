//! Where the image shows a thing, against the truth and against formulas written down again here.

mod common;

use common::{Bench, centroid, clean, dot, pixel, waves};
use scopeservo_scope::{Axis, Kinematics, StagePose};
use scopeservo_twin::{Config, StageConfig};

const ALL: [Kinematics; 3] = [
    Kinematics::MovesMicroscope,
    Kinematics::SpecimenRotationOnTop,
    Kinematics::SpecimenXyOnTop,
];

#[test]
fn a_dot_appears_where_the_truth_says_to_a_fiftieth_of_a_pixel() {
    // Spot width about 6 px; angles and fractional offsets at every objective, in and out of focus.
    for (id, sigma, angle, dz) in [
        ("10x", 13.0, 0.0, 0.0),
        ("20x", 6.5, 33.0, 0.0),
        ("40x", 3.0, -140.0, 0.0),
        ("40x", 3.0, 20.0, 3.0),
        ("10x", 13.0, 10.0, 200.0),
    ] {
        let bench = Bench::new(clean(StageConfig::hexapod()), dot([700.0, -300.0], sigma));
        bench.select(id);
        bench.twin.centre_specimen([700.0, -300.0], angle);
        bench.focus(dz);
        let at = bench.stage.position().unwrap();
        let um = bench.twin.truth_now().um_per_px;
        for (i, j) in [(0.0, 0.0), (0.25, 0.5), (17.37, -9.81), (-33.5, 21.13)] {
            let to = StagePose::default()
                .with_si(Axis::X, at.si(Axis::X).unwrap() + i * um * 1e-6)
                .with_si(Axis::Y, at.si(Axis::Y).unwrap() + j * um * 1e-6);
            bench.move_to(to);
            let frame = bench.grab();
            let truth = bench.twin.truth(frame.sequence).unwrap();
            let expected = pixel(truth.specimen_from_pixel, [700.0, -300.0]);
            let seen = centroid(&frame);
            let error = (seen[0] - expected[0]).hypot(seen[1] - expected[1]);
            assert!(
                error < 0.02,
                "{id} {angle} {dz} {i} {j}: {seen:?} {expected:?}"
            );
        }
    }
}

/// The paper's equation (3) and the two specimen-carrying forms, in complex numbers rather than matrices.
fn specimen_by_hand(
    config: &Config,
    kinematics: Kinematics,
    offset_um: [f64; 2],
    stage: [f64; 3],
    placement: (f64, [f64; 2]),
    p: [f64; 2],
) -> [f64; 2] {
    type C = (f64, f64);
    let mul = |a: C, b: C| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
    let turn = |angle: f64| (angle.cos(), angle.sin());
    let o = &config.optics[0];
    let m = (
        (p[0] - 319.5) / o.kx_px_per_m * 1e6,
        (p[1] - 239.5) / o.ky_px_per_m * 1e6,
    );
    // R_ec m = -i e^(-i phi) conj(m): a reflection.
    let phi = config.mount.phi_deg.to_radians();
    let c = mul(mul((0.0, -1.0), turn(-phi)), (m.0, -m.1));
    let c = (
        c.0 + config.mount.eta_mm[0] * 1e3 + offset_um[0],
        c.1 + config.mount.eta_mm[1] * 1e3 + offset_um[1],
    );
    let (x, th) = ((stage[0] * 1e6, stage[1] * 1e6), stage[2]);
    let w = match kinematics {
        Kinematics::MovesMicroscope => {
            let r = mul(turn(th), c);
            (r.0 + x.0, r.1 + x.1)
        }
        Kinematics::SpecimenRotationOnTop => mul(turn(-th), (c.0 - x.0, c.1 - x.1)),
        Kinematics::SpecimenXyOnTop => {
            let r = mul(turn(-th), c);
            (r.0 - x.0, r.1 - x.1)
        }
    };
    let (a, d) = placement;
    let s = mul(turn(-a), (w.0 - d[0], w.1 - d[1]));
    [s.0, s.1]
}

#[test]
fn every_kinematics_follows_its_equation() {
    for kinematics in ALL {
        let config = clean(StageConfig {
            kinematics,
            ..StageConfig::hexapod()
        });
        let bench = Bench::new(config.clone(), waves());
        let offset = {
            let eta = bench
                .twin
                .true_calibration(&config.optics[0].id)
                .unwrap()
                .eta_mm;
            [
                (eta[0] - config.mount.eta_mm[0]) * 1e3,
                (eta[1] - config.mount.eta_mm[1]) * 1e3,
            ]
        };
        bench.twin.centre_specimen([40.0, 90.0], 25.0);
        let a = 25f64.to_radians();
        // At the start pose w = c whatever the kinematics, which gives the placement d.
        let zero = [0.0; 3];
        let c0 = specimen_by_hand(
            &config,
            kinematics,
            offset,
            zero,
            (0.0, [0.0; 2]),
            [319.5, 239.5],
        );
        let d = [
            c0[0] - (a.cos() * 40.0 - a.sin() * 90.0),
            c0[1] - (a.sin() * 40.0 + a.cos() * 90.0),
        ];
        let stage = [1.25e-3, -0.7e-3, 0.06];
        bench.move_to(
            StagePose::default()
                .with_si(Axis::X, stage[0])
                .with_si(Axis::Y, stage[1])
                .with_si(Axis::Rz, stage[2]),
        );
        let truth = bench.twin.truth_now();
        for p in [[0.0, 0.0], [639.0, 10.0], [100.25, 479.0]] {
            let by_hand = specimen_by_hand(&config, kinematics, offset, stage, (a, d), p);
            let said = truth.specimen(p);
            assert!(
                (by_hand[0] - said[0]).hypot(by_hand[1] - said[1]) < 1e-6,
                "{kinematics:?} {p:?}: {by_hand:?} {said:?}"
            );
        }
    }
}

#[test]
fn a_rotation_of_the_stage_sweeps_the_lever_arm() {
    let bench = Bench::new(clean(StageConfig::hexapod()), waves());
    let before = bench.twin.truth_now();
    bench.move_to(StagePose::default().with_si(Axis::Rz, 1f64.to_radians()));
    let after = bench.twin.truth_now();
    let swept =
        (after.centre_um[0] - before.centre_um[0]).hypot(after.centre_um[1] - before.centre_um[1]);
    assert!((swept - 2188.7).abs() < 1.0, "{swept}");
    assert!((after.angle_deg - before.angle_deg - 1.0).abs() < 1e-9);
}

#[test]
fn a_mirror_turns_the_handedness_round() {
    let mut config = clean(StageConfig::hexapod());
    let determinant = |config: &Config| {
        let m = Bench::new(config.clone(), waves())
            .twin
            .truth_now()
            .specimen_from_pixel;
        m[0][0] * m[1][1] - m[0][1] * m[1][0]
    };
    // Rows run downwards and the specimen's y upwards: an honest image has a negative determinant.
    assert!(determinant(&config) < 0.0);
    config.mount.mirrored = true;
    assert!(determinant(&config) > 0.0);
}

#[test]
fn skew_shears_the_picture() {
    let mut config = clean(StageConfig::hexapod());
    let angle = |config: &Config| {
        let m = Bench::new(config.clone(), waves())
            .twin
            .truth_now()
            .specimen_from_pixel;
        let (x, y) = ([m[0][0], m[1][0]], [m[0][1], m[1][1]]);
        (x[0] * y[0] + x[1] * y[1]) / x[0].hypot(x[1]) / y[0].hypot(y[1])
    };
    assert!(angle(&config).abs() < 1e-9);
    config.mount.skew = 0.02;
    assert!((angle(&config).abs() - 0.02).abs() < 1e-3);
}

#[test]
fn remounting_moves_the_view_as_told() {
    let bench = Bench::new(clean(StageConfig::hexapod()), dot([0.0, 0.0], 13.0));
    bench.twin.centre_specimen([0.0; 2], 0.0);
    let before = bench.twin.truth_now();
    bench.twin.remount([0.0; 2], [60.0, -40.0], 30.0, false);
    let after = bench.twin.truth_now();
    assert!((after.angle_deg - before.angle_deg + 30.0).abs() < 1e-9);
    assert!((after.centre_um[0].hypot(after.centre_um[1]) - 60f64.hypot(40.0)).abs() < 1e-6);
    let seen = centroid(&bench.grab());
    let expected = pixel(after.specimen_from_pixel, [0.0; 2]);
    assert!((seen[0] - expected[0]).hypot(seen[1] - expected[1]) < 0.02);

    let det = |m: [[f64; 3]; 2]| m[0][0] * m[1][1] - m[0][1] * m[1][0];
    bench.twin.remount([0.0; 2], [0.0; 2], 0.0, true);
    let flipped = bench.twin.truth_now();
    assert!(det(after.specimen_from_pixel) * det(flipped.specimen_from_pixel) < 0.0);
}

#[test]
fn objectives_are_neither_parcentric_nor_parfocal() {
    let bench = Bench::new(Config::realistic(), waves());
    let mut seen = Vec::new();
    for id in ["10x", "20x", "40x", "10x"] {
        bench.select(id);
        let t = bench.twin.truth_now();
        assert_eq!(t.objective, id);
        seen.push((t.centre_um, t.defocus_um));
    }
    let apart = |i: usize, j: usize| {
        let (a, b): ([f64; 2], [f64; 2]) = (seen[i].0, seen[j].0);
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    assert!(apart(0, 1) > 1.0 && apart(0, 1) < 36.0);
    assert!(
        apart(0, 3) > 0.01 && apart(0, 3) < 6.0,
        "comes back nearly: {}",
        apart(0, 3)
    );
    assert!((seen[0].1 - seen[2].1).abs() > 0.5);
    for (_, defocus) in &seen {
        assert!(defocus.abs() < 17.0);
    }
}

#[test]
fn coarse_specimens_are_interpolated_at_the_right_place() {
    // The finest sample is larger than a pixel of the 40x: the bicubic path.
    struct Coarse(std::sync::Arc<dyn scopeservo_twin::Specimen>);
    impl scopeservo_twin::Specimen for Coarse {
        fn finest_um(&self) -> f64 {
            0.8
        }
        fn levels(&self) -> usize {
            1
        }
        fn patch(
            &self,
            _: usize,
            x: [f64; 2],
            y: [f64; 2],
            margin: usize,
        ) -> Result<scopeservo_twin::Patch, scopeservo_twin::SpecimenError> {
            // Level 4 of the formula has 0.8 um.
            self.0.patch(4, x, y, margin)
        }
        fn extent_um(&self) -> Option<[f64; 4]> {
            None
        }
        fn describe(&self) -> String {
            "coarse".into()
        }
    }
    let specimen = std::sync::Arc::new(Coarse(dot([10.0, 20.0], 4.0)));
    let bench = Bench::new(clean(StageConfig::hexapod()), specimen);
    bench.select("40x");
    bench.twin.centre_specimen([12.3, 17.1], 57.0);
    bench.focus(0.0);
    let frame = bench.grab();
    let truth = bench.twin.truth(frame.sequence).unwrap();
    let expected = pixel(truth.specimen_from_pixel, [10.0, 20.0]);
    let seen = centroid(&frame);
    let error = (seen[0] - expected[0]).hypot(seen[1] - expected[1]);
    assert!(error < 0.02, "{seen:?} {expected:?}");
}

#[test]
fn distortion_moves_a_dot_out_by_its_cube_and_an_undistorted_picture_not_at_all() {
    let (at, k) = ([700.0, -300.0], 0.004);
    let frame = |distortion: f64, corner: [f64; 2]| {
        let mut config = clean(StageConfig::hexapod());
        config.optics[0].distortion = distortion;
        let bench = Bench::new(config, dot(at, 13.0));
        bench.select("10x");
        let um = bench.twin.truth_now().um_per_px;
        bench
            .twin
            .centre_specimen([at[0] + corner[0] * um, at[1] + corner[1] * um], 0.0);
        bench.focus(0.0);
        let frame = bench.grab();
        let truth = bench.twin.truth(frame.sequence).unwrap();
        (pixel(truth.specimen_from_pixel, at), centroid(&frame))
    };
    for corner in [[0.0, 0.0], [0.0, 250.0], [150.0, -200.0], [-190.0, 40.0]] {
        for distortion in [0.0, k, -k] {
            let (ideal, seen) = frame(distortion, corner);
            let [x, y] = [ideal[0] - 319.5, ideal[1] - 239.5];
            let bend = 1.0 + distortion * (x * x + y * y) / (319.5f64.powi(2) + 239.5f64.powi(2));
            let off = [seen[0] - 319.5 - bend * x, seen[1] - 239.5 - bend * y];
            assert!(
                off[0].hypot(off[1]) < 0.02,
                "{corner:?} {distortion}: {off:?}"
            );
        }
    }
}
