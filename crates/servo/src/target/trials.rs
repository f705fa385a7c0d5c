//! How surely a saved view is come back to: it is looked for in views made of it, as each objective would show them, under worse conditions than
//! a run meets. How often it is found there says how often runs come back (docs/measured.md has the study).

use super::Target;
use super::quality::{LIKELY, TargetQuality, Tried, Weakness};
use crate::localize::with_localizer;
use crate::servo::places::LEAST_HEIGHT;
use crate::vision::centre_px;
use crate::{Expected, FixedPlaces, ServoError, VisionOptions};
use scopeservo_features::{FeatureError, Features, GrayImage, Keypoint, noise_sigma};
use scopeservo_geometry::{Affine2, Mat2, SplitMix64, Vec2};
use scopeservo_registration::likeness::Plane;
use scopeservo_registration::{Prior, RotationPrior, ScalePrior};
use scopeservo_scope::Objective;
use std::f64::consts::PI;

/// Views made for the lowest objective, for each in between, and for the target's own.
const VIEWS: [usize; 3] = [24, 8, 8];
/// A pixel of the view averages what it covers: the standard deviation of a square of that side, with the blur of the optics.
const PIXEL_SIGMA: f64 = 0.4;
/// The worst of what views are made with: blur, pixels of the view; noise, of full scale; share of the target that is covered.
const BLUR_PX: f64 = 1.2;
const NOISE: [f64; 2] = [0.005, 0.02];
const COVERED: f64 = 0.3;
/// An image whose brightest thousandth is below this fills little of its range; its views have up to so many times its own noise.
const DIM: f32 = 0.25;
const NOISIER: f64 = 4.0;
/// Under the target's own objective it lies so far from the middle, as a share of the view, and is turned by so much, rad.
const ASIDE: f64 = 0.15;
const TURNED_RAD: f64 = 0.03;
/// A view is found when all corners of the target land within this of where they are, target pixels.
const RIGHT_PX: f64 = 12.0;
/// Where a target may lie, it does when its middle is within this of there, pixels of the view.
const LIKELY_PX: f64 = 6.0;
/// Features are counted in so many squares along the shorter side.
const SQUARES: usize = 8;
/// What lies within less of the image than this lies in a corner; features on less of it are few.
const CORNER: f64 = 0.25;
const SPARSE: f64 = 0.2;
/// More than this is said of no target: what lies around it is not known.
const MOST: f64 = 0.98;
/// What lies along a line has a spread across it of at most this share of that along it.
const LINE: f64 = 0.12;
/// Fewer features are few.
const FEW: usize = 150;
/// Tries a target whose image is `image`. `objectives` are those of the instrument; a pixel of the target is `um_per_px`.
pub(super) fn tried(
    target: &Target,
    image: &GrayImage,
    objectives: &[Objective],
    um_per_px: f64,
    vision: &VisionOptions,
) -> Result<TargetQuality, ServoError> {
    let ladder = ladder(target, objectives);
    let own_scale = ladder.last().map_or(um_per_px, |o| o.nominal_um_per_px);
    let (mut all, mut sigmas) = (Vec::new(), Vec::new());
    let noisiest = noisiest(image);
    for (k, objective) in ladder.iter().enumerate() {
        let is_own = k + 1 == ladder.len();
        let views = VIEWS[if is_own { 2 } else { k.min(1) }];
        let ratio = objective.nominal_um_per_px / own_scale;
        let mut rng = SplitMix64::new(0x007A_26E7 + k as u64);
        let mut seen = Tried {
            objective: objective.id.clone(),
            views,
            found: 0,
            misled: 0,
        };
        for _ in 0..views {
            let mut made = Made::draw(&mut rng, image, ratio, is_own);
            made.noise = made.noise.min(noisiest);
            let view = made.view(image, &mut rng)?;
            match made.located(&view, target, vision)? {
                Found::Right(sigma) => {
                    seen.found += 1;
                    sigmas.extend(is_own.then_some(sigma));
                }
                Found::Wrong => seen.misled += 1,
                // A higher objective looks where it may lie.
                Found::Not if !is_own => {
                    seen.found += usize::from(made.is_likely(&view, target, vision));
                }
                Found::Not => {}
            }
        }
        all.push(seen);
    }
    let median = |of: fn(&[f64; 2]) -> f64| {
        let mut all: Vec<f64> = sigmas.iter().map(of).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied()
    };
    let textured = textured(&target.features);
    let chance = chance(&all);
    Ok(TargetQuality {
        chance,
        features: target.features.len(),
        textured,
        sigma_um: median(|s| s[0]).map(|px| px * um_per_px),
        sigma_deg: median(|s| s[1]).map(f64::to_degrees),
        weakness: weakness(target, textured, &all, chance),
        tried: all,
    })
}

/// The most noise that views are made with, of full scale. An image that fills little of its range comes from a sensor of fewer bits than its
/// numbers have, so that full scale says nothing of it: its own noise does.
fn noisiest(image: &GrayImage) -> f64 {
    let mut levels: Vec<f32> = image.data().iter().step_by(7).copied().collect();
    let rank = levels.len() - 1 - levels.len() / 1000;
    let brightest = *levels.select_nth_unstable_by(rank, f32::total_cmp).1;
    match brightest < DIM {
        true => NOISIER * f64::from(noise_sigma(image)),
        false => f64::INFINITY,
    }
}

/// The objectives up to the target's own, which comes last.
fn ladder<'a>(target: &Target, objectives: &'a [Objective]) -> Vec<&'a Objective> {
    let own = objectives.iter().find(|o| o.id == target.objective);
    // Another of the same magnification is no step on the way, as in a run.
    let below = |o: &&Objective| {
        own.is_some_and(|own| o.id == own.id || o.magnification < own.magnification)
    };
    let mut ladder: Vec<&Objective> = objectives.iter().filter(below).collect();
    ladder.sort_by(|a, b| a.magnification.total_cmp(&b.magnification));
    ladder
}

/// A run comes back when the lowest objective sees the target, and its own tells it: by how many of the harder views did.
fn chance(tried: &[Tried]) -> f64 {
    let ends = [tried.first(), tried.last()].into_iter().flatten();
    ends.map(Tried::share).fold(MOST, f64::min)
}

fn weakness(target: &Target, textured: f64, tried: &[Tried], chance: f64) -> Option<Weakness> {
    if chance >= LIKELY {
        return (!target.periods_px.is_empty()).then_some(Weakness::Repeats);
    }
    let own = tried.last().map_or(0.0, Tried::share);
    Some(match target.features.len() {
        _ if across(&target.features) < LINE => Weakness::OneLine,
        _ if extent(&target.features) < CORNER => Weakness::OneCorner,
        n if n >= FEW && textured >= SPARSE && own >= LIKELY => Weakness::TooFine,
        _ => Weakness::FewFeatures,
    })
}

/// Share of the image's area between the places that leave out a twentieth of the features at each side.
fn extent(features: &Features) -> f64 {
    let side = |of: fn(&Keypoint) -> f32, size: usize| {
        let mut all: Vec<f32> = features.keypoints.iter().map(of).collect();
        all.sort_by(f32::total_cmp);
        let out = all.len() / 20;
        let ends = all.get(out).zip(all.get(all.len().saturating_sub(1 + out)));
        ends.map_or(0.0, |(a, b)| f64::from(b - a) / size as f64)
    };
    side(|k| k.x, features.width) * side(|k| k.y, features.height)
}

/// Share of the image's area with features in it.
fn textured(features: &Features) -> f64 {
    let side = (features.width.min(features.height) / SQUARES).max(1);
    let columns = features.width.div_ceil(side);
    let rows = features.height.div_ceil(side);
    let mut has = vec![false; columns * rows];
    for k in &features.keypoints {
        let at = [k.x, k.y].map(|v| v.max(0.0) as usize / side);
        has[at[1].min(rows - 1) * columns + at[0].min(columns - 1)] = true;
    }
    has.iter().filter(|h| **h).count() as f64 / has.len() as f64
}

/// How wide the features spread across the line along which they spread most, over how far along it.
fn across(features: &Features) -> f64 {
    let n = features.len().max(1) as f64;
    let mean = |of: &dyn Fn(Vec2) -> f64| {
        let places = features.keypoints.iter();
        places.map(|k| of([k.x, k.y].map(f64::from))).sum::<f64>() / n
    };
    let (x, y) = (mean(&|p| p[0]), mean(&|p| p[1]));
    let (xx, yy) = (mean(&|p| (p[0] - x).powi(2)), mean(&|p| (p[1] - y).powi(2)));
    let xy = mean(&|p| (p[0] - x) * (p[1] - y));
    let (half, off) = (0.5 * (xx + yy), f64::hypot(0.5 * (xx - yy), xy));
    ((half - off).max(0.0) / (half + off).max(f64::MIN_POSITIVE)).sqrt()
}

/// What became of one view.
enum Found {
    /// With the standard deviations of its place, px, and angle, rad.
    Right([f64; 2]),
    Wrong,
    Not,
}

/// How one view is made of the target's image.
struct Made {
    size: [usize; 2],
    target_from_view: Affine2,
    prior: Prior,
    /// Standard deviations of the blur, pixels of the target, and of the noise, of full scale.
    blur_px: f64,
    noise: f64,
    /// What is covered: the middle and half the sides, target pixels.
    cover: [Vec2; 2],
}

impl Made {
    fn draw(rng: &mut SplitMix64, image: &GrayImage, ratio: f64, is_own: bool) -> Self {
        let target = [image.width(), image.height()];
        let mut within = |half: f64| (2.0 * rng.uniform() - 1.0) * half;
        let (size, angle_rad, aside) = match is_own {
            true => (target, within(TURNED_RAD), [within(ASIDE), within(ASIDE)]),
            false => {
                // All of the target at any angle, and a little more.
                let side = f64::hypot(target[0] as f64, target[1] as f64) / ratio + 16.0;
                ([side as usize; 2], within(PI), [within(0.02), within(0.02)])
            }
        };
        let linear = Mat2::rotation(angle_rad) * ratio;
        let middle = |size: [usize; 2]| size.map(|n| (n as f64 - 1.0) / 2.0);
        let (view_middle, target_middle) = (middle(size), middle(target));
        let turned = linear * view_middle;
        let offset = [0, 1].map(|k| target_middle[k] + aside[k] * target[k] as f64 - turned[k]);
        let wide = 0.5 * (COVERED * (0.5 + within(0.5))).sqrt();
        let cover = [0, 1].map(|k| target_middle[k] + within(0.5) * target[k] as f64);
        Self {
            size,
            target_from_view: Affine2 { linear, offset },
            prior: Prior {
                scale: Some(ScalePrior {
                    ratio,
                    tolerance: 0.04,
                }),
                rotation: is_own.then_some(RotationPrior {
                    angle_rad: 0.0,
                    tolerance_rad: 0.1,
                }),
                ..Prior::default()
            },
            blur_px: ratio * f64::hypot(PIXEL_SIGMA, BLUR_PX * (0.5 + within(0.5))),
            noise: NOISE[0] + (NOISE[1] - NOISE[0]) * (0.5 + within(0.5)),
            cover: [cover, target.map(|side| wide * side as f64)],
        }
    }

    /// Beyond the target's image its edge goes on; what is covered has one brightness.
    fn view(&self, image: &GrayImage, rng: &mut SplitMix64) -> Result<GrayImage, ServoError> {
        let plane = Plane::new(image, self.blur_px);
        let last = [image.width() as f64 - 1.001, image.height() as f64 - 1.001];
        let [middle, half] = self.cover;
        let mean =
            image.data().iter().map(|v| f64::from(*v)).sum::<f64>() / image.data().len() as f64;
        let view = GrayImage::from_fn(self.size[0], self.size[1], |x, y| {
            let p = self.target_from_view.apply([x as f64, y as f64]);
            let covered = (0..2).all(|k| (p[k] - middle[k]).abs() < half[k]);
            let p = [0, 1].map(|k| p[k].clamp(0.0, last[k]));
            let light = match covered {
                true => mean,
                false => plane.at(p).unwrap_or(mean),
            };
            (light + self.noise * rng.normal()) as f32
        });
        Ok(view.map_err(FeatureError::from)?)
    }

    /// By the localizer that a run asks.
    fn located(
        &self,
        view: &GrayImage,
        target: &Target,
        vision: &VisionOptions,
    ) -> Result<Found, ServoError> {
        let fixed = FixedPlaces::default();
        let expected = self.expected(&fixed);
        let seen = with_localizer(vision, |l| l.locate(target, view, &expected))?;
        let (Ok(measured), Some(view_from_target)) = (seen, self.target_from_view.inverse()) else {
            return Ok(Found::Not);
        };
        let found = measured.estimate;
        let [w, h] = [target.features.width, target.features.height].map(|n| n as f64 - 1.0);
        let off = [[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]].map(|corner| {
            let seen = found.target_from_view.apply(view_from_target.apply(corner));
            f64::hypot(seen[0] - corner[0], seen[1] - corner[1])
        });
        Ok(match off.iter().all(|off| *off <= RIGHT_PX) {
            true => Found::Right([found.sigma_px, found.sigma_angle_rad]),
            false => Found::Wrong,
        })
    }

    /// Whether the most likely place of a target that was not found is where it is.
    fn is_likely(&self, view: &GrayImage, target: &Target, vision: &VisionOptions) -> bool {
        let fixed = FixedPlaces::default();
        let perhaps = with_localizer(vision, |l| l.perhaps(target, view, &self.expected(&fixed)));
        let (Some(first), Some(view_from_target)) =
            (perhaps.first(), self.target_from_view.inverse())
        else {
            return false;
        };
        let centre = centre_px(target.features.width, target.features.height);
        let seen = first.target_from_view.apply(view_from_target.apply(centre));
        let ratio = self.prior.scale.map_or(1.0, |s| s.ratio);
        let off_px = f64::hypot(seen[0] - centre[0], seen[1] - centre[1]) / ratio;
        first.height >= LEAST_HEIGHT && off_px <= LIKELY_PX
    }

    fn expected<'a>(&self, fixed: &'a FixedPlaces) -> Expected<'a> {
        Expected {
            prior: self.prior,
            fixed,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::{Immersion, ObjectiveId};

    fn objective(id: &str, magnification: f64, um_per_px: f64) -> Objective {
        Objective {
            id: ObjectiveId(id.into()),
            magnification,
            nominal_um_per_px: um_per_px,
            numerical_aperture: 0.25,
            immersion: Immersion::Air,
        }
    }

    fn objectives() -> Vec<Objective> {
        vec![
            objective("40x", 400.0, 0.5),
            objective("10x", 100.0, 2.2),
            objective("100x", 1000.0, 0.2),
        ]
    }

    /// Dark discs on glass, with a little noise.
    fn discs(at: &[[f64; 3]]) -> GrayImage {
        let mut rng = SplitMix64::new(5);
        GrayImage::from_fn(640, 480, |x, y| {
            let (x, y) = (x as f64, y as f64);
            let dark = at.iter().map(|[u, v, r]| {
                // Each has its own look.
                let (dx, dy) = (x - u, y - v);
                let shape = 1.0 + 0.3 * (3.0 * dy.atan2(dx) + u + v).sin();
                0.5 / (1.0 + (f64::hypot(dx, dy) - r * shape).exp())
            });
            (0.8 - dark.fold(0.0, f64::max) + 0.004 * rng.normal()) as f32
        })
        .unwrap()
    }

    fn quality(image: &GrayImage) -> TargetQuality {
        let vision = VisionOptions::default();
        let target = Target {
            objective: ObjectiveId("40x".into()),
            features: vision.of_target(image).unwrap(),
            picture: None,
            periods_px: Vec::new(),
            moved: None,
            mask: None,
            quality: None,
            taken: None,
        };
        tried(&target, image, &objectives(), 0.5, &vision).unwrap()
    }

    fn scattered(count: usize, [x, y]: Vec2, [w, h]: Vec2, seed: u64) -> Vec<[f64; 3]> {
        let mut rng = SplitMix64::new(seed);
        let mut one = || {
            let r = 4.0 + 8.0 * rng.uniform();
            [x + w * rng.uniform(), y + h * rng.uniform(), r]
        };
        (0..count).map(|_| one()).collect()
    }

    #[test]
    fn a_full_view_is_likely_and_objectives_above_it_are_not_asked() {
        let full = quality(&discs(&scattered(300, [0.0; 2], [640.0, 480.0], 1)));
        let asked: Vec<&str> = full.tried.iter().map(|t| t.objective.0.as_str()).collect();
        assert_eq!(asked, ["10x", "40x"]);
        assert!(full.can_be_told() && full.weakness.is_none(), "{full:?}");
        assert!(
            full.textured > 0.7 && full.sigma_um.unwrap() < 0.1,
            "{full:?}"
        );
        assert_eq!(full.tried.iter().map(|t| t.misled).sum::<usize>(), 0);
    }

    #[test]
    fn what_is_hard_to_come_back_to_is_told_with_the_reason() {
        let blank = quality(&discs(&[]));
        assert!(blank.is_hopeless(), "{blank:?}");
        let corner = quality(&discs(&scattered(12, [20.0, 20.0], [110.0, 90.0], 2)));
        assert!(!corner.can_be_told(), "{corner:?}");
        assert_eq!(corner.weakness, Some(Weakness::OneCorner), "{corner:?}");
        let line: Vec<[f64; 3]> = (0..40)
            .map(|k| [16.0 * k as f64, 240.0 + (k % 3) as f64, 5.0])
            .collect();
        let line = quality(&discs(&line));
        assert!(!line.can_be_told(), "{line:?}");
        assert_eq!(line.weakness, Some(Weakness::OneLine), "{line:?}");
        let few = quality(&discs(&scattered(9, [0.0; 2], [640.0, 480.0], 3)));
        assert!(!few.can_be_told(), "{few:?}");
        // More of the same is better.
        let some = quality(&discs(&scattered(60, [0.0; 2], [640.0, 480.0], 3)));
        assert!(some.chance > few.chance, "{} {}", some.chance, few.chance);
    }

    #[test]
    fn the_same_view_has_the_same_chance() {
        let image = discs(&scattered(40, [0.0; 2], [640.0, 480.0], 4));
        assert_eq!(quality(&image), quality(&image));
    }
}
