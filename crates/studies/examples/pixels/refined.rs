//! What the refinement makes of a registration by features.

use crate::disturb::{ALL, disturbed};
use crate::{LARGE, Outcome, source};
use rayon::prelude::*;
use scopeservo_features::{Engine, GrayImage};
use scopeservo_geometry::Affine2;
use scopeservo_registration::pixels::{Pictures, refine, weigh};
use scopeservo_registration::{Estimate, Options, register};
use scopeservo_studies::quantile;
use scopeservo_studies::warp::{Pair, SIZE, Source, random_pair};
use std::time::Instant;

/// How the pairs of each zoom are rendered: source pixels per target pixel.
const ZOOMS: [(f64, f64); 3] = [(1.0, 2.0), (2.0, 1.5), (4.0, 1.0)];

/// One pair.
struct Record {
    /// Target px at the target's centre; `None` where the features found nothing.
    before_px: Option<f64>,
    /// What the refinement made of it, and its angle, over their sigmas.
    after: Option<[f64; 3]>,
}

pub(crate) fn table(pairs: u64) -> Outcome<()> {
    println!(
        "zoom disturbance pairs found refined | centre error, target px: features median p95, kept median p95 | worst gain worst loss | error and angle over sigma"
    );
    let sources: Vec<Source> = LARGE.iter().map(|n| source(n)).collect::<Outcome<_>>()?;
    for (zoom, pitch) in ZOOMS {
        for what in ALL {
            let mut records = Vec::new();
            for (k, source) in sources.iter().enumerate() {
                let of = |seed| record(source, zoom, pitch, what, 1000 * k as u64 + seed);
                let some: Vec<_> = (0..pairs).into_par_iter().filter_map(of).collect();
                records.extend(some);
            }
            print(zoom, what, &records);
        }
    }
    Ok(())
}

fn print(zoom: f64, what: &str, records: &[Record]) {
    let found: Vec<_> = records.iter().filter(|r| r.before_px.is_some()).collect();
    let before: Vec<f64> = found.iter().filter_map(|r| r.before_px).collect();
    let kept: Vec<f64> = found
        .iter()
        .filter_map(|r| r.after.map(|a| a[0]).or(r.before_px))
        .collect();
    let change: Vec<f64> = before
        .iter()
        .zip(&kept)
        .map(|(b, k)| (k - b) / zoom)
        .collect();
    let refined: Vec<[f64; 3]> = found.iter().filter_map(|r| r.after).collect();
    let rms = |k: usize| {
        let sum: f64 = refined.iter().map(|a| a[k] * a[k]).sum();
        (sum / refined.len().max(1) as f64).sqrt()
    };
    println!(
        "{zoom}:1 {what:15} {} {} {} | {:.4} {:.4} {:.4} {:.4} | {:.3} {:.3} | {:.2} {:.2}",
        records.len(),
        found.len(),
        refined.len(),
        quantile(&before, 0.5),
        quantile(&before, 0.95),
        quantile(&kept, 0.5),
        quantile(&kept, 0.95),
        quantile(&change, 0.0),
        quantile(&change, 1.0),
        rms(1),
        rms(2),
    );
}

fn record(source: &Source, zoom: f64, pitch: f64, what: &str, seed: u64) -> Option<Record> {
    let pair = drawn(source, zoom, pitch, seed)?;
    let view = disturbed(&pair.view, what, seed);
    let Some(start) = registered(&view, &pair) else {
        return Some(Record {
            before_px: None,
            after: None,
        });
    };
    let pictures = pictures(&view, &pair.target);
    let after = refine(&pictures, &start).ok().map(|refined| {
        let estimate = refined.estimate;
        let off = error(&pair, &estimate.target_from_view);
        let left = estimate
            .target_from_view
            .after(&pair.target_from_view.inverse().expect("regular"));
        let turned = left.linear.rotation_angle().unwrap_or(f64::NAN);
        let sigma = fit_sigma(&pair, &estimate);
        [
            off,
            off / sigma / 2f64.sqrt(),
            turned / estimate.sigma_angle_rad,
        ]
    });
    Some(Record {
        before_px: Some(error(&pair, &start.target_from_view)),
        after,
    })
}

/// A pair of a place with texture.
pub(crate) fn drawn(source: &Source, zoom: f64, pitch: f64, seed: u64) -> Option<Pair> {
    (0..20).find_map(|k| random_pair(source, zoom, pitch, 0.008, seed * 1000 + k).filter(textured))
}

/// By features, as the servo does it.
pub(crate) fn registered(view: &GrayImage, pair: &Pair) -> Option<Estimate> {
    let engine = Engine::default();
    let view = engine.features(view, 3000).ok()?;
    let target = engine.features(&pair.target, 8000).ok()?;
    let answer = register(&*engine, &view, &target, &pair.prior(), &Options::default());
    answer.found().cloned()
}

pub(crate) fn pictures<'a>(view: &'a GrayImage, target: &'a GrayImage) -> Pictures<'a> {
    Pictures {
        view,
        target,
        of_view: None,
        of_target: None,
    }
}

/// What of the view truly lies in the target's middle.
fn place(pair: &Pair) -> [f64; 2] {
    let middle = SIZE.map(|n| (n as f64 - 1.0) / 2.0);
    pair.target_from_view
        .inverse()
        .expect("a known warp is regular")
        .apply(middle)
}

/// How far it is put from there, target px.
fn error(pair: &Pair, found: &Affine2) -> f64 {
    let (p, q) = (
        found.apply(place(pair)),
        pair.target_from_view.apply(place(pair)),
    );
    f64::hypot(p[0] - q[0], p[1] - q[1])
}

fn fit_sigma(pair: &Pair, estimate: &Estimate) -> f64 {
    let fit = scopeservo_geometry::AffineFit {
        b_from_a: estimate.target_from_view,
        covariance: estimate.covariance,
    };
    fit.sigma_at(place(pair))
}

/// Whether a third of the target's blocks shows structure.
fn textured(pair: &Pair) -> bool {
    let block = 40;
    let (columns, rows) = (pair.target.width() / block, pair.target.height() / block);
    let busy = (0..columns * rows).filter(|b| {
        let values = (0..block * block).map(|i| {
            let (x, y) = (
                b % columns * block + i % block,
                b / columns * block + i / block,
            );
            f64::from(pair.target.get(x, y))
        });
        let n = (block * block) as f64;
        let mean = values.clone().sum::<f64>() / n;
        let variance = values.map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        variance.sqrt() > 0.03
    });
    busy.count() * 3 > columns * rows
}

/// Milliseconds of each part, the median of several runs, on one core.
pub(crate) fn time(runs: u64) -> Outcome<()> {
    println!("what size median_ms");
    let source = source(LARGE[0])?;
    for size in [[640, 480], [2448, 2048]] {
        let [w, h] = size.map(|n| n as f64);
        let at = |angle: f64, shift: f64| {
            let (s, c) = angle.sin_cos();
            Affine2::from([
                [
                    c,
                    -s,
                    source.width as f64 / 2.0 - (c * w - s * h) / 2.0 + shift,
                ],
                [
                    s,
                    c,
                    source.height as f64 / 2.0 - (s * w + c * h) / 2.0 - shift,
                ],
            ])
        };
        let (view, target) = (at(0.2, 0.0), at(0.21, 3.4));
        let images = [view, target].map(|t| source.render_sized(size, &t, 0.008, 1));
        let truth = target.inverse().ok_or("regular")?.after(&view);
        let mut covariance = [[0.0; 6]; 6];
        (covariance[2][2], covariance[5][5]) = (0.0025, 0.0025);
        let start = Estimate {
            target_from_view: Affine2 {
                offset: [truth.offset[0] + 0.04, truth.offset[1] - 0.03],
                ..truth
            },
            covariance,
            sigma_px: 0.05,
            corner_sigma_px: 0.05,
            sigma_angle_rad: 1e-4,
        };
        let pictures = pictures(&images[0], &images[1]);
        let timed = |work: &dyn Fn() -> usize| {
            let mut all = Vec::new();
            for _ in 0..runs {
                let began = Instant::now();
                std::hint::black_box(work());
                all.push(1e3 * began.elapsed().as_secs_f64());
            }
            quantile(&all, 0.5)
        };
        let steps = refine(&pictures, &start).map(|r| (r.steps, r.blocks));
        let refine_ms = timed(&|| refine(&pictures, &start).map_or(0, |r| r.blocks));
        let weigh_ms = timed(&|| weigh(&pictures, &truth, &[]).asked);
        println!(
            "refine {w}x{h} {refine_ms:.2} (steps and blocks {steps:?})\nweigh {w}x{h} {weigh_ms:.2}"
        );
    }
    Ok(())
}
