//! Grids drawn by formula, and what is none.

use scopeservo_features::GrayImage;
use scopeservo_geometry::{Mat2, SplitMix64};
use scopeservo_registration::{Grid, NoGrid, find_grid, follow_grid};

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Discs,
    Squares,
    Lines,
    Chequer,
    Hexagons,
    Grating,
}

/// A grid as it is drawn.
#[derive(Clone)]
struct Scene {
    kind: Kind,
    /// Its periods as columns, and where cell (0, 0) is from the image's centre, px.
    map: Mat2,
    offset: [f64; 2],
    distortion: f64,
    keystone: [f64; 2],
    /// Of the pitch, along each axis.
    disorder: f64,
    noise: f64,
    bright: bool,
    uneven: bool,
    dust: usize,
    missing: Option<[i64; 2]>,
    seed: u64,
    size: [usize; 2],
}

impl Scene {
    fn new(kind: Kind, pitch_px: f64, angle_deg: f64) -> Self {
        Self {
            kind,
            map: Mat2::rotation(angle_deg.to_radians()) * pitch_px,
            offset: [3.3, -7.1],
            distortion: 0.0,
            keystone: [0.0; 2],
            disorder: 0.0,
            noise: 0.01,
            bright: false,
            uneven: true,
            dust: 0,
            missing: None,
            seed: 1,
            size: [640, 480],
        }
    }

    fn corner(&self) -> f64 {
        let [w, h] = self.size.map(|n| (n as f64 - 1.0) / 2.0);
        w.hypot(h)
    }

    /// Lattice coordinates of a pixel, by turning the model of the documentation round.
    fn lattice(&self, p: [f64; 2]) -> [f64; 2] {
        let r = self.corner();
        let seen = p.map(|v| v / r);
        let mut q = seen;
        for _ in 0..12 {
            let bend = 1.0 + self.distortion * (q[0] * q[0] + q[1] * q[1]);
            q = seen.map(|v| v / bend);
        }
        let near = 1.0 / (1.0 - self.keystone[0] * q[0] - self.keystone[1] * q[1]);
        let q = q.map(|v| v * near * r);
        self.map.inverse().unwrap() * [q[0] - self.offset[0], q[1] - self.offset[1]]
    }

    /// Signed distance to the nearest cell's edge, in pitches; positive inside.
    fn inside(&self, [u, v]: [f64; 2]) -> f64 {
        let (i, j) = (u.round(), v.round());
        let mut rng = SplitMix64::new(self.seed ^ ((i as i64 * 7919 + j as i64 * 104_729) as u64));
        let off = [self.disorder * rng.normal(), self.disorder * rng.normal()];
        let [a, b] = [u - i - off[0], v - j - off[1]];
        if self.missing == Some([i as i64, j as i64]) {
            return -0.25;
        }
        match self.kind {
            Kind::Discs => 0.25 - a.hypot(b),
            Kind::Squares => 0.25 - a.abs().max(b.abs()),
            Kind::Lines => 0.06 - a.abs().min(b.abs()),
            Kind::Grating => 0.2 - a.abs(),
            // Squares half a period wide, on their corner: the periods are those of squares of one colour.
            Kind::Chequer => {
                let (c, s) = ((u + v).rem_euclid(2.0), (u - v).rem_euclid(2.0));
                let fold = |t: f64| (t - 1.0).abs() - 0.5;
                let (c, s) = (fold(c), fold(s));
                c.abs().min(s.abs()) * (c * s).signum() * 0.7
            }
            Kind::Hexagons => {
                let row = (v / 0.75f64.sqrt()).round();
                let shift = 0.5 * row.rem_euclid(2.0);
                let a = (u - shift) - (u - shift).round();
                0.25 - a.hypot(v - row * 0.75f64.sqrt())
            }
        }
    }

    fn draw(&self) -> GrayImage {
        let mut rng = SplitMix64::new(self.seed);
        let [w, h] = self.size;
        let dust: Vec<[f64; 3]> = (0..self.dust)
            .map(|_| {
                [
                    rng.uniform() * w as f64,
                    rng.uniform() * h as f64,
                    4.0 + 14.0 * rng.uniform(),
                ]
            })
            .collect();
        let pitch = self.map.det().abs().sqrt();
        GrayImage::from_fn(w, h, |x, y| {
            let p = [
                x as f64 - (w as f64 - 1.0) / 2.0,
                y as f64 - (h as f64 - 1.0) / 2.0,
            ];
            let d = self.inside(self.lattice(p)) * pitch;
            let taken = 1.0 / (1.0 + (-d / 0.45).exp());
            let taken = if self.bright { 1.0 - taken } else { taken };
            let r_sq = (p[0] * p[0] + p[1] * p[1]) / self.corner().powi(2);
            let light = match self.uneven {
                true => {
                    0.9 * (1.0 - 0.12 * r_sq) * (1.0 + 0.03 * p[0] / 320.0 - 0.02 * p[1] / 240.0)
                }
                false => 0.9,
            };
            let shadow: f64 = dust
                .iter()
                .map(|d| {
                    1.0 - 0.8
                        / (1.0 + (((x as f64 - d[0]).hypot(y as f64 - d[1]) - d[2]) / 1.5).exp())
                })
                .product();
            (light * shadow * (1.0 - 0.6 * taken) + self.noise * rng.normal()) as f32
        })
        .unwrap()
    }

    fn find(&self) -> Result<Grid, NoGrid> {
        find_grid(&self.draw(), self.map.det().abs().sqrt())
    }
}

/// Scale and angle, up to the names of the periods: relative and rad off the truth, with what is stated.
fn off(grid: &Grid, scene: &Scene) -> [f64; 4] {
    // The same lattice has four bases that turn into each other.
    let Mat2([[a, b], [c, d]]) = grid.pixel_from_lattice;
    let bases = [
        [a, b, c, d],
        [b, -a, d, -c],
        [-a, -b, -c, -d],
        [-b, a, -d, c],
    ];
    let truth = scene.map.0;
    let t = [truth[0][0], truth[0][1], truth[1][0], truth[1][1]];
    let far = |m: &[f64; 4]| m.iter().zip(&t).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    let [a, b, c, d] = bases
        .into_iter()
        .min_by(|x, y| far(x).total_cmp(&far(y)))
        .unwrap();
    let pitch = scene.map.det().sqrt();
    let scale = (a * d - b * c).sqrt() / pitch - 1.0;
    let angle = (c - b).atan2(a + d) - (t[2] - t[1]).atan2(t[0] + t[3]);
    let sigma = (0..4).map(|k| grid.covariance[k][k]).sum::<f64>().sqrt() / 2.0 / pitch;
    [scale, angle, sigma / 2f64.sqrt(), sigma / 2f64.sqrt()]
}

const SHAPES: [Kind; 4] = [Kind::Discs, Kind::Squares, Kind::Lines, Kind::Chequer];

/// Another place, noise and dust each time.
fn placed(kind: Kind, pitch_px: f64, angle_deg: f64, seed: u64) -> Scene {
    let mut rng = SplitMix64::new(seed);
    let mut scene = Scene::new(kind, pitch_px * (0.95 + 0.1 * rng.uniform()), angle_deg);
    scene.offset = [0, 1].map(|_| pitch_px * (rng.uniform() - 0.5));
    scene.seed = seed;
    scene
}

#[test]
fn the_map_is_known_as_well_as_it_says_at_any_angle_whatever_the_shape() {
    let (mut sum, mut count) = ([0.0; 2], 0.0);
    for (k, kind) in SHAPES.into_iter().enumerate() {
        for (i, angle) in [0.0, 17.0, 44.9, 71.0].into_iter().enumerate() {
            for pitch in [19.0, 37.0, 60.0] {
                let mut scene = placed(kind, pitch, angle, (97 * k + 11 * i) as u64 + pitch as u64);
                scene.bright = (i + k) % 2 == 0;
                scene.size = [320, 240];
                let grid = scene.find().unwrap();
                let [scale, turn, scale_sigma, turn_sigma] = off(&grid, &scene);
                let z = [scale / scale_sigma, turn / turn_sigma];
                assert!(
                    pitch > 50.0 || scale.abs().max(turn.abs()) < 1e-4,
                    "{pitch} {angle} {scale} {turn}"
                );
                assert!(z.iter().all(|z| z.abs() < 4.0), "{pitch} {angle} {z:?}");
                sum = [0, 1].map(|k| sum[k] + z[k] * z[k]);
                count += 1.0;
            }
        }
    }
    for sum in sum {
        assert!((0.8..1.25).contains(&(sum / count).sqrt()), "{sum} {count}");
    }
}

#[test]
fn dust_and_missing_cells_are_left_out() {
    for (seed, kind) in SHAPES.into_iter().enumerate() {
        let mut scene = placed(kind, 40.0, 17.0, seed as u64);
        scene.dust = 10;
        scene.missing = Some([1, -1]);
        let grid = scene.find().unwrap();
        let [scale, turn, scale_sigma, turn_sigma] = off(&grid, &scene);
        assert!(grid.left_out >= 8, "{}", grid.left_out);
        assert!(
            scale.abs() < 4.0 * scale_sigma && scale_sigma < 1e-4,
            "{scale} {scale_sigma}"
        );
        assert!(turn.abs() < 4.0 * turn_sigma, "{turn} {turn_sigma}");
    }
}

#[test]
fn distortion_and_tilt_are_seen_where_they_are_and_nowhere_else() {
    let seed = 2;
    for (k, keystone) in [
        (0.0, 0.0),
        (0.003, 0.0),
        (-0.003, 0.0),
        (0.0, 0.002),
        (0.02, 0.001),
    ] {
        let mut scene = placed(Kind::Discs, 40.0, 30.0, seed);
        (scene.distortion, scene.keystone) = (k, [keystone, -0.5 * keystone]);
        let grid = scene.find().unwrap();
        let Grid {
            distortion: d,
            keystone: t,
            ..
        } = grid;
        assert_eq!(
            (d.seen, t[0].seen),
            (k != 0.0, keystone != 0.0),
            "{k} {keystone} {d:?} {t:?}"
        );
        for (term, truth) in [(d, k), (t[0], keystone), (t[1], -0.5 * keystone)] {
            assert!(
                (term.value - truth).abs() < 4.0 * term.sigma && term.sigma < 2e-4,
                "{truth} {term:?}"
            );
        }
        let [scale, ..] = off(&grid, &scene);
        assert!(scale.abs() < 1e-4, "{k} {keystone} {scale}");
    }
}

#[test]
fn what_is_no_square_grid_of_that_pitch_is_refused() {
    let refused = |change: fn(&mut Scene), kind, expected: f64| {
        let mut scene = Scene::new(kind, 40.0, 12.0);
        change(&mut scene);
        find_grid(&scene.draw(), expected).unwrap_err()
    };

    assert!(matches!(
        refused(|_| (), Kind::Hexagons, 40.0),
        NoGrid::NotSquare { .. }
    ));
    assert!(matches!(
        refused(|_| (), Kind::Grating, 40.0),
        NoGrid::OneDirection
    ));
    // Twice and half, and a chequer board taken by its sides: sqrt 2.
    let wrong = [0.5, 2f64.sqrt(), 2.0, 0.5f64.sqrt()];
    for (kind, wrong) in SHAPES.into_iter().zip(wrong) {
        let error = refused(|_| (), kind, 40.0 * wrong);
        assert!(
            matches!(error, NoGrid::OtherPitch { seen_px, .. } if (seen_px - 40.0).abs() < 0.5),
            "{error}"
        );
    }
    let disordered = refused(|s| s.disorder = 0.05, Kind::Discs, 40.0);
    assert!(
        matches!(disordered, NoGrid::Irregular { scatter, .. } if (scatter - 0.05).abs() < 0.01),
        "{disordered}"
    );
    assert!(matches!(
        refused(|s| s.map = Mat2::rotation(0.1) * 6.5, Kind::Discs, 6.5),
        NoGrid::TooFine { .. }
    ));
    assert!(matches!(
        refused(|s| s.map = Mat2::rotation(0.1) * 230.0, Kind::Discs, 230.0),
        NoGrid::TooFewNodes { .. } | NoGrid::NothingRepeats | NoGrid::OneDirection
    ));
    // Noise, and blobs anywhere.
    let mut rng = SplitMix64::new(3);
    let blobs: Vec<[f64; 3]> = (0..300)
        .map(|_| {
            [
                640.0 * rng.uniform(),
                480.0 * rng.uniform(),
                4.0 + 6.0 * rng.uniform(),
            ]
        })
        .collect();
    let tissue = GrayImage::from_fn(640, 480, |x, y| {
        let taken: f64 = blobs
            .iter()
            .map(|b| {
                (-((x as f64 - b[0]).powi(2) + (y as f64 - b[1]).powi(2)) / (2.0 * b[2] * b[2]))
                    .exp()
            })
            .sum();
        (0.9 - 0.3 * taken.min(2.0) + 0.01 * rng.normal()) as f32
    });
    assert_eq!(
        find_grid(&tissue.unwrap(), 40.0).unwrap_err(),
        NoGrid::NothingRepeats
    );
    let noise = GrayImage::from_fn(640, 480, |_, _| (0.8 + 0.01 * rng.normal()) as f32);
    assert_eq!(
        find_grid(&noise.unwrap(), 40.0).unwrap_err(),
        NoGrid::NothingRepeats
    );
    assert!(find_grid(&GrayImage::from_fn(640, 480, |_, _| 0.0).unwrap(), 40.0).is_err());
}

#[test]
fn a_grid_that_moved_and_turned_a_little_keeps_the_names_of_its_periods() {
    // At 44.99 degrees the one nearest to image x changes.
    let mut scene = Scene::new(Kind::Discs, 20.0, 44.99);
    let first = scene.find().unwrap();
    for (turn_deg, offset) in [(0.05, [1.0, 2.0]), (-1.0, [8.0, -9.0]), (1.2, [0.0, 0.0])] {
        scene.map = Mat2::rotation(f64::to_radians(44.99 + turn_deg)) * 20.0;
        scene.offset = offset;
        let next = follow_grid(&scene.draw(), &first).unwrap();
        let turned = next.pixel_from_lattice * first.pixel_from_lattice.inverse().unwrap();
        assert!((turned.rotation_angle().unwrap().to_degrees() - turn_deg).abs() < 1e-3);
        let [i, j] = next.lattice_of_centre().unwrap();
        let [u, v] = scene.lattice([0.0, 0.0]);
        let whole = |t: f64| (t - t.round()).abs() < 1e-2;
        // The same node's names turn with the basis by quarters at most.
        assert!(
            whole(i.abs() - u.abs()) || whole(i.abs() - v.abs()) || whole(i + u),
            "{i} {j} {u} {v}"
        );
    }
}
