//! Times what a registration adds to the matching: `cargo run --release -p scopeservo-registration --example registration_time`.
//!
//! One thread, 2500 features on each side of a made-up pair, of which as many match as the row says. Prints microseconds, best of
//! several: `all` is all that follows the matching; search, fit, verdict and covariance are its parts by themselves.

#![expect(clippy::print_stdout, reason = "the example reports what it measured")]

use scopeservo_features::{Descriptors, Engine, Features, Keypoint};
use scopeservo_geometry::{
    Affine2, Correspondence, OrientedProblem, RansacOptions, SharedErrors, Similarity, SplitMix64,
    fit_affine, fit_affine_robust, lo_ransac,
};
use scopeservo_registration::significance::{
    AFFINE_SAMPLE, SIMILARITY_SAMPLE, log10_nfa, occupied_area, unique_places,
};
use scopeservo_registration::{Correspondences, Options, Prior, register_correspondences};
use std::hint::black_box;
use std::time::Instant;

const FEATURES: usize = 2500;

/// Features of two images that share `matches` descriptors; `share` of these also obey one similarity, with the scatter that
/// real keypoints have.
fn pair(matches: usize, share: f64, seed: u64) -> (Features, Features) {
    let mut rng = SplitMix64::new(seed);
    let truth = Affine2::from(Similarity {
        scale: 1.1,
        angle_rad: 0.4,
        offset: [60.0, -120.0],
    });
    let empty = || Features {
        descriptors: Descriptors::Bytes {
            length: 128,
            data: Vec::new(),
        },
        ..Features::none(Engine::default().name(), 640, 480)
    };
    let push = |features: &mut Features, keypoint, descriptor: &[u8; 128]| {
        features.keypoints.push(keypoint);
        if let Descriptors::Bytes { data, .. } = &mut features.descriptors {
            data.extend(descriptor);
        }
    };
    let (mut view, mut target) = (empty(), empty());
    let descriptor = |rng: &mut SplitMix64| -> [u8; 128] {
        // 128 components of at most 22 keep within the length of a descriptor.
        std::array::from_fn(|_| rng.below(23) as u8)
    };
    let anywhere = |rng: &mut SplitMix64| [rng.uniform() * 640.0, rng.uniform() * 480.0];
    for i in 0..FEATURES {
        let (p, sigma, angle) = (
            anywhere(&mut rng),
            2.0 * (1.2 * rng.uniform()).exp(),
            6.0 * rng.uniform(),
        );
        let seen = descriptor(&mut rng);
        push(&mut view, keypoint(p, sigma, angle), &seen);
        let there = if i as f64 >= share * matches as f64 {
            let sigma = 2.0 * (1.2 * rng.uniform()).exp();
            keypoint(anywhere(&mut rng), sigma, 6.0 * rng.uniform())
        } else {
            let noise = 0.15 * sigma;
            let q = truth.apply(p).map(|x| x + noise * rng.normal());
            let sigma = 1.1 * sigma * (1.0 + 0.08 * rng.normal());
            keypoint(q, sigma, angle + 0.4 + 0.06 * rng.normal())
        };
        let looks = match i < matches {
            true => seen,
            false => descriptor(&mut rng),
        };
        push(&mut target, there, &looks);
    }
    (view, target)
}

fn keypoint(at: [f64; 2], sigma: f64, angle: f64) -> Keypoint {
    Keypoint {
        x: at[0] as f32,
        y: at[1] as f32,
        sigma: sigma as f32,
        angle: angle.sin().atan2(angle.cos()) as f32,
        response: 0.1,
        bright: true,
        octave: 0,
        layer: 1,
    }
}

/// Best time of several runs in microseconds, with the last result.
fn best<T>(mut f: impl FnMut() -> T) -> (f64, T) {
    let mut time = || {
        let start = Instant::now();
        let value = black_box(f());
        (start.elapsed().as_secs_f64() * 1e6, value)
    };
    let first = time();
    (1..15).fold(first, |best, _| {
        let (us, value) = time();
        (us.min(best.0), value)
    })
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build_global()?;
    let (prior, options) = (Prior::default(), Options::default());
    let engine = Engine::default();
    println!(
        "matches share inliers | matching |  all | search samples | fit | verdict: places area nfa | covariance"
    );
    for matches in [200, 500, 1000, 2000] {
        for share in [0.1, 0.3, 0.6, 0.9, 0.95] {
            let (view, target) = pair(matches, share, 1);
            let of = || Correspondences::of(&*engine, &view, &target, &prior, &options);
            let (matching_us, found) = best(of);
            let found = found?;
            let (all_us, answer) = best(|| register_correspondences(&found, &prior, &options));
            let pairs = &found.pairs;
            let ransac = RansacOptions {
                threshold: 1.1 * options.threshold_px,
                ..RansacOptions::default()
            };
            let (search_us, search) = best(|| {
                lo_ransac(
                    &OrientedProblem::new(pairs, &found.shapes, &|_| true),
                    &ransac,
                )
            });
            let search = search.ok_or("nothing was found")?;
            let chosen: Vec<Correspondence> = search.inliers.iter().map(|&i| pairs[i]).collect();
            let shared = SharedErrors {
                block: 30.0,
                systematic: 0.0,
            };
            let (fit_us, _) = best(|| fit_affine_robust(&chosen, &shared));
            let ones = vec![1.0; chosen.len()];
            let (covariance_us, _) = best(|| fit_affine(&chosen, &ones, &shared));
            let points: Vec<_> = pairs.iter().map(|c| (c.p_in_a, c.p_in_b)).collect();
            let (places_us, _) = best(|| unique_places(&points, 2.0, 2.2));
            let at = |k: &Keypoint| [f64::from(k.x), f64::from(k.y)];
            let (area_us, _) = best(|| occupied_area(target.keypoints.iter().map(at), 20.0));
            let (nfa_us, _) = best(|| {
                [AFFINE_SAMPLE, SIMILARITY_SAMPLE].map(|sample| {
                    [8.0, 4.0, 2.0].map(|r| log10_nfa(sample, pairs.len(), chosen.len(), r * 1e-4))
                })
            });
            println!(
                "{:7} {share:5} {:7} | {matching_us:8.0} | {all_us:4.0} | {search_us:6.0} {:7} | {fit_us:3.0} | {places_us:15.0} {area_us:4.0} {nfa_us:3.0} | {covariance_us:3.0}",
                found.len(),
                answer.inliers,
                search.samples
            );
        }
    }
    Ok(())
}
