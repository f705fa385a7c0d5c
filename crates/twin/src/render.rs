//! From the specimen to the light on the sensor: sampling, blur, blending over the exposure.

use crate::affine::Affine;
use crate::blur;
use crate::config::ObjectiveConfig;
use crate::optics::{HALO_WIDTH, View, channel_blur_um, depth_of_field_um, halo};
use crate::slide::{Effects, covered, restained};
use crate::specimen::{Patch, Specimen, SpecimenError};
use rayon::prelude::*;

/// Blur wider than this, in samples, is computed on a coarser grid.
const FINE_ENOUGH: f64 = 4.0;
/// No grid is coarser: its samples are averages of the specimen over tiles that would reach far beyond the view, um.
const COARSEST_UM: f64 = 10.0;
/// No blur is wider than this share of the image: beyond it every image is grey.
const WIDEST: f64 = 0.25;
/// No more than this share of the image is rendered around it.
const BORDER: f64 = 0.3;

/// What stays the same during one exposure.
pub(crate) struct Scene<'a> {
    pub(crate) specimen: &'a dyn Specimen,
    pub(crate) effects: &'a Effects,
    pub(crate) optics: &'a ObjectiveConfig,
    pub(crate) width: usize,
    pub(crate) height: usize,
}

/// Three planes (red, green, blue), 1 is white.
pub(crate) type Planes = [Vec<f32>; 3];

/// How many instants of an exposure are looked at, from the view at its start, middle and end: one for a resting
/// stage, five for a fast one. Also how far the image moves between two of them, px.
pub(crate) fn instants(views: &[View; 3], width: usize, height: usize) -> (usize, f64) {
    let corners = [
        [0.0, 0.0],
        [width as f64, 0.0],
        [0.0, height as f64],
        [width as f64, height as f64],
    ];
    let pitch = views[1].um_per_px();
    let way = |a: &View, b: &View| {
        corners
            .iter()
            .map(|&p| {
                let (s, q) = (
                    a.specimen_from_pixel.apply(p),
                    b.specimen_from_pixel.apply(p),
                );
                (s[0] - q[0]).hypot(s[1] - q[1]) / pitch
            })
            .fold(0.0, f64::max)
    };
    let moved = way(&views[0], &views[1]) + way(&views[1], &views[2]);
    let count = match moved {
        // A quarter of a pixel smears by 0.07 px: nobody sees it.
        m if m < 0.25 => 1,
        m if m < 2.0 => 3,
        _ => 5,
    };
    (count, moved / count as f64)
}

/// The light at one instant. `smear_px` is extra blur that hides the gaps between the instants of a fast move.
pub(crate) fn render(scene: &Scene, view: &View, smear_px: f64) -> Result<Planes, SpecimenError> {
    let (w, h) = (scene.width, scene.height);
    let pitch = view.um_per_px();
    let slices = focal_slices(scene, view);
    let widest = WIDEST * w.max(h) as f64;
    let sigma = |dz: f64, channel: usize| {
        (channel_blur_um(scene.optics, dz, channel) / pitch)
            .hypot(smear_px)
            .min(widest)
    };
    let all = || slices.iter().flat_map(|&dz| (0..3).map(move |c| (dz, c)));
    let narrow = all()
        .map(|(dz, c)| sigma(dz, c))
        .fold(f64::INFINITY, f64::min);
    let wide = all()
        .map(|(dz, c)| {
            let halo = if halo(scene.optics, dz) > 0.0 {
                HALO_WIDTH
            } else {
                1.0
            };
            halo * sigma(dz, c)
        })
        .fold(0.0, f64::max);
    let mut step = 1usize;
    while narrow / (2 * step) as f64 >= FINE_ENOUGH && (2 * step) as f64 * pitch <= COARSEST_UM {
        step *= 2;
    }
    // Farther out the border's value goes on; at such a blur nobody can tell, and the work stays bounded.
    let margin = (BORDER * w.max(h) as f64) as usize / step + 2;
    let grid = Grid::new(w, h, step, blur::reach(wide / step as f64).min(margin));
    let sharp = sample(scene, view, &grid, step as f64 * pitch)?;

    let blurred = |dz: f64| -> Planes {
        let mut planes = sharp.clone();
        let share = halo(scene.optics, dz) as f32;
        planes.par_iter_mut().enumerate().for_each(|(c, plane)| {
            let sigma = sigma(dz, c) / step as f64;
            blur::blur(plane, grid.width, sigma);
            if share > 0.005 {
                let mut around = plane.clone();
                blur::blur(
                    &mut around,
                    grid.width,
                    sigma * (HALO_WIDTH * HALO_WIDTH - 1.0).sqrt(),
                );
                for (v, a) in plane.iter_mut().zip(&around) {
                    *v += share * (a - *v);
                }
            }
        });
        planes
    };
    if let [dz] = slices[..] {
        let planes = blurred(dz);
        return Ok(planes.map(|p| grid.to_pixels(&p)));
    }
    // A tilted specimen: between two slices of focus, mix their images.
    let mut out: Planes = std::array::from_fn(|_| vec![0.0; w * h]);
    let gap = slices[1] - slices[0];
    let p0 = crate::optics::principal_point(w, h);
    for &dz in &slices {
        let planes = blurred(dz).map(|p| grid.to_pixels(&p));
        for (out, plane) in out.iter_mut().zip(&planes) {
            for (i, (o, v)) in out.iter_mut().zip(plane).enumerate() {
                let (x, y) = ((i % w) as f64 - p0[0], (i / w) as f64 - p0[1]);
                let here = view.defocus_um + view.slope_um[0] * x + view.slope_um[1] * y;
                *o += (1.0 - ((here - dz) / gap).abs()).max(0.0) as f32 * v;
            }
        }
    }
    Ok(out)
}

/// The defoci at which the image is computed: one for a level specimen, up to five across a tilted one.
fn focal_slices(scene: &Scene, view: &View) -> Vec<f64> {
    let reach = 0.5
        * (view.slope_um[0].abs() * scene.width as f64
            + view.slope_um[1].abs() * scene.height as f64);
    let dof = depth_of_field_um(scene.optics.numerical_aperture);
    if reach < 0.25 * dof {
        return vec![view.defocus_um];
    }
    let count = ((2.0 * reach / dof).ceil() as usize + 1).clamp(3, 5);
    (0..count)
        .map(|i| view.defocus_um + reach * (2.0 * i as f64 / (count - 1) as f64 - 1.0))
        .collect()
}

/// A grid of samples, `step` pixels apart, around the image. Sample i lies at pixel `(i - margin + 0.5) step - 0.5`.
struct Grid {
    step: usize,
    margin: usize,
    width: usize,
    height: usize,
    out: [usize; 2],
}

impl Grid {
    fn new(w: usize, h: usize, step: usize, reach: usize) -> Self {
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

    /// Back to pixels: a cut, or a bilinear enlargement of what is smooth anyway.
    fn to_pixels(&self, plane: &[f32]) -> Vec<f32> {
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
fn sample(scene: &Scene, view: &View, grid: &Grid, pitch_um: f64) -> Result<Planes, SpecimenError> {
    let specimen_from_grid = grid.pixel_from_grid().then(&view.specimen_from_pixel);
    let (gw, gh) = (grid.width as f64, grid.height as f64);
    let mut lo = [f64::INFINITY; 2];
    let mut hi = [f64::NEG_INFINITY; 2];
    for corner in [
        [-0.5, -0.5],
        [gw - 0.5, -0.5],
        [-0.5, gh - 0.5],
        [gw - 0.5, gh - 0.5],
    ] {
        let s = specimen_from_grid.apply(corner);
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
            if level.is_some() {
                average_row(&patch, &patch_from_grid, y as f64, [red, green, blue]);
            } else {
                cubic_row(&patch, &patch_from_grid, y as f64, [red, green, blue]);
            }
            if stain.is_none() && scene.effects.covers.is_empty() {
                return;
            }
            for x in 0..red.len() {
                let mut rgb = [red[x], green[x], blue[x]];
                if let Some(stain) = &stain {
                    rgb = restained(rgb, stain);
                }
                let s = specimen_from_grid.apply([x as f64, y as f64]);
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

/// The four quarters of a grid cell, each read bilinearly.
///
/// All three channels travel in one word: 16 taps with weights that sum to 1024 need 18 bits of the 21. Weights have 8
/// bits, rounded so that the place they stand for is right to 1/512 of a sample; of the samples there are two or more
/// to a pixel.
fn average_row(
    patch: &Patch,
    patch_from_grid: &Affine,
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
    for ((red, green), blue) in red.iter_mut().zip(green).zip(blue) {
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
fn cubic_row(patch: &Patch, patch_from_grid: &Affine, y: f64, [red, green, blue]: [&mut [f32]; 3]) {
    let last = [(patch.width - 3) as f64, (patch.height - 3) as f64].map(|v| v + 0.999);
    let stride = 3 * patch.width;
    for x in 0..red.len() {
        let at = patch_from_grid.apply([x as f64, y]);
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

/// The mean of several instants.
pub(crate) fn blend(instants: Vec<Planes>) -> Option<Planes> {
    let share = 1.0 / instants.len() as f32;
    let mut instants = instants.into_iter();
    let mut sum = instants.next()?;
    for planes in instants {
        for (s, p) in sum.iter_mut().zip(&planes) {
            for (s, v) in s.iter_mut().zip(p) {
                *s += v;
            }
        }
    }
    if share < 1.0 {
        for s in &mut sum {
            s.iter_mut().for_each(|v| *v *= share);
        }
    }
    Some(sum)
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
