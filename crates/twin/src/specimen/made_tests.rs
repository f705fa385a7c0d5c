//! Specimens that repeat themselves or are nearly empty are what was asked for.

use super::tests::{assert_box_means, sample};
use super::*;
use std::sync::Arc;

const KINDS: [LatticeKind; 6] = [
    LatticeKind::Square,
    LatticeKind::Hexagonal,
    LatticeKind::Grating,
    LatticeKind::Lines,
    LatticeKind::Chequer,
    LatticeKind::Dies,
];

fn lattice(change: impl FnOnce(&mut LatticeConfig)) -> Lattice {
    let mut config = LatticeConfig::default();
    change(&mut config);
    Lattice::new(config).unwrap()
}

/// Mean absolute difference of the specimen and itself, shifted, in grey levels, over 100 um.
fn difference(s: &dyn Specimen, shift_um: [f64; 2]) -> f64 {
    let at = |x: f64, y: f64| s.patch(0, [x, x + 100.0], [y, y + 100.0], 0).unwrap();
    let (a, b) = (at(3.0, -40.0), at(3.0 + shift_um[0], -40.0 + shift_um[1]));
    assert_eq!([a.width, a.height], [b.width, b.height]);
    let sum: u64 = a
        .rgb
        .iter()
        .zip(&b.rgb)
        .map(|(a, b)| u64::from(a.abs_diff(*b)))
        .sum();
    sum as f64 / a.rgb.len() as f64
}

#[test]
fn the_period_seen_is_the_period_asked() {
    for kind in KINDS {
        let s = lattice(|c| {
            c.kind = kind;
            c.pitch_um = 20.0;
        });
        // The second row of a hexagonal lattice is a half column on; two rows are no whole number of samples apart.
        let along_y = match kind {
            LatticeKind::Hexagonal => 2.0 * 0.75f64.sqrt() * 20.0,
            _ => 20.0,
        };
        assert_eq!(difference(&s, [20.0, 0.0]), 0.0, "{kind:?}");
        let rounded = if kind == LatticeKind::Hexagonal {
            5.0
        } else {
            0.0
        };
        let sampled = (along_y / 0.25).round() * 0.25;
        assert!(difference(&s, [0.0, sampled]) <= rounded, "{kind:?}");
        for part in [5.0, 10.0, 15.0] {
            // Half a pitch along both axes is the other half of a chequer board, and that is the same again.
            assert!(difference(&s, [part, 0.0]) > 10.0, "{kind:?} {part}");
        }
        // A pitch that is no multiple of a sample does not run away: a thousand periods on, it is the same.
        let s = lattice(|c| {
            c.kind = kind;
            c.pitch_um = 7.3;
            c.fill = 0.6;
        });
        assert_eq!(difference(&s, [7300.0, 0.0]), 0.0, "{kind:?}");
    }
}

#[test]
fn a_turned_lattice_repeats_along_its_own_axes() {
    let s = lattice(|c| {
        c.pitch_um = 25.0;
        // A triangle of 3, 4 and 5: whole samples.
        c.turned_deg = (4.0f64 / 3.0).atan().to_degrees();
    });
    assert!(difference(&s, [15.0, 20.0]) < 0.01);
    assert!(difference(&s, [-20.0, 15.0]) < 0.01);
    assert!(difference(&s, [25.0, 0.0]) > 10.0);
}

/// Middle of the darkest patch around a place, um: centre of gravity of the light taken.
fn middle(s: &dyn Specimen, at: [f64; 2], half: f64) -> [f64; 2] {
    let p = s
        .patch(
            0,
            [at[0] - half, at[0] + half],
            [at[1] - half, at[1] + half],
            0,
        )
        .unwrap();
    let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
    for j in 0..p.height {
        for i in 0..p.width {
            let taken = f64::from(GLASS[0]) - f64::from(sample(&p, i, j)[0]);
            sum += taken;
            x += taken * (p.x0_um + i as f64 * p.spacing_um);
            y += taken * (p.y0_um - j as f64 * p.spacing_um);
        }
    }
    [x / sum, y / sum]
}

#[test]
fn the_scatter_of_cells_is_the_disorder_asked() {
    for disorder in [0.0, 0.03, 0.08] {
        let s = lattice(|c| {
            c.pitch_um = 20.0;
            c.fill = 0.3;
            c.disorder = disorder;
        });
        let mut off = Vec::new();
        for j in -7..8 {
            for i in -7..8 {
                let at = [20.0 * f64::from(i), 20.0 * f64::from(j)];
                let seen = middle(&s, at, 9.8);
                off.extend([seen[0] - at[0], seen[1] - at[1]]);
            }
        }
        let n = off.len() as f64;
        let mean = off.iter().sum::<f64>() / n;
        let sd = (off.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
        let asked = disorder * 20.0;
        // 450 numbers know their scatter to 3.3 %.
        assert!(
            (sd - asked).abs() < 0.02 + 0.12 * asked,
            "{sd} and not {asked}"
        );
        assert!(mean.abs() < 0.02 + 0.15 * asked, "{mean}");
    }
}

#[test]
fn one_cell_is_missing_and_no_other() {
    let whole = lattice(|_| {});
    let odd = lattice(|c| c.odd_cell = Some([2, -1]));
    let at = |s: &Lattice, x: f64, y: f64| s.patch(0, [x, x], [y, y], 0).unwrap().rgb;
    for j in -2..3 {
        for i in -2..5 {
            let (x, y) = (20.0 * f64::from(i), 20.0 * f64::from(j));
            assert_eq!(
                at(&whole, x, y) == at(&odd, x, y),
                [i, j] != [2, -1],
                "{i} {j}"
            );
        }
    }
}

#[test]
fn dies_are_alike_but_for_their_numbers() {
    let dies = |numbered| {
        lattice(|c| {
            c.kind = LatticeKind::Dies;
            c.pitch_um = 60.0;
            c.fill = 0.9;
            c.numbered = numbered;
        })
    };
    assert_eq!(difference(&dies(false), [60.0, 120.0]), 0.0);
    let numbers = difference(&dies(true), [60.0, 120.0]);
    assert!(numbers > 0.1 && numbers < 10.0, "{numbers}");
}

#[test]
fn holes_are_bright_where_discs_are_dark() {
    let (discs, holes) = (lattice(|_| {}), lattice(|c| c.holes = true));
    let red = |s: &Lattice, x: f64| s.patch(0, [x, x], [0.0, 0.0], 0).unwrap().rgb[0];
    assert!(red(&discs, 0.0) < 100 && red(&discs, 10.0) == GLASS[0]);
    assert!(red(&holes, 0.0) == GLASS[0] && red(&holes, 10.0) < 100);
}

#[test]
fn made_specimens_have_levels_that_are_means_and_depend_on_nothing_but_their_seed() {
    let all = |seed: u64| -> Vec<Arc<dyn Specimen>> {
        let mut all: Vec<Arc<dyn Specimen>> = vec![
            Arc::new(
                Sparse::new(SparseConfig {
                    seed,
                    ..SparseConfig::default()
                })
                .unwrap(),
            ),
            Arc::new(Twice::new(
                Arc::new(Tissue::new(seed)),
                [0.0, 0.0],
                [90.0, -20.0],
                [50.0, 60.0],
            )),
        ];
        for kind in KINDS {
            all.push(Arc::new(lattice(|c| {
                c.seed = seed;
                c.kind = kind;
                c.pitch_um = 13.7;
                c.turned_deg = 11.0;
                c.disorder = 0.05;
            })));
        }
        all
    };
    for s in all(3) {
        for level in 0..3 {
            assert_box_means(&*s, level, [40.0, 130.0], [-60.0, 30.0]);
        }
    }
    let ask = |s: &Arc<dyn Specimen>| s.patch(1, [10.0, 300.0], [-150.0, 20.0], 2).unwrap();
    let reference: Vec<Patch> = all(5).iter().map(ask).collect();
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            for (s, expected) in all(5).iter().zip(&reference) {
                s.patch(2, [-100.0, 100.0], [-50.0, 20.0], 0).unwrap();
                assert_eq!(&ask(s), expected, "{} on {threads} threads", s.describe());
            }
        });
    }
    for (s, same_place) in all(6).iter().zip(&reference) {
        assert_ne!(&ask(s), same_place, "{}", s.describe());
    }
}

#[test]
fn cells_are_as_many_and_as_dark_as_asked_and_all_else_is_glass() {
    let smear = |per_mm2: f64, contrast: f64| {
        let config = SparseConfig {
            seed: 4,
            per_mm2,
            radius_um: [5.0, 5.0],
            contrast,
        };
        let p = Sparse::new(config)
            .unwrap()
            .patch(1, [0.0, 1000.0], [0.0, 1000.0], 0)
            .unwrap();
        let taken = |k: usize| f64::from(GLASS[1]) - f64::from(p.rgb[3 * k + 1]);
        let (mut touched, mut deepest) = (0, 0.0f64);
        for k in 0..p.width * p.height {
            touched += usize::from(taken(k) > 0.5);
            deepest = deepest.max(taken(k));
        }
        (
            touched as f64 / (p.width * p.height) as f64,
            deepest / f64::from(GLASS[1]),
        )
    };
    let (share, deep) = smear(400.0, 0.8);
    // 400 cells of 79 um^2 in 1 mm^2.
    assert!((share / 0.0314 - 1.0).abs() < 0.2, "{share}");
    let (weak_share, weak) = smear(400.0, 0.1);
    assert!((weak / deep - 0.125).abs() < 0.02, "{weak} {deep}");
    assert!((weak_share / share - 1.0).abs() < 0.02);
    assert_eq!(smear(0.0, 0.8).0, 0.0);
}

#[test]
fn a_piece_that_is_there_twice_is_the_same_in_every_sample() {
    let tissue = Arc::new(Tissue::new(8));
    let twice = Twice::new(tissue.clone(), [0.0, 0.0], [400.0, 160.0], [80.0, 64.0]);
    for level in 0..6 {
        let at = |s: &dyn Specimen, x: f64, y: f64| {
            s.patch(level, [x - 20.0, x + 20.0], [y - 20.0, y + 20.0], 0)
                .unwrap()
                .rgb
        };
        assert_eq!(
            at(&twice, 400.0, 160.0),
            at(&twice, 0.0, 0.0),
            "level {level}"
        );
        assert_eq!(at(&twice, 0.0, 0.0), at(&*tissue, 0.0, 0.0));
    }
    let beside = |s: &dyn Specimen| s.patch(0, [446.0, 500.0], [100.0, 220.0], 0).unwrap();
    assert_eq!(beside(&twice), beside(&*tissue));
}

#[test]
fn descriptions_that_make_no_sense_are_refused_with_the_field() {
    let said = |made: MadeSpecimen| made.make().err().unwrap().to_string();
    let bad = LatticeConfig {
        pitch_um: 0.0,
        ..LatticeConfig::default()
    };
    assert!(said(MadeSpecimen::Lattice(bad)).contains("pitch_um"));
    let bad = SparseConfig {
        contrast: 2.0,
        ..SparseConfig::default()
    };
    assert!(said(MadeSpecimen::Sparse(bad)).contains("contrast"));
    let bad = MadeSpecimen::Twice(TwiceConfig {
        seed: 1,
        original_um: [0.0; 2],
        copy_um: [f64::NAN; 2],
        size_um: [9.0; 2],
    });
    assert!(said(bad).contains("twice"));
    assert_eq!(
        MadeSpecimen::Blank {}.make().unwrap().describe(),
        "blank glass"
    );
}
