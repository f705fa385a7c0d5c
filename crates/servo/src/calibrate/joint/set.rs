//! All objectives of one microscope in one fit, by what each one's views say by themselves, and by what they see of each other.
//!
//! The estimate of each objective with its covariance stands for all its views: to first order the least squares over all is the least
//! squares over these. What physics shares is shared, and nothing else: the backlash of the stage's axes; the camera's angle, but for the
//! little by which lenses may turn an image; the axis of rotation, which says where centres lie by the little that objectives of one nosepiece
//! look beside each other. What binds most is a [`Link`]: the first views of two objectives show the same specimen from nearly the same pose.
//! Scales, shapes of pixels and how far arrivals scatter stay each objective's own.

use super::link::{Link, STAND, Stand, angle_beside, apart_m};
use super::model::OPTICS;
use super::single::{Apart, Difference, Differing, SINGLE, SetFit, Shared, Single};
use super::whole::Whole;

impl Whole<'_> {
    /// By how much two singles contradict each other.
    fn differences(&self, a: usize, b: usize) -> Vec<Difference> {
        let [first, second] = [a, b].map(|o| &self.singles[o]);
        let variance = |s: &Single, k: usize| s.variance(k);
        let mut all = Vec::new();
        let mut add = |what, by: f64, variance: f64| {
            if variance > 0.0 {
                let (by, sigma) = (by.abs(), variance.sqrt());
                all.push(Difference { what, by, sigma });
            }
        };
        for k in 0..2 {
            let by = first.backlash[k] - second.backlash[k];
            add(
                Differing::Backlash,
                by,
                variance(first, k) + variance(second, k),
            );
        }
        let angles = [first, second].map(|s| {
            let (angle, by) = angle_beside(self.about, s.optics.stage_from_pixel);
            let cell = |i: usize, j: usize| by[i] * s.covariance[SINGLE * (3 + i) + 3 + j] * by[j];
            let known: f64 = (0..16).map(|k| cell(k / 4, k % 4)).sum();
            (angle, known + self.shared.angle_rad.powi(2))
        });
        add(
            Differing::Angle,
            angles[0].0 - angles[1].0,
            angles[0].1 + angles[1].1,
        );
        if self.turns() {
            for k in 0..2 {
                let by = first.optics.centre_m[k] - second.optics.centre_m[k];
                let known = variance(first, 7 + k) + variance(second, 7 + k);
                add(
                    Differing::Centre,
                    by,
                    known + 2.0 * self.shared.parcentric_m.powi(2),
                );
            }
        }
        let mut links = self.links.iter();
        if let Some(link) =
            links.find(|l| [l.fixed.min(l.found), l.fixed.max(l.found)] == [a.min(b), a.max(b)])
        {
            all.extend(self.in_link(link).unwrap_or_default());
        }
        all
    }

    /// How far a link is from what both of its singles say.
    fn in_link(&self, link: &Link) -> Option<Vec<Difference>> {
        let both = [link.fixed, link.found].map(|o| &self.singles[o]);
        let stands = both.map(|s| Stand {
            optics: s.optics,
            pose: s.first,
        });
        let seen = link.off(self.shared.kinematics, &stands)?;
        let since_s = [link.fixed, link.found].map(|o| self.since_s(o));
        let variance = |r: usize| -> f64 {
            let of = |n: usize| -> f64 {
                let cell = |i: usize, j: usize| {
                    seen.by[n][i][r]
                        * both[n].covariance[SINGLE * (3 + i) + 3 + j]
                        * seen.by[n][j][r]
                };
                (0..STAND * STAND).map(|k| cell(k / STAND, k % STAND)).sum()
            };
            // What it may have drifted between the two.
            let drifts = [0, 1].map(|k| {
                let by = |n: usize| seen.by[n][OPTICS + k][r] * since_s[n];
                (self.shared.drift_m_per_s * (by(0) + by(1))).powi(2)
            });
            link.covariance[r][r] + of(0) + of(1) + drifts[0] + drifts[1]
        };
        let px_m = stands[0].optics.stage_from_pixel.det().abs().sqrt();
        let mut all = vec![
            Difference {
                what: Differing::Scale,
                by: seen.off[3].abs(),
                sigma: variance(3).sqrt(),
            },
            Difference {
                what: Differing::Angle,
                by: seen.off[2].abs(),
                sigma: variance(2).sqrt(),
            },
        ];
        if self.turns() {
            all.push(Difference {
                what: Differing::Centre,
                by: apart_m(&stands[0].optics, [seen.off[0], seen.off[1]]),
                sigma: px_m * variance(0).max(variance(1)).sqrt(),
            });
        }
        Some(all)
    }
}

/// The same without one link that all others contradict. A wrong image of an objective is told from a wrong objective where both that it shows
/// have another.
fn without_a_link(shared: &Shared, singles: &[Single], links: &[Link]) -> Option<SetFit> {
    (0..links.len()).find_map(|wrong| {
        let mut left = links.to_vec();
        let link = left.remove(wrong);
        let has_another = |o: usize| left.iter().any(|l| l.fixed == o || l.found == o);
        if !has_another(link.fixed) || !has_another(link.found) {
            return None;
        }
        let fit = Whole::new(shared, singles, &left)?.solve()?;
        fit.agrees().then_some(SetFit {
            left_out: Some(wrong),
            ..fit
        })
    })
}

/// One instrument of what each objective says by itself, where that agrees, without a link that all else contradicts. `None` where there are fewer than two, or a covariance is none.
///
/// # Panics
/// Where a link names an objective that is not there.
pub fn one_instrument(
    shared: &Shared,
    singles: &[Single],
    links: &[Link],
) -> Option<Result<SetFit, Apart>> {
    if singles.len() < 2 {
        return None;
    }
    let whole = Whole::new(shared, singles, links)?;
    let fit = whole.solve()?;
    if fit.agrees() {
        return Some(Ok(fit));
    }
    if let Some(fit) = without_a_link(shared, singles, links) {
        return Some(Ok(fit));
    }
    let without = |odd: usize| {
        let others: Vec<usize> = (0..singles.len()).filter(|o| *o != odd).collect();
        let place = |o: usize| others.iter().position(|other| *other == o);
        let left: Vec<Single> = others.iter().map(|o| singles[*o].clone()).collect();
        let between = links.iter().filter_map(|link| {
            Some(Link {
                fixed: place(link.fixed)?,
                found: place(link.found)?,
                ..link.clone()
            })
        });
        let between: Vec<Link> = between.collect();
        let fit = Whole::new(shared, &left, &between)?.solve()?;
        fit.agrees().then_some(odd)
    };
    let odd: Vec<usize> = match singles.len() {
        2 => Vec::new(),
        count => (0..count).filter_map(without).collect(),
    };
    let odd = match odd.as_slice() {
        [one] => Some(*one),
        _ => None,
    };
    let pairs = (0..singles.len()).flat_map(|a| (0..a).map(move |b| [b, a]));
    let pairs = pairs.filter(|pair| odd.is_none_or(|o| pair.contains(&o)));
    let differences = pairs.flat_map(|[a, b]| {
        let all = whole.differences(a, b);
        all.into_iter().map(move |d| ([a, b], d))
    });
    let sigmas = |d: &Difference| d.by / d.sigma;
    let (between, difference) =
        differences.max_by(|a, b| f64::total_cmp(&sigmas(&a.1), &sigmas(&b.1)))?;
    Some(Err(Apart {
        odd,
        between,
        difference,
    }))
}
