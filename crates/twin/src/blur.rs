//! Gaussian blur of any width at the same price: three box filters in a row, with fractional radius.
//!
//! A box of radius r with edge weights a has the variance `(r (r+1) (2r+1)/3 + 2 a (r+1)^2) / (2r + 1 + 2a)`; solved for
//! a, three of them have exactly the variance asked for.

use rayon::prelude::*;

/// One of the three boxes.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Kernel {
    radius: usize,
    edge: f32,
    norm: f32,
}

impl Kernel {
    fn new(sigma: f64) -> Self {
        let v = sigma * sigma / 3.0;
        // The widest plain box that is not too wide: r (r + 1) / 3 <= v.
        let radius = (((0.25 + 3.0 * v).sqrt() - 0.5).max(0.0)).floor();
        let sum_sq = radius * (radius + 1.0) * (2.0 * radius + 1.0) / 3.0;
        let outer = (radius + 1.0).powi(2);
        let edge = ((v * (2.0 * radius + 1.0) - sum_sq) / (2.0 * (outer - v))).max(0.0);
        Self {
            radius: radius as usize,
            edge: edge as f32,
            norm: (1.0 / (2.0 * radius + 1.0 + 2.0 * edge)) as f32,
        }
    }
}

/// How far, in samples, a blur reaches.
pub(crate) fn reach(sigma: f64) -> usize {
    3 * (Kernel::new(sigma).radius + 1)
}

/// Blurs a plane in place. Beyond the border the border's value goes on.
pub(crate) fn blur(plane: &mut [f32], width: usize, sigma: f64) {
    if sigma < 0.02 || plane.is_empty() {
        return;
    }
    let kernel = Kernel::new(sigma);
    plane.par_chunks_mut(16 * width).for_each(|rows| {
        let mut a = vec![0.0f32; width + 2 * (kernel.radius + 1)];
        for row in rows.chunks_exact_mut(width) {
            for _ in 0..3 {
                along_row(row, &mut a, kernel);
            }
        }
    });
    let mut other = vec![0.0f32; plane.len()];
    down(plane, &mut other, width, kernel);
    down(&other, plane, width, kernel);
    down(plane, &mut other, width, kernel);
    plane.copy_from_slice(&other);
}

fn along_row(row: &mut [f32], padded: &mut [f32], kernel: Kernel) {
    let (n, pad) = (row.len(), kernel.radius + 1);
    padded[..pad].fill(row[0]);
    padded[pad..pad + n].copy_from_slice(row);
    padded[pad + n..].fill(row[n - 1]);
    if kernel.radius == 0 {
        for (out, p) in row.iter_mut().zip(padded.windows(3)) {
            *out = (p[1] + kernel.edge * (p[0] + p[2])) * kernel.norm;
        }
        return;
    }
    let span = 2 * kernel.radius + 1;
    let mut sum: f32 = padded[1..=span].iter().sum();
    for x in 0..n {
        row[x] = (sum + kernel.edge * (padded[x] + padded[x + span + 1])) * kernel.norm;
        sum += padded[x + span + 1] - padded[x + 1];
    }
}

fn down(from: &[f32], to: &mut [f32], width: usize, kernel: Kernel) {
    let height = from.len() / width;
    let r = kernel.radius as isize;
    let row = |y: isize| {
        let y = y.clamp(0, height as isize - 1) as usize;
        &from[y * width..(y + 1) * width]
    };
    // Blocks start afresh, so rounding does not depend on who works on which block.
    const BLOCK: usize = 64;
    to.par_chunks_mut(BLOCK * width)
        .enumerate()
        .for_each(|(block, out)| {
            let y0 = (block * BLOCK) as isize;
            if r == 0 {
                for (i, out) in out.chunks_exact_mut(width).enumerate() {
                    let y = y0 + i as isize;
                    let (before, here, after) = (row(y - 1), row(y), row(y + 1));
                    for x in 0..width {
                        out[x] = (here[x] + kernel.edge * (before[x] + after[x])) * kernel.norm;
                    }
                }
                return;
            }
            let mut sum = vec![0.0f32; width];
            for y in y0 - r..=y0 + r {
                for (s, v) in sum.iter_mut().zip(row(y)) {
                    *s += v;
                }
            }
            for (i, out) in out.chunks_exact_mut(width).enumerate() {
                let y = y0 + i as isize;
                let (before, after, first) = (row(y - r - 1), row(y + r + 1), row(y - r));
                for x in 0..width {
                    out[x] = (sum[x] + kernel.edge * (before[x] + after[x])) * kernel.norm;
                    sum[x] += after[x] - first[x];
                }
            }
        });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_becomes_a_spot_of_the_asked_width() {
        let (w, h) = (161usize, 151usize);
        for sigma in [0.1, 0.3, 0.8, 1.5, 3.0, 8.0, 12.3] {
            let mut plane = vec![0.0f32; w * h];
            plane[70 * w + 80] = 1.0;
            blur(&mut plane, w, sigma);
            let (mut sum, mut mean, mut var) = (0.0, [0.0; 2], [0.0; 2]);
            for (i, &v) in plane.iter().enumerate() {
                let (v, at) = (f64::from(v), [(i % w) as f64 - 80.0, (i / w) as f64 - 70.0]);
                sum += v;
                for k in 0..2 {
                    mean[k] += v * at[k];
                    var[k] += v * at[k] * at[k];
                }
            }
            assert!((sum - 1.0).abs() < 1e-4, "{sigma}: {sum}");
            for k in 0..2 {
                assert!(mean[k].abs() < 1e-3, "{sigma}: {mean:?}");
                assert!(
                    (var[k].sqrt() / sigma - 1.0).abs() < 2e-3,
                    "{sigma}: {var:?}"
                );
            }
        }
    }

    #[test]
    fn flat_stays_flat_and_small_planes_do_no_harm() {
        for (w, h) in [(1, 1), (3, 2), (40, 5)] {
            let mut plane = vec![0.7f32; w * h];
            blur(&mut plane, w, 6.0);
            assert!(plane.iter().all(|v| (v - 0.7).abs() < 1e-5));
        }
    }
}
