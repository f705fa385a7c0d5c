//! Gaussian scale space (Lowe, IJCV 2004, section 3), one octave at a time, in one sweep over cache-sized tiles.
//!
//! Pixel grid: sample i of octave o lies at input coordinate `i * 2^o`, exactly. Doubling keeps every input pixel as an even
//! sample and puts averages between them, so `w` columns become `2 w - 1`; halving keeps the even samples. Nothing is shifted
//! by fractions of a pixel anywhere, and no correction is needed later. Borders are mirrored about the border pixel.
//!
//! A [`Chain`] is the list of blurs of an octave; [`Chain::sweep`] pushes the rows of a tile through all of them. Each level keeps
//! only the rows that the next blur and the visitor still need, in a ring, so that a tile of `TILE_WIDTH` columns stays in
//! the second cache. Levels that are wanted later are copied to whole planes on the way. Tiles overlap by what the kernels reach;
//! every value is computed by the same operations in whatever tile, so the result depends neither on tiles nor on threads.

mod chain;
#[cfg(test)]
pub(crate) mod oracle;
mod plan;
mod plane;
mod ring;
mod source;
mod sweep;

pub(crate) use chain::{Chain, Kept, LevelSource, WINDOW};
pub(crate) use plane::Plane;
pub(crate) use source::Source;
pub(crate) use sweep::{Levels, Scratch};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{GrayImage, Options, Sift, Simd};

    fn hash(w: usize, h: usize) -> GrayImage {
        GrayImage::from_fn(w, h, |x, y| ((x * 7919 + y * 104_729) % 101) as f32 / 101.0).unwrap()
    }

    /// Every layer that is kept, at every level, for sizes with every tail, tiles of more than one column, and all kinds of
    /// first octaves; bands by the number of threads.
    #[test]
    fn planes_are_those_of_the_definition() {
        for (w, h) in [
            (12, 12),
            (13, 40),
            (33, 31),
            (64, 48),
            (90, 77),
            (700, 24),
            (660, 150),
        ] {
            for first_octave in [-1, 0, 1] {
                let options = Options {
                    first_octave,
                    ..Options::default()
                };
                let image = hash(w, h);
                let expected = oracle::octaves(&image, &options, 2);
                for simd in Simd::available() {
                    for threads in [1, 3] {
                        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
                        let mut sift = Sift::with(options.clone(), simd).unwrap();
                        pool.build().unwrap().install(|| sift.detect(&image));
                        let planes = sift.planes();
                        for (octave, layers) in expected.iter().enumerate() {
                            let small = layers[0].width.min(layers[0].height) < 12;
                            for (layer, expected) in layers.iter().enumerate().take(3) {
                                if small || (octave == 0 && layer < 2) {
                                    continue;
                                }
                                // Layers 0 and 1 were made in the octave before, layer 2 is smooth.
                                let found = match layer {
                                    0 | 1 => &planes[octave - 1][options.intervals - 1 + layer],
                                    _ => &planes[octave][layer - 1],
                                };
                                assert_eq!(found.pitch, 2);
                                let expected = if layer == 2 {
                                    &expected.halved()
                                } else {
                                    expected
                                };
                                assert_eq!(
                                    (found.width, found.height),
                                    (expected.width, expected.height)
                                );
                                for (a, b) in found.data.iter().zip(&expected.data) {
                                    assert!(
                                        (f64::from(*a) - b).abs() < 2e-4,
                                        "{w} x {h} from {first_octave}: octave {octave}, layer {layer}: {a} {b}"
                                    );
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}
