//! The walk through the stages.

use rayon::prelude::*;

use crate::blur::{Doubling, Kernel};
use crate::contrast::Contrast;
use crate::describe::{Weights, describe};
use crate::descriptor::Descriptor;
use crate::detect::{Bar, Extremum, Scan, Scanner};
use crate::orient::{Orientations, orientations};
use crate::scale_space::{Chain, Kept, Make, Plane, Scratch, Source};
use crate::simd::at_level;
use crate::{Features, GrayImage, Keypoint, Options, SiftError, Simd};

/// Octaves smaller than this on either side are not searched: nothing would be left inside the detector's border.
const MIN_OCTAVE_SIZE: usize = 12;

/// Sigma in pixels from which every second pixel of every second row says enough.
const SMOOTH: f64 = 2.3;

/// Fewer rows than this are not worth a thread: its overlap with the neighbours would be most of the work.
const LEAST_ROWS: usize = 64;

/// Extrema that a thread orients and describes in one go.
const PORTION: usize = 16;

/// Detects and describes features: checked options, an instruction set, and buffers that are kept from image to image.
///
/// The result is the same on any number of threads.
///
/// Memory: about 13 floats per pixel of the image (3.5 without the doubled octave), and some rows per thread.
#[derive(Debug)]
pub struct Sift {
    options: Options,
    simd: Simd,
    weights: Weights,
    work: Workspace,
}

/// What is kept from image to image.
#[derive(Debug, Default)]
struct Workspace {
    /// Gaussian layers `0..=intervals` of each octave, the finest first: where keypoints are oriented and described.
    octaves: Vec<Vec<Plane>>,
    /// The image reduced to each octave before the first.
    reduced: Vec<Plane>,
    /// One for each band of rows that runs at the same time.
    scratch: Vec<Scratch>,
}

impl Sift {
    /// An engine at the best [`Level`](crate::Level) that this processor has.
    ///
    /// # Errors
    /// [`SiftError::Option`] when `options` fail their [check](Options::check).
    pub fn new(options: Options) -> Result<Self, SiftError> {
        Self::with(options, Simd::best())
    }

    /// An engine at a certain level.
    ///
    /// # Errors
    /// [`SiftError::Option`] when `options` fail their [check](Options::check).
    pub fn with(options: Options, simd: Simd) -> Result<Self, SiftError> {
        options.check()?;
        Ok(Self {
            options,
            simd,
            weights: Weights::new(),
            work: Workspace::default(),
        })
    }

    /// The options it was made with.
    #[must_use]
    pub fn options(&self) -> &Options {
        &self.options
    }

    /// The instruction set it uses.
    #[must_use]
    pub fn simd(&self) -> Simd {
        self.simd
    }

    /// Keypoints with their orientations, not described: what [`detect_and_describe`](Self::detect_and_describe) gives, without
    /// the descriptors.
    pub fn detect(&mut self, image: &GrayImage) -> Vec<Keypoint> {
        let found = self.extrema(image);
        let features = self.oriented(&found, |_, _| ());
        features
            .into_iter()
            .map(|(keypoint, ())| keypoint)
            .collect()
    }

    /// Detects, orients and describes the features of `image`: the `max_features` strongest, as strong as the extremum they
    /// belong to.
    ///
    /// An image without structure, or too small for the first octave (fewer than 12 pixels on a side after doubling), gives no
    /// features.
    pub fn detect_and_describe(&mut self, image: &GrayImage) -> Features {
        let found = self.extrema(image);
        let features = self.oriented(&found, |e, angle| self.describe(e, angle));
        let (keypoints, descriptors) = features.into_iter().unzip();
        Features {
            width: image.width(),
            height: image.height(),
            keypoints,
            descriptors,
        }
    }

    /// The first `max_features` keypoints of `found`, each with what `make` makes of it.
    fn oriented<T: Copy + Send>(
        &self,
        found: &[Extremum],
        make: impl Fn(&Extremum, f32) -> T + Sync,
    ) -> Vec<(Keypoint, T)> {
        let wanted = self.options.max_features;
        let mut features = Vec::with_capacity(wanted.min(2 * found.len()));
        let mut rest = found;
        while !rest.is_empty() && features.len() < wanted {
            // One in three or four has a second orientation. What is still missing then follows.
            let missing = wanted - features.len();
            let count = (missing - missing / 4).max(32).min(rest.len());
            let (now, later) = rest.split_at(count);
            rest = later;
            let made: Vec<Vec<(usize, Keypoint, T)>> = walk(now)
                .par_chunks(PORTION)
                .map(|portion| {
                    let mut made = Vec::with_capacity(2 * PORTION);
                    for &i in portion {
                        let e = &now[i];
                        for &angle in self.orientations(e).iter() {
                            made.push((i, keypoint(e, angle), make(e, angle)));
                        }
                    }
                    made
                })
                .collect();
            // Back into order of strength.
            let mut order: Vec<&(usize, Keypoint, T)> = made.iter().flatten().collect();
            order.sort_by_key(|(i, ..)| *i);
            features.extend(order.into_iter().map(|&(_, keypoint, t)| (keypoint, t)));
        }
        features.truncate(wanted);
        features
    }

    /// Gaussian layers by octave.
    #[cfg(test)]
    pub(crate) fn planes(&self) -> &[Vec<Plane>] {
        &self.work.octaves
    }

    /// The Gaussian layer in which an extremum is oriented and described, with its position and sigma there.
    fn place_of(&self, e: &Extremum) -> (&Plane, [f32; 3]) {
        let octave = (e.octave - self.options.first_octave) as usize;
        let (plane, scale) = if e.layer + 1 < self.options.intervals {
            let plane = &self.work.octaves[octave][e.layer + 1];
            (plane, 1.0 / plane.pitch as f32)
        } else {
            (&self.work.octaves[octave + 1][0], 0.5)
        };
        (plane, [e.x, e.y, e.sigma].map(|v| scale * v))
    }

    fn orientations(&self, e: &Extremum) -> Orientations {
        let (plane, [x, y, sigma]) = self.place_of(e);
        at_level!(self.simd, s => orientations(s, plane, x, y, sigma))
    }

    fn describe(&self, e: &Extremum, angle: f32) -> Descriptor {
        let (plane, [x, y, sigma]) = self.place_of(e);
        at_level!(self.simd, s => describe(s, &self.weights, plane, x, y, sigma, angle))
    }

    /// The strongest extrema in order of their strength; leaves the planes around them in the workspace.
    fn extrema(&mut self, image: &GrayImage) -> Vec<Extremum> {
        let Self {
            options,
            simd,
            work,
            ..
        } = self;
        let Some(contrast) = Contrast::of(image, options) else {
            return Vec::new();
        };
        let sigma = f64::from(options.sigma);
        let sigma_at = |s: usize| sigma * (s as f64 / options.intervals as f64).exp2();
        let between = |from: f64, to: f64| (to * to - from * from).sqrt();
        let blur = f64::from(options.assumed_blur);
        let first = options.first_octave;
        let big_enough = |(w, h): (usize, usize)| w.min(h) >= MIN_OCTAVE_SIZE;

        // Octaves that are not searched are only passed through.
        work.reduced
            .resize_with(first.max(0) as usize, Plane::default);
        for octave in 0..work.reduced.len() {
            let (before, from) = work.reduced.split_at_mut(octave);
            let source = before.last().map_or(Source::Image(image), Source::Whole);
            if !big_enough(source.size()) {
                return Vec::new();
            }
            let blurred = if octave == 0 { blur } else { sigma };
            let chain = Chain {
                size: source.size(),
                levels: vec![
                    Make::Taken(source),
                    Make::Blurred(Kernel::gaussian(between(blurred, 2.0 * sigma))),
                ],
                kept: vec![Kept {
                    level: 1,
                    halved: true,
                }],
            };
            run(
                *simd,
                &chain,
                vec![&mut from[0]],
                &mut work.scratch,
                None,
            );
        }

        let mut found: Vec<Extremum> = Vec::new();
        let mut bar = Bar::new(options.max_features, 0.0);
        for octave in 0.. {
            while work.octaves.len() < octave + 2 {
                work.octaves.push(vec![Plane::default(); options.intervals]);
            }
            let [before @ .., here, next] = &mut work.octaves[..octave + 2] else {
                unreachable!("two octaves at least");
            };
            let (layer_0, layers_after) = here.split_at_mut(1);
            let steps = (1..options.intervals + 2)
                .map(|s| Make::Blurred(Kernel::gaussian(between(sigma_at(s - 1), sigma_at(s)))));
            // With the level that is Gaussian layer 0.
            let (levels, base): (Vec<Make<'_>>, usize) = match (before.last(), work.reduced.last())
            {
                (Some(finer), _) => {
                    let finest = &finer[options.intervals - 1];
                    let finest = Make::Taken(match finest.pitch {
                        1 => Source::Halved(finest),
                        _ => Source::Whole(finest),
                    });
                    let taken = [finest, Make::Taken(Source::Whole(&layer_0[0]))].into_iter();
                    (taken.chain(steps).collect(), 1)
                }
                (None, Some(plane)) => {
                    let taken = std::iter::once(Make::Taken(Source::Whole(plane)));
                    (taken.chain(steps).collect(), 0)
                }
                (None, None) if first == 0 => {
                    let blurred = Make::Blurred(Kernel::gaussian(between(blur, sigma)));
                    let taken = [Make::Taken(Source::Image(image)), blurred].into_iter();
                    (taken.chain(steps).collect(), 1)
                }
                (None, None) => {
                    let doubled = (0..options.intervals + 2).map(|s| {
                        Make::Doubled(Doubling::gaussian(between(2.0 * blur, sigma_at(s))))
                    });
                    let taken = std::iter::once(Make::Taken(Source::Image(image)));
                    (taken.chain(doubled).collect(), 1)
                }
            };
            let size = match (&levels[0], &levels[1]) {
                (Make::Taken(source), Make::Doubled(_)) => {
                    let (w, h) = source.size();
                    (2 * w - 1, 2 * h - 1)
                }
                (Make::Taken(source), _) => source.size(),
                _ => unreachable!("the first level of a chain is taken from a source"),
            };
            if !big_enough(size) {
                break;
            }
            let layers = usize::from(octave == 0)..options.intervals;
            let index = first + octave as i32;
            let thresholds: Vec<f32> = (0..options.intervals)
                .map(|layer| contrast.threshold(options, index, layer))
                .collect();
            let scan = Scan {
                options,
                thresholds: &thresholds,
                octave: index,
                base,
                layers,
                weakest: bar.raise(),
            };
            let chain = Chain {
                levels,
                size,
                kept: (1 + usize::from(octave == 0)..=options.intervals)
                    .map(|layer| Kept {
                        level: base + layer,
                        halved: layer == options.intervals || sigma_at(layer) >= SMOOTH,
                    })
                    .collect(),
            };
            let planes: Vec<&mut Plane> = layers_after.iter_mut().skip(usize::from(octave == 0)).chain([&mut next[0]]).collect();
            let mut new = run(
                *simd,
                &chain,
                planes,
                &mut work.scratch,
                Some(&scan),
            );
            // Two samples may lead to the same extremum.
            new.sort_unstable_by_key(|e| (e.layer, e.sample.1, e.sample.0));
            new.dedup_by_key(|e| (e.layer, e.sample));
            new.iter().for_each(|e| bar.see(e.response));
            found.append(&mut new);
        }
        if found.len() > options.max_features {
            found.select_nth_unstable_by(options.max_features, Extremum::rank);
            found.truncate(options.max_features);
        }
        found.sort_unstable_by(Extremum::rank);
        found
    }
}

/// Neighbours in the image one after the other, which is kinder to the caches than order of strength.
fn walk(found: &[Extremum]) -> Vec<usize> {
    let mut walk: Vec<usize> = (0..found.len()).collect();
    walk.sort_unstable_by_key(|&i| {
        (
            found[i].octave,
            found[i].layer,
            found[i].y as u32 / 32,
            found[i].x as u32,
        )
    });
    walk
}

/// Makes the levels of `chain`, band by band on all threads, with what is kept of them in `planes`, and looks for extrema on the
/// way.
fn run(
    simd: Simd,
    chain: &Chain<'_>,
    planes: Vec<&mut Plane>,
    scratch: &mut Vec<Scratch>,
    scan: Option<&Scan<'_>>,
) -> Vec<Extremum> {
    let (w, h) = chain.size;
    let bands = rayon::current_num_threads().min(h / LEAST_ROWS).max(1);
    let band = h.div_ceil(bands).next_multiple_of(2);
    let mut parts: Vec<Vec<&mut [f32]>> = Vec::new();
    parts.resize_with(h.div_ceil(band), Vec::new);
    for (plane, kept) in planes.into_iter().zip(&chain.kept) {
        plane.resize(kept.count(w), kept.count(h));
        plane.pitch = if kept.halved { 2 } else { 1 };
        let rows = plane.data.chunks_mut(kept.count(band) * kept.count(w));
        for (part, rows) in parts.iter_mut().zip(rows) {
            part.push(rows);
        }
    }
    if scratch.len() < parts.len() {
        scratch.resize_with(parts.len(), Scratch::default);
    }
    let found: Vec<Vec<Extremum>> = parts
        .into_par_iter()
        .zip(scratch)
        .enumerate()
        .map(|(i, (mut planes, scratch))| {
            let rows = i * band..((i + 1) * band).min(h);
            let mut scanner = scan.map(Scanner::new);
            for columns in Chain::tiles(w) {
                if let Some(scanner) = &mut scanner {
                    scanner.begin(rows.start);
                }
                at_level!(simd, s => chain.sweep(
                    s,
                    rows.clone(),
                    columns,
                    scratch,
                    &mut planes,
                    #[inline(always)]
                    |levels, memory, y| {
                        if let Some(scanner) = &mut scanner {
                            scanner.visit(s, levels, memory, y);
                        }
                    },
                ));
            }
            scanner.map_or_else(Vec::new, |s| s.found)
        })
        .collect();
    found.concat()
}

/// One image with an engine of its own: [`Sift::new`], then [`Sift::detect_and_describe`]. For many images keep a [`Sift`].
///
/// # Errors
/// [`SiftError::Option`] when `options` fail their [check](Options::check).
pub fn detect_and_describe(image: &GrayImage, options: &Options) -> Result<Features, SiftError> {
    Ok(Sift::new(options.clone())?.detect_and_describe(image))
}

/// From the frame of the octave to that of the image.
fn keypoint(e: &Extremum, angle: f32) -> Keypoint {
    let pixel = (e.octave as f32).exp2();
    Keypoint {
        x: e.x * pixel,
        y: e.y * pixel,
        sigma: e.sigma * pixel,
        angle,
        response: e.response,
        octave: e.octave,
        layer: e.layer as u32,
    }
}
