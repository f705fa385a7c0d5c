//! The walk through the stages.

use std::ops::Range;

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

/// Octaves with fewer rows than this do not keep the threads busy: others begin with what the finer octaves have shown.
const FEW_ROWS: usize = 256;

/// One in so many of the extrema that are wanted is begun with before the coarser octaves have been searched: the strongest of the finer
/// ones, which those, with a sixteenth of the pixels, can hardly outrank. What is outranked all the same is dropped.
const SURE: usize = 3;

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
    /// Gaussian layers `1..=intervals + 1` of each octave, the finest first: where keypoints are oriented and described. The last two
    /// are layers 0 and 1 of the next octave, so that layer 1 itself is left out where it can be.
    octaves: Vec<Vec<Plane>>,
    /// The image reduced to each octave before the first.
    reduced: Vec<Plane>,
    /// One for each band of rows that runs at the same time.
    bands: Vec<Band>,
    bar: Bar,
    found: Vec<Extremum>,
    /// Extrema that are surely among the strongest, in order of strength, and what was made of them while others were looked for.
    ahead: (Vec<Extremum>, Vec<Portion>),
    portions: Vec<Portion>,
}

/// What all steps know.
#[derive(Debug, Clone, Copy)]
struct Setting<'a> {
    options: &'a Options,
    simd: Simd,
    weights: &'a Weights,
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

impl Portion {
    /// Keeps its memory.
    fn clear(&mut self) {
        self.keypoints.clear();
        self.descriptors.clear();
    }
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
        let mut features = Features::default();
        self.features(image, false, &mut features);
        features.keypoints
    }

    /// Detects, orients and describes the features of `image`: the `max_features` strongest, as strong as the extremum they
    /// belong to.
    ///
    /// An image without structure, or too small for the first octave (fewer than 12 pixels on a side after doubling), gives no
    /// features.
    pub fn detect_and_describe(&mut self, image: &GrayImage) -> Features {
        let mut features = Features::default();
        self.detect_and_describe_into(image, &mut features);
        features
    }

    /// The same in place of what is in `features`, in the memory that they have: for frame after frame of a camera, where fresh memory
    /// of some hundred kilobytes costs as much as a hundred descriptors.
    pub fn detect_and_describe_into(&mut self, image: &GrayImage, features: &mut Features) {
        self.features(image, true, features);
    }

    /// The strongest keypoints, with their descriptors if wanted, into `features`.
    fn features(&mut self, image: &GrayImage, described: bool, features: &mut Features) {
        features.keypoints.clear();
        features.descriptors.clear();
        (features.width, features.height) = (image.width(), image.height());
        let (setting, work) = self.parts();
        // All stages on the threads of the pool, with one way there and back.
        rayon::scope(|_| {
            if let Some(contrast) = Contrast::of(image, setting.options) {
                setting.extrema(work, image, &contrast, described);
                setting.oriented(work, described, features);
            }
        });
    }

    fn parts(&mut self) -> (Setting<'_>, &mut Workspace) {
        let setting = Setting {
            options: &self.options,
            simd: self.simd,
            weights: &self.weights,
        };
        (setting, &mut self.work)
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
        let (setting, work) = self.parts();
        rayon::scope(|_| {
            let octaves = setting.planes(work, image);
            let is_ours = |k: &Keypoint| setting.is_ours(k, image, octaves.len());
            if let Some(index) = keypoints.iter().position(|k| !is_ours(k)) {
                return Err(SiftError::ForeignKeypoint { index });
            }
            let places: Vec<Extremum> = keypoints.iter().map(extremum).collect();
            let walk = walk(&places, 0..places.len());
            let described: Vec<Vec<Descriptor>> = (walk.par_chunks(PORTION))
                .map_init(Patch::new, |patch, portion| {
                    let mut described = Vec::with_capacity(portion.len());
                    for &i in portion {
                        let (plane, place) = setting.place_of(octaves, &places[i]);
                        let angle = keypoints[i].angle;
                        described.push(at_level!(setting.simd, s => {
                            describe(s, setting.weights, patch, plane, place, angle)
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

    /// Gaussian layers by octave.
    #[cfg(test)]
    pub(crate) fn planes(&self) -> &[Vec<Plane>] {
        &self.work.octaves
    }
}

impl Setting<'_> {
    /// Whether a keypoint may have been found in an image in which so many octaves are searched.
    fn is_ours(&self, k: &Keypoint, image: &GrayImage, octaves: usize) -> bool {
        let (first, layer) = (self.options.first_octave, k.layer as usize);
        let index = i64::from(k.octave) - i64::from(first);
        let sigma = (k.octave as f32).exp2() * self.options.sigma_at(k.layer as f32);
        (0..octaves as i64).contains(&index)
            && (first_layer(index as usize)..self.options.intervals).contains(&layer)
            && (0.5 * sigma..=2.0 * sigma).contains(&k.sigma)
            && k.lies_in(image.width(), image.height())
    }

    /// The first `max_features` keypoints of the extrema found, with their descriptors if wanted, into `features`.
    fn oriented(&self, work: &mut Workspace, described: bool, features: &mut Features) {
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
    fn fill_all(
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
    fn place_of<'a>(&self, octaves: &'a [Vec<Plane>], e: &Extremum) -> (&'a Plane, [f32; 3]) {
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

    /// Columns and rows of the octaves that are searched in an image.
    fn sizes(&self, image: &GrayImage) -> Vec<(usize, usize)> {
        let side = |n: usize, octave: i32| match octave {
            0.. => n.div_ceil(1 << octave),
            _ => 2 * n - 1,
        };
        (self.options.first_octave..)
            .map(|octave| (side(image.width(), octave), side(image.height(), octave)))
            .take_while(|&(w, h)| w.min(h) >= MIN_OCTAVE_SIZE)
            .collect()
    }

    /// The strongest extrema in order of their strength, and the planes around them, into the workspace. Some may have been oriented,
    /// and described if wanted, on the way.
    fn extrema(
        &self,
        work: &mut Workspace,
        image: &GrayImage,
        contrast: &Contrast,
        described: bool,
    ) {
        let sizes = self.begin(work, image);
        let Workspace {
            octaves,
            reduced,
            bands,
            bar,
            found,
            ahead: (ahead, done),
            ..
        } = work;
        let most = self.options.max_features;
        bar.begin(most, 0.0);
        // The finer octaves keep all threads busy; the others leave some without work, who begin with what is there.
        let fine = sizes.partition_point(|&(_, h)| h >= FEW_ROWS);
        let (fine, coarse) = octaves[..sizes.len()].split_at_mut(fine);
        let sources = (image, reduced.last());
        self.scale_space(sources, &[], fine, bands, Some((contrast, bar, found)));
        if rayon::current_num_threads() == 1 || fine.is_empty() || coarse.is_empty() {
            self.scale_space(sources, fine, coarse, bands, Some((contrast, bar, found)));
        } else {
            let mut more = Vec::new();
            rayon::join(
                || {
                    self.scale_space(
                        sources,
                        fine,
                        coarse,
                        bands,
                        Some((contrast, bar, &mut more)),
                    )
                },
                || {
                    ahead.clone_from(found);
                    choose(ahead, most / SURE);
                    self.fill_all(fine, done, ahead, 0..ahead.len(), described);
                },
            );
            found.append(&mut more);
        }
        choose(found, most);
    }

    /// The planes of all octaves that are searched.
    fn planes<'w>(&self, work: &'w mut Workspace, image: &GrayImage) -> &'w [Vec<Plane>] {
        let count = self.begin(work, image).len();
        let octaves = &mut work.octaves[..count];
        let sources = (image, work.reduced.last());
        self.scale_space(sources, &[], octaves, &mut work.bands, None);
        octaves
    }

    /// Forgets the image before; the image reduced to the first octave, and room for all. Returns the sizes of the octaves.
    fn begin(&self, work: &mut Workspace, image: &GrayImage) -> Vec<(usize, usize)> {
        work.found.clear();
        work.ahead.0.clear();
        work.ahead.1.iter_mut().for_each(Portion::clear);
        let sizes = self.sizes(image);
        if !sizes.is_empty() {
            self.reduce(image, &mut work.reduced, &mut work.bands);
        }
        let octaves = work.octaves.len().max(sizes.len());
        (work.octaves).resize_with(octaves, || {
            vec![Plane::default(); self.options.intervals + 1]
        });
        sizes
    }

    /// The planes of the octaves `octaves`, of which `finer` are those before, and with `search` the extrema that are found on the way.
    fn scale_space(
        &self,
        (image, reduced): (&GrayImage, Option<&Plane>),
        finer: &[Vec<Plane>],
        octaves: &mut [Vec<Plane>],
        bands: &mut Vec<Band>,
        mut search: Option<(&Contrast, &mut Bar, &mut Vec<Extremum>)>,
    ) {
        let options = self.options;
        for i in 0..octaves.len() {
            let (before, here) = octaves.split_at_mut(i);
            let (levels, base) = match (before.last().or(finer.last()), reduced) {
                (Some(finer), _) => (further_levels(options, finer), 1),
                (None, Some(reduced)) => {
                    let layer_0 = std::slice::from_ref(reduced);
                    (layers_from(options, layer_0).collect(), 0)
                }
                (None, None) => (first_levels(options, image), 1),
            };
            let index = finer.len() + i;
            // Layer 1 is needed only when it is the one that the next octave begins with.
            let first_kept = 2.min(options.intervals - 1);
            let chain = Chain::new(
                levels,
                (first_kept..=options.intervals + 1)
                    .map(|layer| Kept {
                        level: base + layer,
                        halved: layer >= options.intervals || sigma_at(options, layer) >= SMOOTH,
                    })
                    .collect(),
            );
            let octave = options.first_octave + index as i32;
            let scan = search.as_mut().map(|(contrast, bar, _)| Scan {
                options,
                thresholds: (0..options.intervals)
                    .map(|layer| contrast.threshold(options, octave, layer))
                    .collect(),
                octave,
                base,
                layers: first_layer(index)..options.intervals,
                weakest: bar.raise(),
            });
            let planes = here[0][first_kept - 1..].iter_mut().collect();
            let bands = run(self.simd, &chain, planes, bands, scan.as_ref());
            if let Some((_, bar, found)) = &mut search {
                gather(bands, found, bar);
            }
        }
    }

    /// The image reduced to each octave before the first one, which are only passed through.
    fn reduce(&self, image: &GrayImage, reduced: &mut Vec<Plane>, bands: &mut Vec<Band>) {
        let options = self.options;
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
            run(self.simd, &chain, vec![&mut from[0]], bands, None);
            blur = sigma;
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

/// The Gaussian layers of an octave of which the first are planes, each of the others from the one before.
fn layers_from<'a>(options: &Options, first: &'a [Plane]) -> impl Iterator<Item = Make<'a>> {
    let taken = first.iter().map(|plane| Make::Taken(Source::Whole(plane)));
    let blurred = (first.len().max(1)..options.intervals + 2).map(|s| {
        let sigma = between(sigma_at(options, s - 1), sigma_at(options, s));
        Make::Blurred(Kernel::gaussian(sigma))
    });
    taken.chain(blurred)
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
        levels.extend(layers_from(options, &[]));
    }
    levels
}

/// The levels of an octave after the first: the layer of the finer octave before those that both have, then its own.
fn further_levels<'a>(options: &Options, finer: &'a [Plane]) -> Vec<Make<'a>> {
    let [.., before, _, _] = finer else {
        unreachable!("an octave has two intervals at least");
    };
    let mut levels = vec![Make::Taken(match before.pitch {
        1 => Source::Halved(before),
        _ => Source::Whole(before),
    })];
    levels.extend(layers_from(options, &finer[finer.len() - 2..]));
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

/// Numbers what was made `ahead` as `found` does, in which extrema may have come in between; what is no longer there is dropped.
/// Returns after which rank nothing is done.
fn rank_again(
    ahead: &[Extremum],
    done: &mut [Portion],
    found: &[Extremum],
    is_done: &mut [bool],
) -> usize {
    let mut next = 0;
    let ranks: Vec<Option<usize>> = (ahead.iter())
        .map(|e| {
            next += found[next..]
                .iter()
                .take_while(|f| f.rank(e).is_lt())
                .count();
            (found.get(next) == Some(e)).then_some(next)
        })
        .collect();
    for portion in done {
        for (rank, _) in &mut portion.keypoints {
            *rank = ranks[*rank].unwrap_or(usize::MAX);
        }
    }
    for rank in ranks.iter().flatten() {
        is_done[*rank] = true;
    }
    ranks.iter().flatten().last().map_or(0, |last| last + 1)
}

/// Where the keypoints of the extrema `ranks` are, portion and place in it, in order of strength.
fn by_rank(made: &[&Portion], ranks: Range<usize>) -> Vec<(usize, usize)> {
    let places = || {
        made.iter().enumerate().flat_map(|(p, portion)| {
            let places = portion.keypoints.iter().enumerate();
            places.map(move |(i, (rank, _))| (*rank, (p, i)))
        })
    };
    // How many keypoints come before those of each extremum.
    let mut before = vec![0; ranks.len() + 1];
    for (rank, _) in places().filter(|(rank, _)| ranks.contains(rank)) {
        before[rank - ranks.start + 1] += 1;
    }
    for i in 0..ranks.len() {
        before[i + 1] += before[i];
    }
    let mut order = vec![(0, 0); before[ranks.len()]];
    for (rank, place) in places().filter(|(rank, _)| ranks.contains(rank)) {
        let next = &mut before[rank - ranks.start];
        order[*next] = place;
        *next += 1;
    }
    order
}

/// Neighbours in the image one after the other, which is kinder to the caches than order of strength.
fn walk(found: &[Extremum], ranks: impl Iterator<Item = usize>) -> Vec<usize> {
    let place = |rank: usize| {
        let e = &found[rank];
        let layer = (e.octave + 1) as usize * 16 + e.layer;
        (packed([layer, e.y as usize / 32, e.x as usize]), rank)
    };
    let mut walk: Vec<(u64, usize)> = ranks.map(place).collect();
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
