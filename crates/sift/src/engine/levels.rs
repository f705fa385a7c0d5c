//! The levels that each octave is made of, and their sigmas.

use crate::blur::{Doubling, Kernel};
use crate::scale_space::{LevelSource, Plane, Source};
use crate::{GrayImage, Options};

/// Gaussian sigma of a layer in pixels of its octave.
pub(super) fn sigma_at(options: &Options, layer: usize) -> f64 {
    f64::from(options.sigma) * (layer as f64 / options.intervals as f64).exp2()
}

/// What blurs from one sigma to another.
pub(super) fn between(from: f64, to: f64) -> f64 {
    (to * to - from * from).sqrt()
}

/// The first layer of an octave that is searched: the first octave has nothing finer to compare layer 0 with.
pub(super) fn first_layer(octave: usize) -> usize {
    usize::from(octave == 0)
}

/// The Gaussian layers of an octave of which the first are planes, each of the others from the one before.
pub(super) fn layers_from<'a>(
    options: &Options,
    first: &'a [Plane],
) -> impl Iterator<Item = LevelSource<'a>> {
    let taken = first
        .iter()
        .map(|plane| LevelSource::Taken(Source::Whole(plane)));
    let blurred = (first.len().max(1)..options.intervals + 2).map(|s| {
        let sigma = between(sigma_at(options, s - 1), sigma_at(options, s));
        LevelSource::Blurred(Kernel::gaussian(sigma))
    });
    taken.chain(blurred)
}

/// The levels of the first octave, made from the image: that, then the layers.
pub(super) fn first_levels<'a>(options: &Options, image: &'a GrayImage) -> Vec<LevelSource<'a>> {
    let blur = f64::from(options.assumed_blur);
    let mut levels = vec![LevelSource::Taken(Source::Image(image))];
    if options.first_octave < 0 {
        levels.extend((0..options.intervals + 2).map(|s| {
            LevelSource::Doubled(Doubling::gaussian(between(
                2.0 * blur,
                sigma_at(options, s),
            )))
        }));
    } else {
        let sigma = between(blur, sigma_at(options, 0));
        levels.push(LevelSource::Blurred(Kernel::gaussian(sigma)));
        levels.extend(layers_from(options, &[]));
    }
    levels
}

/// The levels of an octave after the first: the layer of the finer octave before those that both have, then its own.
pub(super) fn further_levels<'a>(options: &Options, finer: &'a [Plane]) -> Vec<LevelSource<'a>> {
    let [.., before, _, _] = finer else {
        unreachable!("an octave has two intervals at least");
    };
    let mut levels = vec![LevelSource::Taken(match before.pitch {
        1 => Source::Halved(before),
        _ => Source::Whole(before),
    })];
    levels.extend(layers_from(options, &finer[finer.len() - 2..]));
    levels
}
