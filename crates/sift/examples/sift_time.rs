//! Times detection and matching on a synthetic image: `cargo run --release --example sift_time -p scopeservo-sift [threads] [raw w h]`.
//!
//! Prints milliseconds (best of several) and counts; matching at every level, on one thread and on two. `raw` is a file of w * h grey bytes to use instead of the synthetic image.

#![expect(clippy::print_stdout, reason = "the example reports what it measured")]

use std::time::Instant;

use scopeservo_sift::{
    Descriptor, Features, Gate, GrayImage, Keypoint, MatchOptions, Options, Simd,
    detect_and_describe, match_features_at,
};

/// Value noise of five octaves: detail at every scale, the same on every run.
fn texture(x: f32, y: f32) -> f32 {
    let lattice = |x: i32, y: i32| {
        let h = (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77);
        let h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
        ((h ^ (h >> 13)) & 0xFFFF) as f32 / 65535.0
    };
    (0..5)
        .map(|k| {
            let (x, y) = (x / (3 << k) as f32 + 37.0 * k as f32, y / (3 << k) as f32);
            let (i, j) = (x.floor() as i32, y.floor() as i32);
            let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
            let (u, v) = (smooth(x - x.floor()), smooth(y - y.floor()));
            let top = lattice(i, j) * (1.0 - u) + lattice(i + 1, j) * u;
            let bottom = lattice(i, j + 1) * (1.0 - u) + lattice(i + 1, j + 1) * u;
            (top * (1.0 - v) + bottom * v) * 0.2
        })
        .sum()
}

/// Best time of `n` runs in milliseconds, with the last result.
fn best<T>(n: usize, mut f: impl FnMut() -> T) -> (f64, T) {
    let mut time = || {
        let start = Instant::now();
        let value = f();
        (start.elapsed().as_secs_f64() * 1e3, value)
    };
    let first = time();
    (1..n).fold(first, |best, _| {
        let (ms, value) = time();
        (ms.min(best.0), value)
    })
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    if let Some(threads) = args.first() {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads.parse()?)
            .build_global()?;
    }
    let image = if let [_, raw, w, h] = &args[..] {
        let data = std::fs::read(raw)?
            .into_iter()
            .map(|v| f32::from(v) / 255.0)
            .collect();
        GrayImage::new(w.parse()?, h.parse()?, data)?
    } else {
        GrayImage::from_fn(640, 480, |x, y| texture(x as f32, y as f32))?
    };
    let options = Options::default();
    let (ms, features) = best(7, || detect_and_describe(&image, &options));
    let features = features?;
    println!(
        "{} x {}, {} threads: {} features (at most {} extrema) in {ms:.1} ms",
        image.width(),
        image.height(),
        rayon::current_num_threads(),
        features.len(),
        options.max_features
    );
    time_matching()
}

/// `n` features with random descriptors, angles, and sigmas spread over four octaves, the smaller the more.
fn random_features(n: usize, mut seed: u64) -> Result<Features, Box<dyn std::error::Error>> {
    let mut unit = || {
        seed = seed.wrapping_mul(0x5851_F42D_4C95_7F2D).wrapping_add(1);
        (seed >> 40) as f32 / (1 << 24) as f32
    };
    let keypoints = (0..n)
        .map(|_| Keypoint {
            x: 100.0 * unit(),
            y: 100.0 * unit(),
            sigma: 1.0 / (1.0 - 0.94 * unit()),
            angle: std::f32::consts::PI * (2.0 * unit() - 1.0),
            response: 0.1,
            bright: true,
            octave: 0,
            layer: 1,
        })
        .collect();
    let descriptors = (0..n)
        .map(|_| Descriptor::new(std::array::from_fn(|_| (32.0 * unit()) as u8)))
        .collect::<Result<_, _>>()?;
    Ok(Features {
        width: 100,
        height: 100,
        keypoints,
        descriptors,
    })
}

/// All levels, open and with what a calibration knows, on one thread and on two.
fn time_matching() -> Result<(), Box<dyn std::error::Error>> {
    let known = Gate {
        sigma_ratio: Some((1.0 / 1.7, 1.7)),
        turn_rad: Some((0.3, 0.5)),
        same_polarity: false,
    };
    for n in [2000, 5000] {
        let (query, train) = (random_features(n, 1)?, random_features(n, 2)?);
        for simd in Simd::available() {
            for threads in [1, 2] {
                let pool = rayon::ThreadPoolBuilder::new()
                    .num_threads(threads)
                    .build()?;
                let [open, gated] = [Gate::default(), known].map(|gate| {
                    let options = MatchOptions::default();
                    let once = || match_features_at(simd, &query, &train, &options, &gate);
                    pool.install(|| best(9, once)).0
                });
                println!(
                    "{n} x {n} matched at {}, {threads} threads: {open:.2} ms, gated {gated:.2} ms",
                    simd.level()
                );
            }
        }
    }
    Ok(())
}
