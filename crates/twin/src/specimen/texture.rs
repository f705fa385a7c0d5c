//! How much of an area shows structure.

use super::{Patch, Specimen, SpecimenError};

/// Sampling at which structure is judged, micrometres: about that of a 40x objective's camera pixel.
const SPACING_UM: f64 = 0.5;
/// Side of a block, micrometres: one or two cells.
const BLOCK_UM: f64 = 16.0;
/// Standard deviation of luminance, grey levels, from which a block counts. Glass of a scanned slide has 1 to 2.
const MIN_STD: f64 = 5.0;

/// Share, 0 to 1, of the blocks of an area that show structure at 400x: those whose luminance varies by more than
/// camera noise and dust would. The area is `size_um[0]` x `size_um[1]`, upright, around `centre_um`.
///
/// # Errors
/// As [`Specimen::patch`].
pub fn texture_share(
    s: &dyn Specimen,
    centre_um: [f64; 2],
    size_um: [f64; 2],
) -> Result<f64, SpecimenError> {
    let steps = (SPACING_UM / s.finest_um()).log2().round().max(0.0) as usize;
    let level = steps.min(s.levels() - 1);
    let ends = |k: usize| {
        [
            centre_um[k] - 0.5 * size_um[k],
            centre_um[k] + 0.5 * size_um[k],
        ]
    };
    let patch = s.patch(level, ends(0), ends(1), 0)?;
    let side = ((BLOCK_UM / patch.spacing_um).round() as usize).max(4);
    let (across, down) = ((patch.width / side).max(1), (patch.height / side).max(1));
    let textured = (0..across * down)
        .filter(|b| luminance_std(&patch, b % across * side, b / across * side, side) > MIN_STD)
        .count();
    Ok(textured as f64 / (across * down) as f64)
}

fn luminance_std(p: &Patch, x: usize, y: usize, side: usize) -> f64 {
    let (mut n, mut sum, mut sum_sq) = (0.0, 0.0, 0.0);
    for j in y..(y + side).min(p.height) {
        let row = &p.rgb[3 * j * p.width..3 * (j + 1) * p.width];
        for &[r, g, b] in &row.as_chunks::<3>().0[x..(x + side).min(p.width)] {
            let v = 0.299 * f64::from(r) + 0.587 * f64::from(g) + 0.114 * f64::from(b);
            n += 1.0;
            sum += v;
            sum_sq += v * v;
        }
    }
    let mean: f64 = sum / n;
    (sum_sq / n - mean * mean).max(0.0).sqrt()
}
