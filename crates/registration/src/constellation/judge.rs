//! How much a transform is worth: how many places of the target land on one of the view, against what chance puts there.
//!
//! A place of the view may be one of the target when it has its polarity and its size. How it looks is not asked: round cells have no
//! orientation, and descriptors that differ for that would leave out one of the few.

use super::near::{Kinds, Near};
use super::places::{LEAST_PLACES, Place, Places, distance_sq};
use crate::significance::ln_choose;
use crate::{Prior, ScalePrior};
use scopeservo_geometry::{Affine2, Correspondence, Vec2, similarity_robust};
use std::f64::consts::{LN_10, PI};

/// How far the sizes of one thing in view and target may be from the scale: factor.
const SIZE_SLACK: f64 = 1.3;
/// Nearer than this nothing is placed, whatever the numbers say, pixels of the view.
const LEAST_OFF_PX: f64 = 0.03;
/// More things than this in the view tell nothing: they lie everywhere.
const MOST_OF_VIEW: usize = 2500;

/// View and target, and what agrees.
pub(super) struct Judge<'a> {
    pub(super) view: &'a Places,
    pub(super) target: &'a Places,
    pub(super) prior: &'a Prior,
    pub(super) scale: ScalePrior,
    /// A place agrees within this, pixels of the view.
    pub(super) radius: f64,
    /// Which places of the view may be each of the target's.
    may: Vec<Vec<bool>>,
    /// Of which kinds these are.
    kinds: Vec<Kinds>,
    /// How many of them there are for one of the target, on average.
    chosen: f64,
    near: Near,
}

/// A transform with what agrees with it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Judged {
    pub(super) target_from_view: Affine2,
    /// Of view and target, by their numbers.
    pub(super) agreeing: Vec<[usize; 2]>,
    /// Places of the target that lie in the view.
    pub(super) places: usize,
    pub(super) log10_nfa: f64,
}

impl Judged {
    /// Whether enough of what should be seen is seen.
    pub(super) fn is_whole(&self, share: f64) -> bool {
        self.agreeing.len() as f64 >= share * self.places as f64
    }
}

impl<'a> Judge<'a> {
    /// `None` where there is too little, or too much, to tell.
    pub(super) fn new(
        view: &'a Places,
        target: &'a Places,
        prior: &'a Prior,
        radius: f64,
    ) -> Option<Self> {
        let scale = prior.scale?;
        if target.all.len() < LEAST_PLACES
            || view.all.len() < LEAST_PLACES
            || view.all.len() > MOST_OF_VIEW
        {
            return None;
        }
        let may: Vec<Vec<bool>> = (0..target.all.len())
            .map(|t| chosen(view, &target.all[t], prior, scale))
            .collect();
        let near = Near::new(view, radius);
        let chosen = may.iter().flatten().filter(|may| **may).count() as f64;
        Some(Self {
            view,
            target,
            prior,
            scale,
            radius,
            chosen: chosen / target.all.len() as f64,
            kinds: may.iter().map(|may| near.kinds_of(may)).collect(),
            may,
            near,
        })
    }

    /// The places of the view that may be one of the target's.
    pub(super) fn those(&self, t: usize) -> Vec<&Place> {
        let may = self.may[t].iter();
        let all = self.view.all.iter().zip(may);
        all.filter(|(_, may)| **may).map(|(v, _)| v).collect()
    }

    /// Whether a place of the view that may be this one of the target lies within the radius.
    fn is_near(&self, at: Vec2, t: usize) -> bool {
        let most = self.radius * self.radius;
        let mut near = self.near.to(at, self.radius, self.kinds[t]);
        near.any(|i| self.may[t][i] && distance_sq(self.view.all[i].at, at) <= most)
    }

    /// The nearest place of the view within a radius, no larger than the judge's, that may be this one of the target.
    fn nearest(&self, at: Vec2, t: usize, radius: f64) -> Option<(f64, usize)> {
        let near = self.near.to(at, radius, self.kinds[t]);
        let off = |i: usize| (distance_sq(self.view.all[i].at, at).sqrt(), i);
        let within = near.filter(|&i| self.may[t][i]).map(off);
        within
            .filter(|(off, _)| *off <= radius)
            .min_by(|a, b| a.0.total_cmp(&b.0))
    }

    fn in_view(&self, p: Vec2) -> bool {
        let within = |v: f64, n: usize| v >= self.radius && v < n as f64 - self.radius;
        within(p[0], self.view.size[0]) && within(p[1], self.view.size[1])
    }

    /// How many of the target's places lie on one of the view's: `None` when they are less than this share of those that lie in the view.
    pub(super) fn counted(&self, view_from_target: &Affine2, share: f64) -> Option<usize> {
        let (mut inside, mut agree) = (0, 0);
        let mut left = self.target.all.len();
        for (t, place) in self.target.all.iter().enumerate() {
            left -= 1;
            let at = view_from_target.apply(place.at);
            if self.in_view(at) {
                inside += 1;
                agree += usize::from(self.is_near(at, t));
            }
            // Also if all that are left agreed.
            if ((agree + left) as f64) < share * (inside + left) as f64 {
                return None;
            }
        }
        Some(agree)
    }

    /// Which places agree within a radius, each once, with how far they are off.
    fn agreeing(&self, view_from_target: &Affine2, radius: f64) -> (usize, Vec<(f64, [usize; 2])>) {
        let (mut inside, mut all) = (0, Vec::new());
        for (t, place) in self.target.all.iter().enumerate() {
            let at = view_from_target.apply(place.at);
            if self.in_view(at) {
                inside += 1;
                if let Some((off, v)) = self.nearest(at, t, radius) {
                    all.push((off, [v, t]));
                }
            }
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut taken = std::collections::BTreeSet::new();
        all.retain(|(_, [v, _])| taken.insert(*v));
        (inside, all)
    }

    /// The transform fitted to what agrees, and what it is worth when so many were tried.
    pub(super) fn judged(&self, proposed: &Affine2, tried: f64) -> Option<Judged> {
        let mut view_from_target = *proposed;
        for radius in [1.0, 1.0, 0.7].map(|share| share * self.radius) {
            let (_, agree) = self.agreeing(&view_from_target, radius);
            let pairs: Vec<Correspondence> =
                agree.iter().map(|(_, pair)| self.pair(pair)).collect();
            let fitted = similarity_robust(&pairs)?.inverse()?;
            if !self.prior.allows(&fitted.inverse()?) {
                break;
            }
            view_from_target = fitted;
        }
        let target_from_view = view_from_target.inverse()?;
        let (places, agree) = self.agreeing(&view_from_target, self.radius);
        let chance = self.density(&target_from_view) * PI * self.radius * self.radius;
        let off: Vec<f64> = agree.iter().map(|(off, _)| off / self.radius).collect();
        let least = LEAST_OFF_PX / self.radius;
        Some(Judged {
            target_from_view,
            agreeing: agree.into_iter().map(|(_, pair)| pair).collect(),
            places,
            log10_nfa: log10_nfa(tried, places, &off, least, chance.min(1.0)),
        })
    }

    fn pair(&self, [v, t]: &[usize; 2]) -> Correspondence {
        Correspondence {
            p_in_a: self.view.all[*v].at,
            p_in_b: self.target.all[*t].at,
            sigma: 1.0,
        }
    }

    /// How densely what may be one of the target's places lies in the view where the target does, or in all of it where that is more, per square
    /// pixel.
    fn density(&self, target_from_view: &Affine2) -> f64 {
        let [w, h] = self.target.size.map(|n| n as f64);
        let is_in = |p: Vec2| p[0] >= 0.0 && p[1] >= 0.0 && p[0] < w && p[1] < h;
        let all = self.view.all.iter();
        let inside = all.filter(|v| is_in(target_from_view.apply(v.at))).count();
        let area = (w * h / target_from_view.linear.det().abs()).min(self.area());
        let all = self.view.all.len() as f64;
        let share = self.chosen / all;
        share * (inside as f64 / area).max(all / self.area())
    }

    fn area(&self) -> f64 {
        (self.view.size[0] * self.view.size[1]) as f64
    }
}

/// Which places of the view may be one of the target's.
fn chosen(view: &Places, t: &Place, prior: &Prior, scale: ScalePrior) -> Vec<bool> {
    let may_be = |v: &Place| {
        let ratio = t.sigma / (v.sigma * scale.ratio);
        v.bright == t.bright
            && ratio < SIZE_SLACK
            && ratio > 1.0 / SIZE_SLACK
            && prior
                .moved_px
                .is_none_or(|least| distance_sq(v.at, t.at) > least * least)
    };
    view.all.iter().map(may_be).collect()
}

/// log10 of the expected number of transforms among those tried, each fixed by two places, that as many of `n` places agree with as well as these.
///
/// `off` is how far each is off in parts of the radius, in order: by chance a place lies within the radius with the given probability, and then the
/// square of how far it is off is uniform. The product of such squares is Fisher's (Statistical Methods for Research Workers, 1932); that only those
/// within a radius count, Zaykin's (truncated product, Genetic Epidemiology 22, 2002). The nearest two are taken for those that made the
/// transform, and the rest for as much farther off as the fit drew them near.
fn log10_nfa(tried: f64, n: usize, off: &[f64], least: f64, chance: f64) -> f64 {
    if off.len() <= 2 || chance <= 0.0 {
        return f64::INFINITY;
    }
    let k = off.len() - 2;
    let drawn = (off.len() as f64 / k as f64).sqrt();
    let squares = off[2..]
        .iter()
        .map(|off| (off * drawn).clamp(least, 1.0).powi(2));
    let ln_product: f64 = squares.map(f64::ln).sum();
    let many = ln_tail(n - 2, k, chance) + ln_fisher(k, ln_product);
    // Any number of places would have done.
    (tried.max(1.0).ln() + many + (n as f64).ln()) / LN_10
}

/// ln of the probability that `k` or more of `n` happen.
fn ln_tail(n: usize, k: usize, chance: f64) -> f64 {
    let not = (1.0 - chance).max(1e-300).ln();
    let term = |j: usize| ln_choose(n, j) + j as f64 * chance.ln() + (n - j) as f64 * not;
    ln_sum((k..=n).map(term).collect())
}

/// ln of the probability that the product of `k` uniform numbers is as small as that.
fn ln_fisher(k: usize, ln_product: f64) -> f64 {
    let mut factorial = 0.0;
    let terms = (0..k).map(|j| {
        if j > 0 {
            factorial += (j as f64).ln();
        }
        j as f64 * (-ln_product).max(1e-12).ln() - factorial
    });
    (ln_product + ln_sum(terms.collect())).min(0.0)
}

/// ln of a sum of numbers whose ln these are.
fn ln_sum(terms: Vec<f64>) -> f64 {
    let most = terms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    most + terms.iter().map(|t| (t - most).exp()).sum::<f64>().ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_product_of_uniform_numbers_is_as_small_as_it_should() {
        // One is itself; of two, w (1 - ln w).
        assert!((ln_fisher(1, 0.01f64.ln()) - 0.01f64.ln()).abs() < 1e-9);
        let two = 0.01 * (1.0 - 0.01f64.ln());
        assert!((ln_fisher(2, 0.01f64.ln()) - two.ln()).abs() < 1e-9);
        assert!((ln_tail(3, 2, 0.5) - 0.5f64.ln()).abs() < 1e-9);
    }
}
