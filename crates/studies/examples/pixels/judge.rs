//! What blocks of pixels say of transforms that are wrong, and of those that are right.

use crate::disturb::{ALL, disturbed};
use crate::refined::{drawn, pictures};
use crate::{LARGE, Outcome, source};
use rayon::prelude::*;
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, Mat2, SplitMix64};
use scopeservo_registration::pixels::{Evidence, Judgement, weigh};
use scopeservo_studies::quantile;
use scopeservo_studies::warp::{SIZE, Source};

const NOISE: f64 = 0.008;

pub(crate) fn wrong(count: u64) -> Outcome<()> {
    header();
    let [carcinoma, embryo, cytology] = [0, 1, 2].map(|k| source(LARGE[k]));
    let slides = [carcinoma?, embryo?, cytology?];
    let sections = [
        source("olfactory_bulb_1.png")?,
        source("olfactory_bulb_3.png")?,
    ];
    let each = |of: &(dyn Fn(u64, &mut SplitMix64) -> Option<Evidence> + Sync)| -> Vec<Evidence> {
        let one = |seed| of(seed, &mut SplitMix64::new(seed));
        (0..count).into_par_iter().filter_map(one).collect()
    };
    let unrelated = each(&|seed, rng| {
        let k = seed as usize % 3;
        let view = window(&slides[k], rng)?.0;
        let target = window(&slides[(k + 1) % 3], rng)?.0;
        Some(asked(&view, &target, rng))
    });
    row("another slide", &unrelated);
    let beside = each(&|seed, rng| {
        let slide = &slides[seed as usize % 3];
        let (view, at) = window(slide, rng)?;
        let (target, other) = window(slide, rng)?;
        let apart = (0..2).any(|k| (at[k] - other[k]).abs() > 1.5 * SIZE[k] as f64);
        apart.then(|| asked(&view, &target, rng))
    });
    row("a field beside", &beside);
    let section = each(&|_, rng| {
        let (view, at) = window(&sections[0], rng)?;
        Some(asked(&view, &shown(&sections[1], at, 0.0), rng))
    });
    row("a serial section", &section);
    let near = each(&|seed, rng| {
        let slide = &slides[seed as usize % 3];
        let (view, at) = window(slide, rng)?;
        let off = 4.0 + 26.0 * rng.uniform();
        let (s, c) = (std::f64::consts::TAU * rng.uniform()).sin_cos();
        let target = shown(slide, [at[0] + off * c, at[1] + off * s], 0.0);
        Some(weigh(&pictures(&view, &target), &Affine2::IDENTITY, &[]))
    });
    row("4 to 30 px beside", &near);
    let lattice = each(&|_, rng| {
        // Not by a period.
        let (pitch, angle) = (8.0 + 60.0 * rng.uniform(), rng.uniform());
        let off = pitch * (0.25 + 0.5 * rng.uniform());
        let (view, target) = (
            periodic(pitch, angle, 0.0, rng),
            periodic(pitch, angle, off, rng),
        );
        Some(weigh(&pictures(&view, &target), &Affine2::IDENTITY, &[]))
    });
    row("a lattice, no period", &lattice);
    let noise = each(&|_, rng| {
        let mut blank = || {
            GrayImage::from_fn(SIZE[0], SIZE[1], |_, _| (0.9 + 0.01 * rng.normal()) as f32)
                .expect("finite")
        };
        let (view, target) = (blank(), blank());
        Some(weigh(&pictures(&view, &target), &Affine2::IDENTITY, &[]))
    });
    row("blank glass", &noise);
    Ok(())
}

pub(crate) fn right(count: u64) -> Outcome<()> {
    header();
    let slides = LARGE
        .iter()
        .map(|n| source(n))
        .collect::<Outcome<Vec<_>>>()?;
    for (zoom, pitch) in [(1.0, 2.0), (4.0, 1.0)] {
        for what in ALL {
            let one = |seed: u64| {
                let pair = drawn(&slides[seed as usize % 3], zoom, pitch, seed)?;
                let view = disturbed(&pair.view, what, seed);
                Some(weigh(
                    &pictures(&view, &pair.target),
                    &pair.target_from_view,
                    &[],
                ))
            };
            let all: Vec<_> = (0..count).into_par_iter().filter_map(one).collect();
            row(&format!("{zoom}:1 {what}"), &all);
        }
    }
    Ok(())
}

/// A window at a random place with structure, in a random direction, and its middle.
fn window(source: &Source, rng: &mut SplitMix64) -> Option<(GrayImage, [f64; 2])> {
    (0..30).find_map(|_| {
        let at = [source.width, source.height].map(|n| n as f64 * (0.2 + 0.6 * rng.uniform()));
        let image = shown(source, at, 0.0);
        let mean = image.data().iter().sum::<f32>() / image.data().len() as f32;
        let varies = image
            .data()
            .iter()
            .filter(|v| (**v - mean).abs() > 0.05)
            .count();
        (4 * varies > image.data().len()).then_some((image, at))
    })
}

fn shown(source: &Source, at: [f64; 2], angle: f64) -> GrayImage {
    let linear = Mat2::rotation(0.2 + angle);
    let middle = linear * SIZE.map(|n| (n as f64 - 1.0) / 2.0);
    let source_from_pixel = Affine2 {
        linear,
        offset: [at[0] - middle[0], at[1] - middle[1]],
    };
    source.render(&source_from_pixel, NOISE, (at[0] * 1e3) as u64)
}

/// Of a random transform: any angle, a shift of up to a tenth of the view.
fn asked(view: &GrayImage, target: &GrayImage, rng: &mut SplitMix64) -> Evidence {
    let linear = Mat2::rotation(std::f64::consts::TAU * rng.uniform());
    let middle = SIZE.map(|n| (n as f64 - 1.0) / 2.0);
    let turned = linear * middle;
    let mut offset = [0, 1].map(|k| middle[k] - turned[k]);
    offset
        .iter_mut()
        .for_each(|v| *v += 60.0 * (rng.uniform() - 0.5));
    weigh(&pictures(view, target), &Affine2 { linear, offset }, &[])
}

fn periodic(pitch: f64, angle: f64, off: f64, rng: &mut SplitMix64) -> GrayImage {
    let (s, c) = angle.sin_cos();
    let k = std::f64::consts::TAU / pitch;
    GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let [x, y] = [x, y].map(|v| v as f64);
        let (u, v) = (c * x + s * y + off, c * y - s * x);
        let cell = ((k * u).cos() + (k * v).cos()).max(0.0);
        (0.4 + 0.2 * cell + NOISE * rng.normal()) as f32
    })
    .expect("finite")
}

fn header() {
    println!(
        "what pairs agrees contradicts cannot_tell | blocks median, agreeing: of all, median, p99, most | share of structure p1 median p99"
    );
}

fn row(what: &str, all: &[Evidence]) {
    let count = |j: Judgement| all.iter().filter(|e| e.judgement == j).count();
    let (asked, agree) = all
        .iter()
        .fold((0, 0), |(a, b), e| (a + e.asked, b + e.agree));
    let part: Vec<f64> = all
        .iter()
        .filter(|e| e.asked >= 10)
        .map(|e| e.agree as f64 / e.asked as f64)
        .collect();
    let blocks: Vec<f64> = all.iter().map(|e| e.asked as f64).collect();
    let shares: Vec<f64> = all.iter().map(|e| e.share).collect();
    println!(
        "{what:22} {} {} {} {} | {} {:.3} {:.3} {:.3} {:.3} | {:.2} {:.2} {:.2}",
        all.len(),
        count(Judgement::Agrees),
        count(Judgement::Contradicts),
        count(Judgement::CannotTell),
        quantile(&blocks, 0.5),
        agree as f64 / asked.max(1) as f64,
        quantile(&part, 0.5),
        quantile(&part, 0.99),
        quantile(&part, 1.0),
        quantile(&shares, 0.01),
        quantile(&shares, 0.5),
        quantile(&shares, 0.99),
    );
}
