//! Work whose instructions are counted: `counted LEVEL PIECE`, with `scalar` or `avx2`, and `describe` or `match`.
//!
//! `python3 crates/sift/counts/counts.py` runs it under callgrind, which counts only what happens inside [`counted`].

use std::hint::black_box;

use scopeservo_sift::{
    Features, Gate, GrayImage, Level, MatchOptions, Options, Sift, Simd, match_features_at,
};

/// Blobs and stripes of many sizes: detail at every scale, the same on every run.
fn texture(x: f32, y: f32) -> f32 {
    let wave = |k: f32, turn: f32| (k * (x * turn.cos() + y * turn.sin()) + 7.0 * turn).sin();
    let sum: f32 = (0..12)
        .map(|i| wave(0.09 * 1.23_f32.powi(i), 1.1 * i as f32) * 0.9_f32.powi(i))
        .sum();
    0.5 + 0.08 * sum
}

#[inline(never)]
fn counted<T>(work: impl FnOnce() -> T) -> T {
    black_box(work())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [level, piece] = &args[..] else {
        return Err("usage: counted LEVEL PIECE".into());
    };
    let level = Level::ALL
        .into_iter()
        .find(|l| l.to_string() == *level)
        .ok_or("no such level")?;
    let simd = Simd::at(level)?;
    let mut sift = Sift::with(Options::default(), simd)?;
    let image = |dx: f32| GrayImage::from_fn(320, 240, |x, y| texture(x as f32 + dx, y as f32));
    let (here, moved) = (image(0.0)?, image(3.3)?);
    // One thread, or the counts depend on who steals what.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| match piece.as_str() {
        "describe" => {
            // The second image finds the buffers made.
            sift.detect_and_describe(&here);
            counted(|| sift.detect_and_describe(&here)).len()
        }
        _ => {
            let mut strongest = |image| -> Features {
                let all = sift.detect_and_describe(image);
                all.subset(&(0..all.len().min(500)).collect::<Vec<_>>())
            };
            let (a, b) = (strongest(&here), strongest(&moved));
            assert_eq!((a.len(), b.len()), (500, 500));
            let options = MatchOptions::default();
            counted(|| match_features_at(simd, &a, &b, &options, &Gate::default())).len()
        }
    });
    Ok(())
}
