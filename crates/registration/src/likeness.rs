//! How alike two images are under a transform, patch by patch: zero-mean normalised correlation, blind to gain and offset of each
//! patch and so to shading.

pub use crate::plane::Plane;
use rayon::prelude::*;
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, Vec2};

/// Blur before comparing, in pixels of the coarser image: sampling between pixels then changes noise little.
const BLUR_PX: f64 = 1.0;
/// Half side of the patches that [`Pair::compare`] looks at, and their distance, in pixels of the coarser image.
const PATCH_RADIUS: usize = 6;
const PATCH_STEP: usize = 10;
/// A patch has structure when its variance is this many times that of the noise.
const STRUCTURED: f64 = 9.0;
/// A patch is explained by a transform under which it correlates at least so much,
const EXPLAINED: f64 = 0.75;
/// and tells two transforms apart when it correlates under the other by this much less.
const APART: f64 = 0.35;

/// Less variance than this is rounding, for values from 0 to 1.
const LEAST_VARIANCE: f64 = 1e-12;

/// How alike a patch of a is to what lies in b where a transform takes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Likeness {
    /// Zero-mean normalised correlation, -1 to 1; 0 for a patch without any structure.
    pub correlation: f64,
    /// Variance of the patch in a.
    pub variance: f64,
}

impl Likeness {
    /// The part of the variance that the other image does not explain.
    fn residual(&self) -> f64 {
        self.variance * (1.0 - self.correlation.max(0.0).powi(2))
    }
}

/// Compares the square of half side `radius` around a pixel of `a` with `b`, as far as it lies in both. `None` when that is less than
/// half of it.
pub fn likeness(
    a: &Plane,
    b: &Plane,
    b_from_a: &Affine2,
    centre: [usize; 2],
    radius: usize,
) -> Option<Likeness> {
    let [x, y] = centre;
    let rows = y.saturating_sub(radius)..(y + radius + 1).min(a.height());
    let columns = x.saturating_sub(radius)..(x + radius + 1).min(a.width());
    let (mut sums, mut count) = ([0.0f64; 5], 0usize);
    for row in rows {
        for column in columns.clone() {
            let Some(vb) = b.at(b_from_a.apply([column as f64, row as f64])) else {
                continue;
            };
            let va = f64::from(a.values()[row * a.width() + column]);
            count += 1;
            for (sum, v) in sums.iter_mut().zip([va, vb, va * va, vb * vb, va * vb]) {
                *sum += v;
            }
        }
    }
    let whole = (2 * radius + 1) * (2 * radius + 1);
    if 2 * count < whole {
        return None;
    }
    let [ma, mb, aa, bb, ab] = sums.map(|s| s / count as f64);
    let (variance_a, variance_b) = ((aa - ma * ma).max(0.0), (bb - mb * mb).max(0.0));
    let product = (variance_a * variance_b).sqrt();
    let correlation = match product > LEAST_VARIANCE {
        true => (ab - ma * mb) / product,
        false => 0.0,
    };
    Some(Likeness {
        correlation,
        variance: variance_a,
    })
}

/// What the patches of two images say of two transforms between them. Only patches that both transforms take into both images
/// count.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Comparison {
    /// Patches with structure.
    pub structured: usize,
    /// Of these, those which the first transform explains.
    pub first: usize,
    /// Those which the first explains and the second does not.
    pub first_only: usize,
    /// Those which the second explains and the first does not.
    pub second_only: usize,
    /// Those which both explain.
    pub both: usize,
}

impl Comparison {
    fn take(&mut self, one: &Option<Likeness>, two: &Option<Likeness>, noise: f64) {
        let (Some(one), Some(two)) = (one, two) else {
            return;
        };
        if one.variance.max(two.variance) <= (STRUCTURED * noise).max(LEAST_VARIANCE) {
            return;
        }
        self.structured += 1;
        let (a, b) = (one.correlation, two.correlation);
        self.first += usize::from(a >= EXPLAINED);
        self.first_only += usize::from(a >= EXPLAINED && b <= a - APART);
        self.second_only += usize::from(b >= EXPLAINED && a <= b - APART);
        self.both += usize::from(a >= EXPLAINED && b >= EXPLAINED);
    }
}

/// View and target as planes on the grid of the coarser one.
pub struct Pair {
    coarse: Plane,
    fine: Plane,
    /// Whether the view is the coarser one.
    view_is_coarse: bool,
}

impl Pair {
    /// For transforms of about this `scale`, target pixels per view pixel.
    pub fn new(view: &GrayImage, target: &GrayImage, scale: f64) -> Self {
        let view_is_coarse = scale >= 1.0;
        let (coarse, fine, ratio) = match view_is_coarse {
            true => (view, target, scale),
            false => (target, view, 1.0 / scale),
        };
        Self {
            coarse: Plane::band(coarse, BLUR_PX),
            fine: Plane::band(fine, BLUR_PX * ratio),
            view_is_coarse,
        }
    }

    fn fine_from_coarse(&self, target_from_view: &Affine2) -> Option<Affine2> {
        match self.view_is_coarse {
            true => Some(*target_from_view),
            false => target_from_view.inverse(),
        }
    }

    fn patches(&self) -> impl Iterator<Item = [usize; 2]> + '_ {
        let along =
            |side: usize| (PATCH_RADIUS..side.saturating_sub(PATCH_RADIUS)).step_by(PATCH_STEP);
        along(self.coarse.height())
            .flat_map(move |y| along(self.coarse.width()).map(move |x| [x, y]))
    }

    /// Each patch's place in the view with its likeness.
    fn look(&self, target_from_view: &Affine2) -> Option<Vec<(Vec2, Option<Likeness>)>> {
        let fine_from_coarse = self.fine_from_coarse(target_from_view)?;
        let patches: Vec<[usize; 2]> = self.patches().collect();
        let seen = patches.into_par_iter().map(|centre| {
            let seen = likeness(
                &self.coarse,
                &self.fine,
                &fine_from_coarse,
                centre,
                PATCH_RADIUS,
            );
            let p = centre.map(|v| v as f64);
            let in_view = match self.view_is_coarse {
                true => p,
                false => fine_from_coarse.apply(p),
            };
            (in_view, seen)
        });
        Some(seen.collect())
    }

    /// Compares two transforms, patch by patch: on those of the coarser image, each against where the transforms take it in the finer
    /// one; and on those of the finer one, each against where it comes from. Patches whose place in the view `counts` do.
    pub fn compare(
        &self,
        first: &Affine2,
        second: &Affine2,
        counts: impl Fn(Vec2) -> bool,
    ) -> Option<Comparison> {
        let (one, two) = (self.look(first)?, self.look(second)?);
        let noise = noise(one.iter().filter_map(|(_, seen)| *seen))?;
        let mut found = Comparison::default();
        for ((place, one), (_, two)) in one.iter().zip(&two) {
            if counts(*place) {
                found.take(one, two, noise);
            }
        }
        // One grid for both: transforms of other scales would lay others, and their patches be compared with those of other places.
        let step = self.step_back(first)?;
        let back = |t: &Affine2| self.look_back(t, step);
        for (one, two) in back(first)?.iter().zip(&back(second)?) {
            if one.0.is_some_and(&counts) && two.0.is_some_and(&counts) {
                found.take(&one.1, &two.1, noise);
            }
        }
        Some(found)
    }

    /// Distance of the patches of a grid over the finer image, so that they lie [`PATCH_STEP`] apart in the coarser one.
    fn step_back(&self, target_from_view: &Affine2) -> Option<f64> {
        let scale = self.fine_from_coarse(target_from_view)?.linear.det().abs();
        Some((PATCH_STEP as f64 * scale.sqrt()).max(1.0))
    }

    /// For each patch of a grid over the finer image, `step` pixels apart, its place in the view and the likeness of the coarse patch that it
    /// comes from.
    fn look_back(
        &self,
        target_from_view: &Affine2,
        step: f64,
    ) -> Option<Vec<(Option<Vec2>, Option<Likeness>)>> {
        let fine_from_coarse = self.fine_from_coarse(target_from_view)?;
        let coarse_from_fine = fine_from_coarse.inverse()?;
        let along = move |side: usize| {
            let count = (side as f64 / step) as usize;
            (0..count).map(move |k| (k as f64 + 0.5) * step)
        };
        let places =
            along(self.fine.height()).flat_map(|y| along(self.fine.width()).map(move |x| [x, y]));
        let places: Vec<Vec2> = places.collect();
        let seen = places.into_par_iter().map(|[x, y]| {
            let at = coarse_from_fine.apply([x, y]).map(f64::round);
            let inside = at[0] >= 0.0
                && at[1] >= 0.0
                && at[0] < self.coarse.width() as f64
                && at[1] < self.coarse.height() as f64;
            if !inside {
                return (None, None);
            }
            let centre = at.map(|v| v as usize);
            let place = if self.view_is_coarse { at } else { [x, y] };
            let like = likeness(
                &self.coarse,
                &self.fine,
                &fine_from_coarse,
                centre,
                PATCH_RADIUS,
            );
            (Some(place), like)
        });
        Some(seen.collect())
    }

    /// The transform near `rough`, which is shifted by up to `unsure_px` of the target, under which the patches correlate most: looked for in whole
    /// pixels of the coarser image, and then up to a pixel and a half about the best.
    pub fn refined(&self, rough: &Affine2, unsure_px: f64) -> Affine2 {
        const STEPS: [f64; 7] = [0.0, -0.5, 0.5, -1.0, 1.0, -1.5, 1.5];
        let coarse_px = rough.linear.det().abs().sqrt().max(1.0);
        let wide = (unsure_px / coarse_px).ceil() as i64;
        let near = match wide as f64 > STEPS[6] {
            true => self.most_alike(rough, (-wide..=wide).map(|k| k as f64)),
            false => *rough,
        };
        self.most_alike(&near, STEPS.into_iter())
    }

    /// Of shifts by all pairs of `steps`, pixels of the coarser image, the one under which the patches correlate most; of equals the first.
    fn most_alike(&self, rough: &Affine2, steps: impl Iterator<Item = f64> + Clone) -> Affine2 {
        // A hundred patches are enough.
        let every = (self.patches().count() / 100).max(1);
        let coarse_px = rough.linear.det().abs().sqrt().max(1.0);
        let shifted = |dx: f64, dy: f64| Affine2 {
            offset: [
                rough.offset[0] + dx * coarse_px,
                rough.offset[1] + dy * coarse_px,
            ],
            ..*rough
        };
        let score = |transform: &Affine2| {
            let Some(fine_from_coarse) = self.fine_from_coarse(transform) else {
                return f64::NEG_INFINITY;
            };
            let seen = self.patches().step_by(every).filter_map(|centre| {
                likeness(
                    &self.coarse,
                    &self.fine,
                    &fine_from_coarse,
                    centre,
                    PATCH_RADIUS,
                )
            });
            // Patches without structure add only noise.
            seen.map(|l| l.correlation * l.variance.sqrt()).sum::<f64>()
        };
        let all = steps
            .clone()
            .flat_map(|dy| steps.clone().map(move |dx| shifted(dx, dy)));
        let mut best = (f64::NEG_INFINITY, *rough);
        for transform in all {
            let s = score(&transform);
            if s > best.0 {
                best = (s, transform);
            }
        }
        best.1
    }

    /// Those of all patches that lie in both images.
    fn likenesses(&self, target_from_view: &Affine2) -> Vec<Likeness> {
        let seen = self.look(target_from_view).unwrap_or_default();
        seen.into_iter().filter_map(|(_, seen)| seen).collect()
    }

    /// Of the patches with the most structure, the share that a transform explains: near 1 for a right one, whatever the noise, and small for
    /// one that a few places happen to agree on.
    pub fn share_explained(&self, target_from_view: &Affine2) -> f64 {
        let seen = self.likenesses(target_from_view);
        let mut variances: Vec<f64> = seen.iter().map(|l| l.variance).collect();
        let Some(last) = variances.len().checked_sub(1) else {
            return 0.0;
        };
        let strongest = *variances
            .select_nth_unstable_by(last - last / 100, f64::total_cmp)
            .1;
        let strong = || seen.iter().filter(|l| l.variance >= STRONG * strongest);
        let explained = strong().filter(|l| l.correlation >= ALIKE).count();
        explained as f64 / strong().count().max(1) as f64
    }

    /// Of the patches with structure, the share of those whose structure is far from what the transform puts there: nearly none of two
    /// images of one place, whatever the noise. Of two places behind the same dust it is all that they show beside it.
    pub fn share_contradicted(&self, target_from_view: &Affine2) -> f64 {
        let seen = self.likenesses(target_from_view);
        let Some(noise) = noise(seen.iter().copied()) else {
            return 0.0;
        };
        let clear = (STRUCTURED * noise).max(LEAST_VARIANCE);
        let structured = seen.iter().filter(|l| l.variance > clear);
        let contradicted = structured
            .clone()
            .filter(|l| l.residual() > clear && l.correlation < ALIKE);
        contradicted.count() as f64 / structured.count().max(1) as f64
    }

    /// The share of all patches, with structure or without, that show the same thing under a transform: they are alike, and nearly so a
    /// little aside, as all is that went through optics. The pattern of a sensor's pixels or columns is not.
    pub fn share_alike(&self, target_from_view: &Affine2) -> f64 {
        let aside = |x: f64, y: f64| Affine2 {
            offset: [
                target_from_view.offset[0] + x,
                target_from_view.offset[1] + y,
            ],
            ..*target_from_view
        };
        let look = |t: &Affine2| self.look(t).unwrap_or_default();
        let here = look(target_from_view);
        let beside = [aside(ASIDE_PX, 0.0), aside(0.0, ASIDE_PX)].map(|t| look(&t));
        let (mut alike, mut all) = (0usize, 0usize);
        for (k, (_, seen)) in here.iter().enumerate() {
            let Some(seen) = seen else { continue };
            all += 1;
            let smooth = beside.iter().all(|look| {
                look[k]
                    .1
                    .is_some_and(|b| b.correlation >= SMOOTH * seen.correlation)
            });
            alike += usize::from(seen.correlation >= ALIKE && smooth);
        }
        alike as f64 / all.max(1) as f64
    }
}

/// A patch has much structure when its variance is this share of that of the strongest ones.
const STRONG: f64 = 0.1;
/// So far aside, pixels of the target, an image is still like itself: by this share.
const ASIDE_PX: f64 = 2.0;
const SMOOTH: f64 = 0.45;
/// A patch of noise correlates so much with another in one case of a hundred.
const ALIKE: f64 = 0.5;

/// Variance of the noise: what is left in the quietest quarter of the patches.
fn noise(seen: impl Iterator<Item = Likeness>) -> Option<f64> {
    let mut residuals: Vec<f64> = seen.map(|l| l.residual()).collect();
    if residuals.is_empty() {
        return None;
    }
    let at = residuals.len() / 4;
    Some(*residuals.select_nth_unstable_by(at, f64::total_cmp).1)
}
