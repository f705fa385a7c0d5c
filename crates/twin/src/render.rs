//! From the specimen to the light on the sensor: sampling, blur, blending over the exposure.

use crate::blur;
use crate::optics::{HALO_WIDTH, View, channel_blur_um, depth_of_field_um, halo};
use crate::sampling::{Grid, sample};
use crate::scene::{Planes, Scene};
use crate::specimen::SpecimenError;
use rayon::prelude::*;

/// Blur wider than this, in samples, is computed on a coarser grid.
const FINE_ENOUGH: f64 = 4.0;
/// No grid is coarser: its samples are averages of the specimen over tiles that would reach far beyond the view, um.
const COARSEST_UM: f64 = 10.0;
/// No blur is wider than this share of the image: beyond it every image is grey.
const WIDEST: f64 = 0.25;
/// No more than this share of the image is rendered around it.
const BORDER: f64 = 0.3;

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

/// Up to so much of the depth of field the defocus of a corner is that of the middle.
const LEVEL: f64 = 0.06;
/// A tilted specimen is computed at so many defoci, at most.
const SLICES: usize = 9;

/// The defoci at which the image is computed: one for a level specimen, and across a tilted one so many that two are no farther apart than the
/// depth of field, as far as there are that many.
fn focal_slices(scene: &Scene, view: &View) -> Vec<f64> {
    let reach = 0.5
        * (view.slope_um[0].abs() * scene.width as f64
            + view.slope_um[1].abs() * scene.height as f64);
    let dof = depth_of_field_um(scene.optics.numerical_aperture);
    if reach < LEVEL * dof {
        return vec![view.defocus_um];
    }
    let count = ((2.0 * reach / dof).ceil() as usize + 1).clamp(3, SLICES);
    (0..count)
        .map(|i| view.defocus_um + reach * (2.0 * i as f64 / (count - 1) as f64 - 1.0))
        .collect()
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
