//! What else a view shows that is like the target, beside a transform that was found otherwise.

use super::search::{self, Peak};
use super::{AS_HIGH, ELSEWHERE, ELSEWHERE_RAD, Levels, Picture, REACH, Run, size};
use crate::corners::centre;
use crate::{Options, Prior, Rival, ScalePrior};
use rayon::prelude::*;
use scopeservo_geometry::Affine2;

/// What blocks agree on is another place when it is shifted by so many pixels of the view.
const ELSEWHERE_PX: f64 = 8.0;

/// What is nearly as like the target as anything, at any angle, beside a transform that was found otherwise: rivals on which the pixels are to be asked.
/// None where that one is not as like it itself, as of a target of which half is in view: then this says nothing.
pub fn look_alikes(
    view: &Picture<'_>,
    target: &Picture<'_>,
    scale: ScalePrior,
    first: &Affine2,
    options: &Options,
) -> Vec<Rival> {
    let levels = Levels::of(view, target, scale.ratio);
    let prior = Prior {
        scale: Some(scale),
        ..Prior::default()
    };
    let mut run = Run {
        view,
        target,
        periods_px: &[],
        levels: &levels,
        planes: Vec::new(),
        prior: &prior,
        options,
        perhaps: Vec::new(),
    };
    run.beside(first).unwrap_or_default()
}

impl Run<'_> {
    fn beside(&mut self, first: &Affine2) -> Option<Vec<Rival>> {
        let middle = first.inverse()?.apply(centre(size(self.target)));
        self.make(1);
        let matched = self.at(0)?;
        let peaks = search::peaks(&matched, &search::angles(&matched, None));
        let highest = peaks.first()?.height;
        let rough = |peak: &Peak| peak.target_from_view(&matched);
        let alike = peaks.iter().filter(|p| p.height >= AS_HIGH[1] * highest);
        let alike: Vec<Rival> = alike
            .filter_map(|peak| Rival::beside(first, &rough(peak), middle, [0, 1]))
            .collect();
        let is_elsewhere = |rival: &Rival, by_px: f64| {
            let shift_px = f64::hypot(rival.shift_px[0], rival.shift_px[1]);
            shift_px > by_px || rival.turn_rad.abs() > ELSEWHERE_RAD
        };
        let px = first.linear.det().abs().sqrt();
        let by_samples = ELSEWHERE * px * matched.view.every as f64;
        let (elsewhere, here): (Vec<Rival>, Vec<Rival>) = alike
            .into_iter()
            .partition(|rival| is_elsewhere(rival, by_samples));
        if here.is_empty() || elsewhere.is_empty() {
            return None;
        }
        // The pixels are asked at the places that the blocks agree on: a peak is known to a sample, which is several pixels of a large camera.
        self.make(usize::MAX);
        let matched = self.at(0)?;
        let precise = |rival: Rival| {
            let agreed = self.agreed(&matched, &rival.target_from_view, REACH[0]);
            let finest = agreed.map(|agreed| self.finer(agreed));
            let told = finest
                .as_ref()
                .and_then(|agreed| agreed.registration.found())
                .and_then(|e| Rival::beside(first, &e.target_from_view, middle, [0, 1]))
                .unwrap_or(rival);
            Rival {
                significant: true,
                ..told
            }
        };
        let all = elsewhere.into_par_iter().map(precise);
        Some(
            all.filter(|rival| is_elsewhere(rival, ELSEWHERE_PX * px))
                .collect(),
        )
    }
}
