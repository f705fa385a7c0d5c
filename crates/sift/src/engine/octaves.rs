//! The octaves of an image: their planes, and the extrema of all of them.

use super::bands::{Band, gather, run};
use super::levels::{between, first_layer, first_levels, further_levels, layers_from, sigma_at};
use super::ranking::choose;
use super::workspace::{Portion, Setting, Workspace};
use crate::GrayImage;
use crate::blur::Kernel;
use crate::contrast::Contrast;
use crate::detect::{Extremum, ResponseThreshold, Scan};
use crate::scale_space::{Chain, Kept, LevelSource, Plane, Source};

/// Octaves smaller than this on either side are not searched: nothing would be left inside the detector's border.
const MIN_OCTAVE_SIZE: usize = 12;

/// Sigma in pixels from which every second pixel of every second row says enough to orient and describe by: bilinear samples of a
/// plane with a sigma of 1.0 instead of 1.27 cost one inlier in twenty.
const SMOOTH: f64 = 2.3;

/// Octaves with fewer rows than this do not keep the threads busy: others begin with what the finer octaves have shown.
const FEW_ROWS: usize = 256;

/// One in so many of the extrema that are wanted is begun with before the coarser octaves have been searched: the strongest of the finer
/// ones, which those, with a sixteenth of the pixels, can hardly outrank. What is outranked all the same is dropped.
const SURE: usize = 3;

impl Setting<'_> {
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
    pub(super) fn extrema(
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
            threshold,
            found,
            ahead: (ahead, done),
            ..
        } = work;
        let most = self.options.max_features;
        threshold.begin(most, 0.0);
        // The finer octaves keep all threads busy; the others leave some without work, who begin with what is there.
        let fine = sizes.partition_point(|&(_, h)| h >= FEW_ROWS);
        let (fine, coarse) = octaves[..sizes.len()].split_at_mut(fine);
        let sources = (image, reduced.last());
        self.scale_space(
            sources,
            &[],
            fine,
            bands,
            Some((contrast, threshold, found)),
        );
        if rayon::current_num_threads() == 1 || fine.is_empty() || coarse.is_empty() {
            self.scale_space(
                sources,
                fine,
                coarse,
                bands,
                Some((contrast, threshold, found)),
            );
        } else {
            let mut more = Vec::new();
            rayon::join(
                || {
                    self.scale_space(
                        sources,
                        fine,
                        coarse,
                        bands,
                        Some((contrast, threshold, &mut more)),
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
    pub(super) fn planes<'w>(
        &self,
        work: &'w mut Workspace,
        image: &GrayImage,
    ) -> &'w [Vec<Plane>] {
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
        mut search: Option<(&Contrast, &mut ResponseThreshold, &mut Vec<Extremum>)>,
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
            let scan = search.as_mut().map(|(contrast, threshold, _)| Scan {
                options,
                thresholds: (0..options.intervals)
                    .map(|layer| contrast.threshold(options, octave, layer))
                    .collect(),
                octave,
                base,
                layers: first_layer(index)..options.intervals,
                weakest: threshold.raise(),
            });
            let planes = here[0][first_kept - 1..].iter_mut().collect();
            let bands = run(self.simd, &chain, planes, bands, scan.as_ref());
            if let Some((_, threshold, found)) = &mut search {
                gather(bands, found, threshold);
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
            let chain = Chain::new(
                vec![LevelSource::Taken(source), LevelSource::Blurred(kernel)],
                vec![kept],
            );
            run(self.simd, &chain, vec![&mut from[0]], bands, None);
            blur = sigma;
        }
    }
}
