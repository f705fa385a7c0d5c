//! What pixels say for and against a transform.

use super::*;

#[test]
fn pixels_agree_where_the_transform_is_right_and_contradict_one_that_is_wrong() {
    for zoom in [1.0, 2.0] {
        for seed in [61, 62, 63] {
            let right = case(seed, zoom, 0.3, [0.6, 0.6]).noisy(0.02);
            let t = right.target_from_view;
            let seen = weigh(&right.pictures(), &t, &[]);
            assert_eq!(seen.judgement, Judgement::Agrees, "{seen:?}");
            assert!(seen.share > 0.9, "{seen:?}");
            // Half covered is enough.
            let half = case(seed, zoom, 0.3, [0.6, 0.6])
                .view(|p, v| if p[0] > 160.0 { 0.5 } else { v })
                .noisy(0.02);
            let seen = weigh(&half.pictures(), &t, &[]);
            assert_ne!(seen.judgement, Judgement::Contradicts, "{seen:?}");
            assert!(
                zoom > 1.0 || seen.judgement == Judgement::Agrees,
                "{seen:?}"
            );
            for off in [5.0, 40.0] {
                let wrong = Affine2 {
                    offset: [t.offset[0] + off * zoom, t.offset[1]],
                    ..t
                };
                let seen = weigh(&right.pictures(), &wrong, &[]);
                assert_eq!(
                    seen.judgement,
                    Judgement::Contradicts,
                    "{zoom} {off} {seen:?}"
                );
            }
        }
    }
    let blank = case(1, 1.0, 0.0, [0.6, 0.6]).view(|_, _| 0.7);
    let empty = Case {
        target: blank.view.clone(),
        ..blank
    }
    .noisy(0.01);
    let seen = weigh(&empty.pictures(), &empty.target_from_view, &[]);
    assert_eq!((seen.judgement, seen.asked), (Judgement::CannotTell, 0));
}

#[test]
fn blocks_without_features_are_asked_alone_where_there_are_enough() {
    let case = case(71, 1.0, 0.1, [0.6, 0.6]).noisy(0.01);
    // A feature on each spot of the left half.
    let fitted: Vec<Vec2> = (0..2400)
        .map(|i| [4.0 * (i % 40) as f64, 4.0 * (i / 40) as f64])
        .collect();
    let seen = weigh(&case.pictures(), &case.target_from_view, &fitted);
    assert!(seen.held_out && seen.asked >= 10, "{seen:?}");
    assert!(seen.blocks.iter().all(|b| b.in_view[0] > 150.0));
    let everywhere: Vec<Vec2> = fitted
        .iter()
        .flat_map(|&[x, y]| [[x, y], [x + 160.0, y]])
        .collect();
    let all = weigh(&case.pictures(), &case.target_from_view, &everywhere);
    assert!(!all.held_out && all.asked > seen.asked, "{all:?}");
}

/// Features lie on what both images show, so that the blocks without any are those that something covers.
#[test]
fn what_covers_two_fifths_is_no_evidence_and_what_looks_alike_in_a_quarter_or_scattered_is() {
    let other = Scene::new(77).image(&placed([0.0; 2], 0.4, 1.0), 1.0);
    let seen = |seed: u64, alike: f64| {
        let case = case(seed, 1.0, 0.1, [0.6, 0.6])
            .view(|p, v| if p[0] < alike { v } else { at(&other, p) })
            .noisy(0.01);
        let fitted: Vec<Vec2> = (0..4800)
            .map(|i| [4.0 * (i % 80) as f64, 4.0 * (i / 80) as f64])
            .filter(|p| p[0] < alike)
            .collect();
        weigh(&case.pictures(), &case.target_from_view, &fitted)
    };
    for seed in [81, 82, 83] {
        for alike in [144.0, 192.0, 208.0, 256.0] {
            let covered = seen(seed, alike);
            assert_ne!(covered.judgement, Judgement::Contradicts, "{covered:?}");
        }
        // Grey over two fifths, in a corner or in the middle of one side.
        for at in [[0.0, 0.0], [1.0, 0.4], [0.3, 1.0]] {
            let case = case(seed, 1.0, 0.1, [0.6, 0.6]);
            let (w, h) = (SIZE[0] as f64, SIZE[1] as f64);
            let (sides, share) = ([0.63 * w, 0.63 * h], [0.37 * w, 0.37 * h]);
            let covers =
                |p: Vec2| (0..2).all(|k| (0.0..sides[k]).contains(&(p[k] - at[k] * share[k])));
            let case = case
                .view(|p, v| if covers(p) { 0.5 } else { v })
                .noisy(0.01);
            let all = (0..4800).map(|i| [4.0 * (i % 80) as f64, 4.0 * (i / 80) as f64]);
            let fitted: Vec<Vec2> = all.filter(|p| !covers(*p)).collect();
            let covered = weigh(&case.pictures(), &case.target_from_view, &fitted);
            assert_ne!(
                covered.judgement,
                Judgement::Contradicts,
                "{at:?} {covered:?}"
            );
        }
        // Of another place as much looks alike, in spots that lie scattered, as dirt on the camera does.
        let spot = |p: Vec2| {
            let cell = p.map(|v| (v / 40.0) as u64);
            (cell[0] * 7 + cell[1] * 5 + seed) % 5 < 2
        };
        let case = case(seed, 1.0, 0.1, [0.6, 0.6])
            .view(|p, v| if spot(p) { v } else { at(&other, p) })
            .noisy(0.01);
        let all = (0..4800).map(|i| [4.0 * (i % 80) as f64, 4.0 * (i / 80) as f64]);
        let fitted: Vec<Vec2> = all.filter(|p| spot(*p)).collect();
        let scattered = weigh(&case.pictures(), &case.target_from_view, &fitted);
        assert_eq!(scattered.judgement, Judgement::Contradicts, "{scattered:?}");
        for alike in [48.0, 80.0] {
            let elsewhere = seen(seed, alike);
            assert_eq!(elsewhere.judgement, Judgement::Contradicts, "{elsewhere:?}");
            assert!(elsewhere.held_out);
        }
    }
}

/// More than half of the view is overexposed, and there are few cells: blocks of noise alone say nothing.
#[test]
fn noise_beside_overexposed_glass_is_no_structure() {
    let cell = |k: usize| [44.5 + 48.0 * (k % 3) as f64, 44.5 + 72.0 * (k / 3) as f64];
    let cells: Vec<Vec2> = (0..8).map(cell).collect();
    let blank = case(1, 1.0, 0.0, [0.6, 0.6]);
    let drawn = |image: &GrayImage, seed| {
        let light = |p: Vec2, _: f64| {
            let dark = |c: &Vec2| {
                let away_sq = (p[0] - c[0]).powi(2) + (p[1] - c[1]).powi(2);
                0.3 * (-away_sq / 32.0).exp()
            };
            let dark: f64 = cells.iter().map(dark).sum();
            (0.85 - dark) * if p[0] < 192.0 { 1.25 } else { 1.1 }
        };
        noisy(&changed(image, light), 0.01, seed)
    };
    let case = Case {
        view: drawn(&blank.view, 5),
        target: drawn(&blank.target, 6),
        target_from_view: Affine2::IDENTITY,
        zoom: 1.0,
    };
    let edge = (0..9).map(|k| [188.5, 20.5 + 24.0 * f64::from(k)]);
    let fitted: Vec<Vec2> = cells.iter().copied().chain(edge).collect();
    let seen = weigh(&case.pictures(), &case.target_from_view, &fitted);
    assert_ne!(seen.judgement, Judgement::Contradicts, "{seen:?}");
}
