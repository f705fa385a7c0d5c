//! Two views of a drawn scene, the second shifted: `cargo run --release --example two_views`.

#![expect(clippy::print_stdout, reason = "an example that shows something")]

use scopeservo_sift::{GrayImage, MatchOptions, Options, Sift, SiftError, match_features};

const SHIFT: (f32, f32) = (12.5, -7.25);

/// Waves in many directions, the shorter the weaker.
fn scene(x: f32, y: f32) -> f32 {
    let wave = |i: i32| {
        let (k, turn) = (0.08 * 1.2_f32.powi(i), 1.1 * i as f32);
        0.9_f32.powi(i) * (k * (x * turn.cos() + y * turn.sin()) + turn).sin()
    };
    0.5 + 0.08 * (0..12).map(wave).sum::<f32>()
}

fn main() -> Result<(), SiftError> {
    let view =
        |dx: f32, dy: f32| GrayImage::from_fn(320, 240, |x, y| scene(x as f32 + dx, y as f32 + dy));
    let mut sift = Sift::new(Options::default())?;
    let here = sift.detect_and_describe(&view(0.0, 0.0)?);
    let moved = sift.detect_and_describe(&view(SHIFT.0, SHIFT.1)?);
    let matches = match_features(&here, &moved, &MatchOptions::default());
    let mut shifts: Vec<(f32, f32)> = (matches.iter())
        .map(|m| (here.keypoints[m.query], moved.keypoints[m.train]))
        .map(|(a, b)| (a.x - b.x, a.y - b.y))
        .collect();
    let mut median = |of: fn(&(f32, f32)) -> f32| {
        shifts.sort_by(|a, b| of(a).total_cmp(&of(b)));
        shifts.get(shifts.len() / 2).map_or(f32::NAN, of)
    };
    let (x, y) = (median(|s| s.0), median(|s| s.1));
    println!(
        "{} and {} features, {} matches",
        here.len(),
        moved.len(),
        matches.len()
    );
    println!(
        "shift of the median match: {x:.3}, {y:.3} pixels; the truth: {}, {}",
        SHIFT.0, SHIFT.1
    );
    Ok(())
}
