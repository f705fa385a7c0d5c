//! The specimen under a grid of samples around the image, as the optics lay it there.

use crate::affine::Affine;
use crate::distortion::Distortion;
use crate::optics::{View, principal_point};
use crate::scene::{Planes, Scene};
use crate::slide::{covered, restained};
use crate::specimen::{Patch, SpecimenError};
use rayon::prelude::*;

/// A grid of samples, `step` pixels apart, around the image. Sample i lies at pixel `(i - margin + 0.5) step - 0.5`.
pub(crate) struct Grid {
    step: usize,
    margin: usize,
    pub(crate) width: usize,
    height: usize,
    out: [usize; 2],
}

impl Grid {
    pub(crate) fn new(w: usize, h: usize, step: usize, reach: usize) -> Self {
        let margin = if step > 1 { reach + 2 } else { reach };
        Self {
            step,
            margin,
            width: w.div_ceil(step) + 2 * margin,
            height: h.div_ceil(step) + 2 * margin,
            out: [w, h],
        }
    }

    fn pixel_from_grid(&self) -> Affine {
        let s = self.step as f64;
        let t = (0.5 - self.margin as f64) * s - 0.5;
        Affine([[s, 0.0, t], [0.0, s, t]])
    }

    /// The distortion of k at the image's corner, in samples.
    fn distortion(&self, at_corner: f64) -> Option<Distortion> {
        let s = self.step as f64;
        let middle = principal_point(self.out[0], self.out[1]);
        let centre = middle.map(|v| (v + 0.5) / s - 0.5 + self.margin as f64);
        Distortion::new(at_corner, centre, middle[0].hypot(middle[1]) / s)
    }

    /// Its corners; or all its `edges`, where the map is no longer affine.
    fn border(&self, edges: bool) -> Vec<[f64; 2]> {
        let far = [self.width as f64 - 0.5, self.height as f64 - 0.5];
        let along = |n: usize| match edges {
            true => (0..=n).map(|i| i as f64 - 0.5).collect(),
            false => vec![-0.5, n as f64 - 0.5],
        };
        let rows = along(self.height).into_iter();
        let columns = along(self.width).into_iter();
        let sides = rows.flat_map(|y| [[-0.5, y], [far[0], y]]);
        let ends = columns.flat_map(|x| [[x, -0.5], [x, far[1]]]);
        sides.chain(ends).collect()
    }

    /// Back to pixels: a cut, or a bilinear enlargement of what is smooth anyway.
    pub(crate) fn to_pixels(&self, plane: &[f32]) -> Vec<f32> {
        let [w, h] = self.out;
        let mut out = vec![0.0; w * h];
        let s = self.step as f64;
        let at = |i: usize| {
            let u = (i as f64 + 0.5) / s - 0.5 + self.margin as f64;
            (u.floor() as usize, (u - u.floor()) as f32)
        };
        out.par_chunks_mut(w).enumerate().for_each(|(y, row)| {
            if self.step == 1 {
                let from = (y + self.margin) * self.width + self.margin;
                row.copy_from_slice(&plane[from..from + w]);
                return;
            }
            let (j, fy) = at(y);
            let upper = &plane[j * self.width..(j + 1) * self.width];
            let lower = &plane[(j + 1) * self.width..(j + 2) * self.width];
            for (x, v) in row.iter_mut().enumerate() {
                let (i, fx) = at(x);
                let top = upper[i] + fx * (upper[i + 1] - upper[i]);
                let bottom = lower[i] + fx * (lower[i + 1] - lower[i]);
                *v = top + fy * (bottom - top);
            }
        });
        out
    }
}

/// The specimen on the grid, before any blur. `pitch_um` is the distance of two grid samples.
pub(crate) fn sample(
    scene: &Scene,
    view: &View,
    grid: &Grid,
    pitch_um: f64,
) -> Result<Planes, SpecimenError> {
    let specimen_from_grid = grid.pixel_from_grid().then(&view.specimen_from_pixel);
    let distortion = grid.distortion(scene.optics.distortion);
    let looks_at = |sample: [f64; 2]| match &distortion {
        Some(distortion) => specimen_from_grid.apply(distortion.ideal(sample)),
        None => specimen_from_grid.apply(sample),
    };
    let mut lo = [f64::INFINITY; 2];
    let mut hi = [f64::NEG_INFINITY; 2];
    for on_border in grid.border(distortion.is_some()) {
        let s = looks_at(on_border);
        for i in 0..2 {
            lo[i] = lo[i].min(s[i]);
            hi[i] = hi[i].max(s[i]);
        }
    }
    // The coarsest level that still gives two samples per grid step.
    let finest = scene.specimen.finest_um();
    let level = (0..scene.specimen.levels())
        .rev()
        .find(|&l| finest * (1u64 << l.min(62)) as f64 <= 0.5 * pitch_um);
    let patch = scene
        .specimen
        .patch(level.unwrap_or(0), [lo[0], hi[0]], [lo[1], hi[1]], 3)?;
    let patch_from_grid = specimen_from_grid.then(&Affine([
        [1.0 / patch.spacing_um, 0.0, -patch.x0_um / patch.spacing_um],
        [0.0, -1.0 / patch.spacing_um, patch.y0_um / patch.spacing_um],
    ]));
    let count = grid.width * grid.height;
    let mut planes: Planes = std::array::from_fn(|_| vec![0.0f32; count]);
    let [red, green, blue] = &mut planes;
    let stain = scene.effects.stain();
    red.par_chunks_mut(grid.width)
        .zip(green.par_chunks_mut(grid.width))
        .zip(blue.par_chunks_mut(grid.width))
        .enumerate()
        .for_each(|(y, ((red, green), blue))| {
            let lies = (&patch_from_grid, distortion.as_ref());
            if level.is_some() {
                average_row(&patch, lies, y as f64, [red, green, blue]);
            } else {
                cubic_row(&patch, lies, y as f64, [red, green, blue]);
            }
            if stain.is_none() && scene.effects.covers.is_empty() {
                return;
            }
            for x in 0..red.len() {
                let mut rgb = [red[x], green[x], blue[x]];
                if let Some(stain) = &stain {
                    rgb = restained(rgb, stain);
                }
                let s = looks_at([x as f64, y as f64]);
                for cover in &scene.effects.covers {
                    rgb = covered(rgb, cover, s, pitch_um);
                }
                [red[x], green[x], blue[x]] = rgb;
            }
        });
    Ok(planes)
}

/// Fractional bits of a fixed-point place in the patch.
const FRACTION: u32 = 32;

fn fixed(v: f64) -> i64 {
    (v * (1u64 << FRACTION) as f64).round() as i64
}

/// Red, green and blue bytes, each in its own 21 bits of a word.
fn lanes(bytes: u64) -> u64 {
    (bytes & 0xff) | ((bytes & 0xff00) << 13) | ((bytes & 0xff_0000) << 26)
}

/// How the grid lies on the patch: by an affine map, after the distortion is taken back.
type Lies<'a> = (&'a Affine, Option<&'a Distortion>);

/// The four quarters of a grid cell, each read bilinearly.
///
/// All three channels travel in one word: 16 taps with weights that sum to 1024 need 18 bits of the 21. Weights have 8
/// bits, rounded so that the place they stand for is right to 1/512 of a sample; of the samples there are two or more
/// to a pixel.
fn average_row(
    patch: &Patch,
    (patch_from_grid, distortion): Lies,
    y: f64,
    [red, green, blue]: [&mut [f32]; 3],
) {
    let m = &patch_from_grid.0;
    let quarters =
        [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]].map(|q: [f64; 2]| {
            [
                fixed(m[0][0] * q[0] + m[0][1] * q[1]),
                fixed(m[1][0] * q[0] + m[1][1] * q[1]),
            ]
        });
    let start = patch_from_grid.apply([0.0, y]);
    // Half a weight step, so that cutting the fraction off rounds it.
    let half = 1i64 << (FRACTION - 9);
    let mut at = [fixed(start[0]) + half, fixed(start[1]) + half];
    let step = [fixed(m[0][0]), fixed(m[1][0])];
    // Taps are read as eight bytes, two more than needed: stay clear of the last column.
    let last = [
        ((patch.width as i64 - 3) << FRACTION) - 1,
        ((patch.height as i64 - 1) << FRACTION) - 1,
    ];
    let stride = 3 * patch.width;
    let tap = |from: usize| -> u64 {
        patch.rgb[from..]
            .first_chunk::<8>()
            .map_or(0, |b| u64::from_le_bytes(*b))
    };
    const SCALE: f32 = 1.0 / (1024.0 * 255.0);
    const LANE: u64 = (1 << 21) - 1;
    for (x, ((red, green), blue)) in red.iter_mut().zip(green).zip(blue).enumerate() {
        if let Some(distortion) = distortion {
            let here = patch_from_grid.apply(distortion.ideal([x as f64, y]));
            at = here.map(|v| fixed(v) + half);
        }
        let mut sum = 0u64;
        for q in &quarters {
            let u = (at[0] + q[0]).clamp(0, last[0]);
            let v = (at[1] + q[1]).clamp(0, last[1]);
            let from = (v >> FRACTION) as usize * stride + 3 * (u >> FRACTION) as usize;
            let fu = (u as u64 >> (FRACTION - 8)) & 0xff;
            let fv = (v as u64 >> (FRACTION - 8)) & 0xff;
            let (upper, lower) = (tap(from), tap(from + stride));
            let w11 = (fu * fv) >> 8;
            sum += lanes(upper) * (256 + w11 - fu - fv)
                + lanes(upper >> 24) * (fu - w11)
                + lanes(lower) * (fv - w11)
                + lanes(lower >> 24) * w11;
        }
        *red = (sum & LANE) as u32 as f32 * SCALE;
        *green = ((sum >> 21) & LANE) as u32 as f32 * SCALE;
        *blue = (sum >> 42) as u32 as f32 * SCALE;
        at[0] += step[0];
        at[1] += step[1];
    }
}

/// One Catmull-Rom tap per grid cell, for specimens coarser than the image.
fn cubic_row(
    patch: &Patch,
    (patch_from_grid, distortion): Lies,
    y: f64,
    [red, green, blue]: [&mut [f32]; 3],
) {
    let last = [(patch.width - 3) as f64, (patch.height - 3) as f64].map(|v| v + 0.999);
    let stride = 3 * patch.width;
    for x in 0..red.len() {
        let sample = [x as f64, y];
        let at = patch_from_grid.apply(distortion.map_or(sample, |d| d.ideal(sample)));
        let (u, v) = (at[0].clamp(1.0, last[0]), at[1].clamp(1.0, last[1]));
        let (iu, iv) = (u as i32, v as i32);
        let wu = catmull_rom((u - f64::from(iu)) as f32);
        let wv = catmull_rom((v - f64::from(iv)) as f32);
        let mut columns = [0.0f32; 12];
        let mut from = (iv as usize - 1) * stride + 3 * (iu as usize - 1);
        for wy in wv {
            if let Some(taps) = patch.rgb[from..].first_chunk::<12>() {
                for (column, &tap) in columns.iter_mut().zip(taps) {
                    *column += wy * f32::from(tap);
                }
            }
            from += stride;
        }
        let of = |c: usize| {
            let v = wu[0] * columns[c]
                + wu[1] * columns[c + 3]
                + wu[2] * columns[c + 6]
                + wu[3] * columns[c + 9];
            (v * (1.0 / 255.0)).clamp(0.0, 1.0)
        };
        (red[x], green[x], blue[x]) = (of(0), of(1), of(2));
    }
}

fn catmull_rom(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t + 2.0 * t2 - t3),
        0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
        0.5 * (t + 4.0 * t2 - 3.0 * t3),
        0.5 * (t3 - t2),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_weights_interpolate_and_sum_to_one() {
        assert_eq!(catmull_rom(0.0), [0.0, 1.0, 0.0, 0.0]);
        for t in [0.1, 0.5, 0.9] {
            let w = catmull_rom(t);
            assert!((w.iter().sum::<f32>() - 1.0).abs() < 1e-6);
            // Reproduces straight lines.
            assert!((-w[0] + w[2] + 2.0 * w[3] - t).abs() < 1e-6);
        }
    }

    #[test]
    fn coarse_grids_come_back_to_the_same_pixels() {
        for step in [1usize, 2, 8] {
            let grid = Grid::new(50, 37, step, 4);
            let p = grid.pixel_from_grid();
            let plane: Vec<f32> = (0..grid.width * grid.height)
                .map(|i| p.apply([(i % grid.width) as f64, (i / grid.width) as f64]))
                .map(|q| (q[0] + 100.0 * q[1]) as f32)
                .collect();
            for (i, v) in grid.to_pixels(&plane).into_iter().enumerate() {
                let expected = (i % 50) as f32 + 100.0 * (i / 50) as f32;
                assert!((v - expected).abs() < 0.01, "{step} {i}: {v}");
            }
        }
    }
}
