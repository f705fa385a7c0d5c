//! Times detection and matching on a synthetic image: `cargo run --release --example time -p scopeservo-sift [threads] [raw w h]`.
//!
//! Prints milliseconds (best of several) and counts. `raw` is a file of w * h grey bytes to use instead of the synthetic image.

#![expect(clippy::print_stdout, reason = "the example reports what it measured")]

use std::time::Instant;

use scopeservo_sift::{GrayImage, MatchOptions, Options, detect_and_describe, match_features};

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
    let half = features.subset(&(0..features.len().min(2000)).collect::<Vec<_>>());
    let (ms, matches) = best(7, || match_features(&half, &half, &MatchOptions::default()));
    println!(
        "{0} x {0} matched in {ms:.1} ms: {1} matches",
        half.len(),
        matches.len()
    );
    Ok(())
}
