//! The walk through the stages.

use rayon::prelude::*;

use crate::blur::{Doubling, Kernel};
use crate::contrast::Contrast;
use crate::describe::{Patch, Weights, describe};
use crate::descriptor::Descriptor;
use crate::detect::{Bar, Extremum, Scan, Scanner};
use crate::orient::orientations;
use crate::scale_space::{Chain, Kept, Make, Plane, Scratch, Source};
use crate::simd::at_level;
use crate::{Features, GrayImage, Keypoint, Options, SiftError, Simd};

/// Octaves smaller than this on either side are not searched: nothing would be left inside the detector's border.
const MIN_OCTAVE_SIZE: usize = 12;

/// Sigma in pixels from which every second pixel of every second row says enough to orient and describe by: bilinear samples of a
/// plane with a sigma of 1.0 instead of 1.27 cost one inlier in twenty.
const SMOOTH: f64 = 2.3;

/// Fewer rows than this are not worth a thread: its overlap with the neighbours would be most of the work.
const LEAST_ROWS: usize = 64;

/// Extrema that a thread orients and describes in one go.
const PORTION: usize = 16;

/// Detects and describes features: checked options, an instruction set, and buffers that are kept from image to image.
///
/// The result is the same on any number of threads.
///
/// Memory: about four floats per pixel of the image (one without the doubled octave), and some rows per thread.
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
    /// Gaussian layers `0..intervals` of each octave, the finest first: where keypoints are oriented and described. Layer 0
    /// of the first octave is left out.
    octaves: Vec<Vec<Plane>>,
    /// The image reduced to each octave before the first.
    reduced: Vec<Plane>,
    /// One for each band of rows that runs at the same time.
    bands: Vec<Band>,
    bar: Bar,
    found: Vec<Extremum>,
    portions: Vec<Portion>,
}

/// What a thread needs to make its rows of an octave.
#[derive(Debug, Default)]
struct Band {
    scratch: Scratch,
    scanner: Scanner,
}

/// What a thread makes of some extrema, with the rank of the extremum.
#[derive(Debug, Default)]
struct Portion {
    keypoints: Vec<(usize, Keypoint)>,
    descriptors: Vec<Descriptor>,
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
        rayon::scope(|_| {
            self.extrema(image);
            self.oriented(false).0
        })
    }

    /// Detects, orients and describes the features of `image`: the `max_features` strongest, as strong as the extremum they
    /// belong to.
    ///
    /// An image without structure, or too small for the first octave (fewer than 12 pixels on a side after doubling), gives no
    /// features.
    pub fn detect_and_describe(&mut self, image: &GrayImage) -> Features {
        // All stages on the threads of the pool, with one way there and back.
        let (keypoints, descriptors) = rayon::scope(|_| {
            self.extrema(image);
            self.oriented(true)
        });
        Features {
            width: image.width(),
            height: image.height(),
            keypoints,
            descriptors,
        }
    }

    /// Describes places that are known already: those of another frame, or some of an image's own. `descriptors[i]` belongs to
    /// `keypoints[i]`, which may be as many as one likes; `max_features` does not matter, and nothing is searched.
    ///
    /// For all keypoints of [`detect`](Self::detect), the result is that of [`detect_and_describe`](Self::detect_and_describe).
    ///
    /// # Errors
    /// [`SiftError::ForeignKeypoint`] for one outside the image, with an octave or layer that is not searched in it, with a sigma that
    /// is not half to twice that of its layer, or with an angle that is not finite.
    pub fn describe(
        &mut self,
        image: &GrayImage,
        keypoints: &[Keypoint],
    ) -> Result<Vec<Descriptor>, SiftError> {
        rayon::scope(|_| {
            let octaves = self.scale_space(image, None);
            let is_ours = |k: &Keypoint| self.is_ours(k, image, octaves);
            if let Some(index) = keypoints.iter().position(|k| !is_ours(k)) {
                return Err(SiftError::ForeignKeypoint { index });
            }
            let places: Vec<Extremum> = keypoints.iter().map(extremum).collect();
            let walk = walk(&places);
            let described: Vec<Vec<Descriptor>> = (walk.par_chunks(PORTION))
                .map_init(Patch::new, |patch, portion| {
                    let mut described = Vec::with_capacity(portion.len());
                    for &i in portion {
                        let (plane, place) = self.place_of(&places[i]);
                        let angle = keypoints[i].angle;
                        described.push(at_level!(self.simd, s => {
                            describe(s, &self.weights, patch, plane, place, angle)
                        }));
                    }
                    described
                })
                .collect();
            let mut descriptors = vec![Descriptor::ZERO; keypoints.len()];
            for (&i, descriptor) in walk.iter().zip(described.iter().flatten()) {
                descriptors[i] = *descriptor;
            }
            Ok(descriptors)
        })
    }

    /// Whether a keypoint may have been found in an image in which so many octaves are searched.
    fn is_ours(&self, k: &Keypoint, image: &GrayImage, octaves: usize) -> bool {
        let inside = |v: f32, size: usize| (-0.5..=size as f32 - 0.5).contains(&v);
        let (first, layer) = (self.options.first_octave, k.layer as usize);
        let index = i64::from(k.octave) - i64::from(first);
        let sigma = (k.octave as f32).exp2() * self.options.sigma_at(k.layer as f32);
        (0..octaves as i64).contains(&index)
            && (first_layer(index as usize)..self.options.intervals).contains(&layer)
            && inside(k.x, image.width())
            && inside(k.y, image.height())
            && (0.5 * sigma..=2.0 * sigma).contains(&k.sigma)
            && k.angle.is_finite()
    }

    /// The first `max_features` keypoints of the extrema found, with their descriptors if wanted.
    fn oriented(&mut self, described: bool) -> (Vec<Keypoint>, Vec<Descriptor>) {
        let mut portions = std::mem::take(&mut self.work.portions);
        let wanted = self.options.max_features;
        let mut rest = &self.work.found[..];
        let (mut keypoints, mut descriptors) = (Vec::new(), Vec::new());
        // Keypoints that so many extrema have: at first a guess, then what was seen.
        let (mut made_of, mut made_are) = (3, 4);
        while !rest.is_empty() && keypoints.len() < wanted {
            let missing = wanted - keypoints.len();
            let count = (missing.saturating_mul(made_of) / made_are)
                .max(2 * PORTION)
                .min(rest.len());
            let (now, later) = rest.split_at(count);
            rest = later;
            let walk = walk(now);
            let parts = walk.chunks(PORTION);
            if portions.len() < parts.len() {
                portions.resize_with(parts.len(), Portion::default);
            }
            let made = &mut portions[..parts.len()];
            made.par_iter_mut()
                .zip(walk.par_chunks(PORTION))
                .for_each(|(portion, ranks)| self.fill(portion, now, ranks, described));
            let mut order = by_rank(made, count);
            (made_of, made_are) = (made_of + count, made_are + order.len());
            order.truncate(missing);
            keypoints.reserve_exact(order.len());
            keypoints.extend(order.iter().map(|&(p, i)| made[p].keypoints[i].1));
            if described {
                descriptors.reserve_exact(order.len());
                descriptors.extend(order.iter().map(|&(p, i)| made[p].descriptors[i]));
            }
        }
        self.work.portions = portions;
        (keypoints, descriptors)
    }

    /// Orients the extrema `found[ranks]`, and describes them if wanted.
    fn fill(&self, portion: &mut Portion, found: &[Extremum], ranks: &[usize], described: bool) {
        portion.keypoints.clear();
        portion.descriptors.clear();
        let mut patch = Patch::new();
        for &rank in ranks {
            let e = &found[rank];
            let (plane, place) = self.place_of(e);
            at_level!(self.simd, s => for &angle in orientations(s, plane, place).iter() {
                portion.keypoints.push((rank, keypoint(e, angle)));
                if described {
                    let descriptor =
                        describe(s, &self.weights, &mut patch, plane, place, angle);
                    portion.descriptors.push(descriptor);
                }
            });
        }
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

    /// The strongest extrema in order of their strength, and the planes around them, into the workspace.
    fn extrema(&mut self, image: &GrayImage) {
        self.work.found.clear();
        let Some(contrast) = Contrast::of(image, &self.options) else {
            return;
        };
        self.work.bar.begin(self.options.max_features, 0.0);
        self.scale_space(image, Some(&contrast));
        choose(&mut self.work.found, self.options.max_features);
    }

    /// The planes of all octaves into the workspace, and with `contrast` the extrema that are found on the way. Returns the number of
    /// octaves.
    fn scale_space(&mut self, image: &GrayImage, contrast: Option<&Contrast>) -> usize {
        let Self {
            options,
            simd,
            work,
            ..
        } = self;
        if !reduce(*simd, options, image, &mut work.reduced, &mut work.bands) {
            return 0;
        }
        let mut octave = 0;
        loop {
            while work.octaves.len() < octave + 2 {
                work.octaves.push(vec![Plane::default(); options.intervals]);
            }
            let [before @ .., here, next] = &mut work.octaves[..octave + 2] else {
                unreachable!("two octaves at least");
            };
            let (layer_0, layers_after) = here.split_at_mut(1);
            let (levels, base) = match (before.last(), work.reduced.last()) {
                (Some(finer), _) => (further_levels(options, finer, &layer_0[0]), 1),
                (None, Some(reduced)) => (blurred_levels(options, reduced), 0),
                (None, None) => (first_levels(options, image), 1),
            };
            // Layer 1 of the first octave is needed only when it is the last one, which the next octave begins with.
            let first_kept = if octave == 0 {
                2.min(options.intervals - 1)
            } else {
                1
            };
            let chain = Chain::new(
                levels,
                (first_kept..=options.intervals)
                    .map(|layer| Kept {
                        level: base + layer,
                        halved: layer == options.intervals || sigma_at(options, layer) >= SMOOTH,
                    })
                    .collect(),
            );
            if !is_big_enough(chain.size) {
                return octave;
            }
            let index = options.first_octave + octave as i32;
            let scan = contrast.map(|contrast| Scan {
                options,
                thresholds: (0..options.intervals)
                    .map(|layer| contrast.threshold(options, index, layer))
                    .collect(),
                octave: index,
                base,
                layers: first_layer(octave)..options.intervals,
                weakest: work.bar.raise(),
            });
            let planes = (layers_after[first_kept - 1..].iter_mut())
                .chain([&mut next[0]])
                .collect();
            let bands = run(*simd, &chain, planes, &mut work.bands, scan.as_ref());
            if scan.is_some() {
                gather(bands, &mut work.found, &mut work.bar);
            }
            octave += 1;
        }
    }
}

/// Gaussian sigma of a layer in pixels of its octave.
fn sigma_at(options: &Options, layer: usize) -> f64 {
    f64::from(options.sigma) * (layer as f64 / options.intervals as f64).exp2()
}

/// What blurs from one sigma to another.
fn between(from: f64, to: f64) -> f64 {
    (to * to - from * from).sqrt()
}

/// The first layer of an octave that is searched: the first octave has nothing finer to compare layer 0 with.
fn first_layer(octave: usize) -> usize {
    usize::from(octave == 0)
}

/// Whether an octave is searched.
fn is_big_enough((w, h): (usize, usize)) -> bool {
    w.min(h) >= MIN_OCTAVE_SIZE
}

/// The image reduced to each octave before the first one, which are only passed through; `false` when it is too small.
fn reduce(
    simd: Simd,
    options: &Options,
    image: &GrayImage,
    reduced: &mut Vec<Plane>,
    bands: &mut Vec<Band>,
) -> bool {
    reduced.resize_with(options.first_octave.max(0) as usize, Plane::default);
    let sigma = f64::from(options.sigma);
    let mut blur = f64::from(options.assumed_blur);
    for octave in 0..reduced.len() {
        let (before, from) = reduced.split_at_mut(octave);
        let source = before.last().map_or(Source::Image(image), Source::Whole);
        let kernel = Kernel::gaussian(between(blur, 2.0 * sigma));
        let kept = Kept {
            level: 1,
            halved: true,
        };
        let chain = Chain::new(vec![Make::Taken(source), Make::Blurred(kernel)], vec![kept]);
        if !is_big_enough(chain.size) {
            return false;
        }
        run(simd, &chain, vec![&mut from[0]], bands, None);
        blur = sigma;
    }
    true
}

/// Gaussian layers 1 to `intervals + 1`, each from the one before.
fn steps<'a>(options: &Options) -> impl Iterator<Item = Make<'a>> {
    (1..options.intervals + 2).map(|s| {
        let sigma = between(sigma_at(options, s - 1), sigma_at(options, s));
        Make::Blurred(Kernel::gaussian(sigma))
    })
}

/// The levels of an octave whose layer 0 is a plane: that and the layers after it.
fn blurred_levels<'a>(options: &Options, layer_0: &'a Plane) -> Vec<Make<'a>> {
    let taken = Make::Taken(Source::Whole(layer_0));
    std::iter::once(taken).chain(steps(options)).collect()
}

/// The levels of the first octave, made from the image: that, then the layers.
fn first_levels<'a>(options: &Options, image: &'a GrayImage) -> Vec<Make<'a>> {
    let blur = f64::from(options.assumed_blur);
    let mut levels = vec![Make::Taken(Source::Image(image))];
    if options.first_octave < 0 {
        levels.extend((0..options.intervals + 2).map(|s| {
            Make::Doubled(Doubling::gaussian(between(
                2.0 * blur,
                sigma_at(options, s),
            )))
        }));
    } else {
        let sigma = between(blur, sigma_at(options, 0));
        levels.push(Make::Blurred(Kernel::gaussian(sigma)));
        levels.extend(steps(options));
    }
    levels
}

/// The levels of an octave after the first: the last layer of the finer octave, then its own layers.
fn further_levels<'a>(options: &Options, finer: &'a [Plane], layer_0: &'a Plane) -> Vec<Make<'a>> {
    let last = &finer[options.intervals - 1];
    let mut levels = vec![Make::Taken(match last.pitch {
        1 => Source::Halved(last),
        _ => Source::Whole(last),
    })];
    levels.extend(blurred_levels(options, layer_0));
    levels
}

/// Adds what the bands of an octave have found and may be strong enough; what two samples have led to comes twice.
fn gather(bands: &mut [Band], found: &mut Vec<Extremum>, bar: &mut Bar) {
    let mut weakest = 0.0_f32;
    for band in bands.iter_mut() {
        weakest = weakest.max(band.scanner.found().1);
    }
    for band in bands {
        for e in band.scanner.found().0 {
            if e.response < weakest {
                continue;
            }
            found.push(*e);
            if !e.moved {
                bar.see(e.response);
            }
        }
    }
}

/// The `most` strongest of what was found, the strongest first, each once.
fn choose(found: &mut Vec<Extremum>, most: usize) {
    // Only what a fit has moved to may be there already.
    let moved = found.iter().filter(|e| e.moved).count();
    let enough = most.saturating_add(moved);
    if found.len() > enough {
        found.select_nth_unstable_by(enough, Extremum::rank);
        found.truncate(enough);
    }
    found.sort_unstable_by(Extremum::rank);
    found.dedup_by_key(|e| (e.octave, e.layer, e.sample));
    found.truncate(most);
}
/// Where the keypoints of `count` extrema are, portion and place in it, back in order of strength.
fn by_rank(made: &[Portion], count: usize) -> Vec<(usize, usize)> {
    // How many keypoints come before those of each extremum.
    let mut before = vec![0; count + 1];
    for (rank, _) in made.iter().flat_map(|portion| &portion.keypoints) {
        before[rank + 1] += 1;
    }
    for rank in 0..count {
        before[rank + 1] += before[rank];
    }
    let mut order = vec![(0, 0); before[count]];
    for (p, portion) in made.iter().enumerate() {
        for (i, (rank, _)) in portion.keypoints.iter().enumerate() {
            order[before[*rank]] = (p, i);
            before[*rank] += 1;
        }
    }
    order
}

/// Neighbours in the image one after the other, which is kinder to the caches than order of strength.
fn walk(found: &[Extremum]) -> Vec<usize> {
    let place = |e: &Extremum| {
        let layer = (e.octave + 1) as usize * 16 + e.layer;
        packed([layer, e.y as usize / 32, e.x as usize])
    };
    let mut walk: Vec<(u64, usize)> = found.iter().map(place).zip(0..).collect();
    walk.sort_unstable();
    walk.into_iter().map(|(_, rank)| rank).collect()
}

/// Layer, row and column in one number, in order: sides have fewer than 2^24 pixels.
fn packed([layer, y, x]: [usize; 3]) -> u64 {
    (layer as u64) << 48 | (y as u64) << 24 | x as u64
}

/// Makes the levels of `chain`, band by band on all threads, with what is kept of them in `planes`, and looks for extrema on the
/// way. Returns the bands that were needed.
fn run<'a>(
    simd: Simd,
    chain: &Chain<'_>,
    planes: Vec<&mut Plane>,
    bands: &'a mut Vec<Band>,
    scan: Option<&Scan<'_>>,
) -> &'a mut [Band] {
    let (w, h) = chain.size;
    let count = rayon::current_num_threads().min(h / LEAST_ROWS).max(1);
    let rows = h.div_ceil(count).next_multiple_of(2);
    let mut parts: Vec<Vec<&mut [f32]>> = Vec::new();
    parts.resize_with(h.div_ceil(rows), Vec::new);
    for (plane, kept) in planes.into_iter().zip(&chain.kept) {
        plane.resize(kept.count(w), kept.count(h));
        plane.pitch = if kept.halved { 2 } else { 1 };
        let rows = plane.data.chunks_mut(kept.count(rows) * kept.count(w));
        for (part, rows) in parts.iter_mut().zip(rows) {
            part.push(rows);
        }
    }
    if bands.len() < parts.len() {
        bands.resize_with(parts.len(), Band::default);
    }
    let bands = &mut bands[..parts.len()];
    let work = |(i, (band, mut planes)): (usize, (&mut Band, Vec<&mut [f32]>))| {
        let rows = i * rows..((i + 1) * rows).min(h);
        let Band { scratch, scanner } = band;
        if let Some(scan) = scan {
            scanner.begin(scan);
        }
        for columns in Chain::tiles(w) {
            at_level!(simd, s => chain.sweep(
                s,
                rows.clone(),
                columns,
                scratch,
                &mut planes,
                #[inline(always)]
                |levels, y| {
                    if let Some(scan) = scan {
                        scanner.visit(s, scan, levels, y);
                    }
                },
            ));
        }
    };
    bands.par_iter_mut().zip(parts).enumerate().for_each(work);
    bands
}

/// One image with an engine of its own: [`Sift::new`], then [`Sift::detect_and_describe`]. For many images keep a [`Sift`].
///
/// # Errors
/// [`SiftError::Option`] when `options` fail their [check](Options::check).
pub fn detect_and_describe(image: &GrayImage, options: &Options) -> Result<Features, SiftError> {
    Ok(Sift::new(options.clone())?.detect_and_describe(image))
}

/// From the frame of the image to that of the octave: the place of a keypoint.
fn extremum(k: &Keypoint) -> Extremum {
    let pixel = (k.octave as f32).exp2();
    Extremum {
        octave: k.octave,
        layer: k.layer as usize,
        x: k.x / pixel,
        y: k.y / pixel,
        sigma: k.sigma / pixel,
        response: k.response,
        bright: k.bright,
        sample: (0, 0),
        moved: false,
    }
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
        bright: e.bright,
        octave: e.octave,
        layer: e.layer as u32,
    }
}
