//! How much softer a view is than its target.

use super::*;

fn sharp_of(case: &Case) -> Option<Sharpness> {
    let pictures = Pictures {
        view: &case.view,
        target: &case.target,
        of_view: None,
        of_target: None,
    };
    sharpness(&pictures, &case.target_from_view)
}

fn sharp(case: &Case) -> Sharpness {
    sharp_of(case).expect("it can be told")
}

/// The blur that the view has more than the target, as it is and as it is found.
fn softer_is(name: &str, found: &Sharpness, truth: f64, within: f64) {
    let off = (found.softer_px2 - truth).abs();
    assert!(off <= within, "{name}: {found:?}, {truth}");
}

#[test]
fn how_much_softer_a_view_is_comes_out_as_the_variance_of_its_blur() {
    let blurs = [
        [0.6, 0.6],
        [0.7, 0.6],
        [0.8, 0.6],
        [1.2, 0.6],
        [0.6, 1.2],
        [2.0, 0.7],
        [2.2, 2.0],
        [3.0, 0.6],
    ];
    for (seed, blurs) in (1..).zip(blurs) {
        let [view, target] = blurs;
        let truth = view * view - target * target;
        for angle_rad in [0.0, 0.4] {
            let found = sharp(&case(seed, 1.0, angle_rad, blurs));
            softer_is(
                &format!("{blurs:?}"),
                &found,
                truth,
                0.06 + 0.1 * truth.abs(),
            );
            let is_sharper = found.ratio >= 1.0;
            assert!(
                is_sharper == (truth <= 0.0) || truth.abs() < 0.1,
                "{found:?}"
            );
        }
    }
}

#[test]
fn light_tone_noise_and_what_covers_a_part_make_no_difference_to_how_soft_a_view_is() {
    type Change = fn(&GrayImage, u64) -> GrayImage;
    let all: [(&str, Change); 6] = [
        ("half the light", |i, _| changed(i, |_, v| 0.5 * v)),
        ("gamma", |i, _| changed(i, |_, v| v.max(0.0).powf(1.6))),
        ("less contrast", |i, _| changed(i, |_, v| 0.2 + 0.5 * v)),
        ("noise", |i, seed| {
            noisy(&changed(i, |_, v| 0.5 + 0.3 * (v - 0.5)), 0.004, seed)
        }),
        ("dust", |i, seed| {
            let takes = dust(seed, 12);
            changed(i, |p, v| v * takes(p))
        }),
        ("a quarter covered", |i, _| {
            changed(i, |p, v| if p[0] < 80.0 { 0.3 } else { v })
        }),
    ];
    for (name, change) in all {
        for (seed, blurs) in [(3, [0.7, 0.7]), (4, [1.0, 0.7]), (5, [0.7, 1.0])] {
            let mut case = case(seed, 1.0, 0.0, blurs);
            case.view = change(&case.view, seed);
            let truth = blurs[0] * blurs[0] - blurs[1] * blurs[1];
            softer_is(name, &sharp(&case), truth, 0.13);
        }
    }
}

#[test]
fn how_sharp_is_not_said_of_other_pixels_nor_of_nothing() {
    assert_eq!(sharp_of(&case(1, 2.0, 0.0, [0.6, 0.6])), None);
    assert_eq!(sharp_of(&case(1, 0.9, 0.0, [0.6, 0.6])), None);
    let mut blank = case(1, 1.0, 0.0, [0.6, 0.6]);
    blank.view = noisy(&changed(&blank.view, |_, _| 0.7), 0.01, 2);
    assert_eq!(sharp_of(&blank), None);
}

#[test]
fn overexposed_glass_is_not_taken_for_an_image_without_noise() {
    for seed in [3, 4] {
        let mut case = case(seed, 1.0, 0.0, [1.2, 0.7]);
        let lit = |image: &GrayImage, seed| {
            let image = noisy(&changed(image, |_, v| 0.5 + 0.3 * (v - 0.5)), 0.006, seed);
            changed(&image, |p, v| if p[1] < 48.0 { 1.0 } else { v })
        };
        case.view = lit(&case.view, 2 * seed);
        case.target = lit(&case.target, 2 * seed + 1);
        softer_is("overexposed", &sharp(&case), 0.95, 0.3);
    }
}
