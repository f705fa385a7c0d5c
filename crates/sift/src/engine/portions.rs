//! Portions of extrema, oriented and described on all threads.

use rayon::prelude::*;

use super::frames::keypoint;
use super::levels::first_layer;
use super::ranking::{by_rank, rank_again, walk};
use super::workspace::{Portion, Setting, Workspace};
use crate::describe::{Patch, describe};
use crate::detect::Extremum;
use crate::orient::orientations;
use crate::scale_space::Plane;
use crate::simd::at_level;
use crate::{Features, GrayImage, Keypoint};

/// Extrema that a thread orients and describes in one go.
pub(super) const PORTION: usize = 16;

impl Setting<'_> {
    /// Whether a keypoint may have been found in an image in which so many octaves are searched.
    pub(super) fn is_ours(&self, k: &Keypoint, image: &GrayImage, octaves: usize) -> bool {
        let (first, layer) = (self.options.first_octave, k.layer as usize);
        let index = i64::from(k.octave) - i64::from(first);
        let sigma = (k.octave as f32).exp2() * self.options.sigma_at(k.layer as f32);
        (0..octaves as i64).contains(&index)
            && (first_layer(index as usize)..self.options.intervals).contains(&layer)
            && (0.5 * sigma..=2.0 * sigma).contains(&k.sigma)
            && k.lies_in(image.width(), image.height())
    }

    /// The first `max_features` keypoints of the extrema found, with their descriptors if wanted, into `features`.
    pub(super) fn oriented(&self, work: &mut Workspace, described: bool, features: &mut Features) {
        let Workspace {
            octaves,
            found,
            ahead: (ahead, done),
            portions,
            ..
        } = work;
        let wanted = self.options.max_features;
        let Features {
            keypoints,
            descriptors,
            ..
        } = features;
        // What is done already comes with the first extrema.
        let mut is_done = vec![false; found.len()];
        let mut begun = rank_again(ahead, done, found, &mut is_done);
        let mut done = &done[..];
        // Keypoints that so many extrema have: at first a guess, then what was seen.
        let (mut made_of, mut made_are) = (3, 4);
        let mut begin = 0;
        while begin < found.len() && keypoints.len() < wanted {
            let missing = wanted - keypoints.len();
            let count = (missing.saturating_mul(made_of) / made_are).max(2 * PORTION);
            let end = begin.saturating_add(count).max(begun).min(found.len());
            let ranks = (begin..end).filter(|&rank| !is_done[rank]);
            self.fill_all(octaves, portions, found, ranks, described);
            let made: Vec<&Portion> = done.iter().chain(portions.iter()).collect();
            let mut order = by_rank(&made, begin..end);
            (made_of, made_are) = (made_of + end - begin, made_are + order.len());
            order.truncate(missing);
            keypoints.reserve_exact(order.len());
            keypoints.extend(order.iter().map(|&(p, i)| made[p].keypoints[i].1));
            if described {
                descriptors.reserve_exact(order.len());
                descriptors.extend(order.iter().map(|&(p, i)| made[p].descriptors[i]));
            }
            (begin, begun, done) = (end, 0, &[]);
        }
    }

    /// Orients the extrema `found[ranks]`, and describes them if wanted, on all threads.
    pub(super) fn fill_all(
        &self,
        octaves: &[Vec<Plane>],
        portions: &mut Vec<Portion>,
        found: &[Extremum],
        ranks: impl Iterator<Item = usize>,
        described: bool,
    ) {
        let walk = walk(found, ranks);
        let parts = walk.par_chunks(PORTION);
        let count = portions.len().max(parts.len());
        portions.resize_with(count, Portion::default);
        portions.iter_mut().for_each(Portion::clear);
        (portions.par_iter_mut().zip(parts))
            .for_each(|(portion, ranks)| self.fill(octaves, portion, found, ranks, described));
    }

    /// Orients the extrema `found[ranks]`, and describes them if wanted.
    fn fill(
        &self,
        octaves: &[Vec<Plane>],
        portion: &mut Portion,
        found: &[Extremum],
        ranks: &[usize],
        described: bool,
    ) {
        let mut patch = Patch::new();
        for &rank in ranks {
            let e = &found[rank];
            let (plane, place) = self.place_of(octaves, e);
            at_level!(self.simd, s => for &angle in orientations(s, plane, place).iter() {
                portion.keypoints.push((rank, keypoint(e, angle)));
                if described {
                    let descriptor =
                        describe(s, self.weights, &mut patch, plane, place, angle);
                    portion.descriptors.push(descriptor);
                }
            });
        }
    }

    /// The Gaussian layer in which an extremum is oriented and described, the one after its own, with its position and sigma there.
    pub(super) fn place_of<'a>(
        &self,
        octaves: &'a [Vec<Plane>],
        e: &Extremum,
    ) -> (&'a Plane, [f32; 3]) {
        let octave = (e.octave - self.options.first_octave) as usize;
        let (plane, scale) = match e.layer {
            // Layer 1, made in the octave before.
            0 => (&octaves[octave - 1][self.options.intervals], 1.0),
            layer => {
                let plane = &octaves[octave][layer];
                (plane, 1.0 / plane.pitch as f32)
            }
        };
        (plane, [e.x, e.y, e.sigma].map(|v| scale * v))
    }
}
