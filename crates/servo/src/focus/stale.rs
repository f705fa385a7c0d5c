//! Whether a sweep that found nothing was shown old images.

use super::levels::Plane;
use super::state::Focus;
use crate::vision::grab;
use crate::{FrameRole, ServoError, Sink};
use scopeservo_scope::{Instrument, Length, ScopeError};

/// So many images are looked at while nothing moves.
const LOOKS: usize = 12;
/// The last of them that must be the same.
const SAME: usize = 4;
/// Two images differ where their difference is so many times that of images that are the same but for their noise.
const DIFFERS: f64 = 2.0;

impl Focus {
    /// What a sweep without a focus has to answer, with the stage back where the sweep began. Images that go on changing there, and then no more,
    /// are old ones: so it goes once more to the end that is farther, which does not look the same, and back.
    pub(super) fn nothing_found(
        &self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<ServoError, ServoError> {
        let start_um = self.start_um.unwrap_or(f64::NAN);
        let way = |z_um: f64| (z_um - start_um).abs();
        let ends = [self.samples.first(), self.samples.last()];
        let ends = ends.into_iter().flatten().map(|s| s.z_um);
        if let Some(end_um) = ends.max_by(|a, b| way(*a).total_cmp(&way(*b))) {
            Self::go(scope, end_um)?;
            for _ in 0..LOOKS - SAME {
                grab(scope, sink, FrameRole::Focus, &self.objective.id)?;
            }
        }
        scope.return_to_height(Length::from_um(start_um))?;
        let mut looks = Vec::with_capacity(LOOKS);
        for _ in 0..LOOKS {
            let frame = grab(scope, sink, FrameRole::Focus, &self.objective.id)?;
            looks.push(Plane::of(&frame).smoothed());
        }
        Ok(match stale(&looks) {
            Some(frames) => ScopeError::Stale {
                device: "camera",
                frames,
            }
            .into(),
            None => self.no_focus(),
        })
    }
}

/// How many images at the beginning differ from those at the end, which are all the same. `None` where there is no such step, or no end to it.
fn stale(looks: &[Plane]) -> Option<usize> {
    let [earlier @ .., last] = looks else {
        return None;
    };
    let off: Vec<f64> = earlier.iter().map(|look| apart(look, last)).collect();
    let same = |off: &[f64]| {
        let most = off.iter().copied().fold(0.0, f64::max);
        let least = off.iter().copied().fold(f64::INFINITY, f64::min);
        most <= DIFFERS * least
    };
    // Those at the end are the same: then what is left between them is noise.
    let settled = (1..=off.len().saturating_sub(SAME - 1)).find(|&k| same(&off[k..]))?;
    let noise = off[settled..].iter().copied().fold(0.0, f64::max);
    let differ = off[..settled].iter().all(|o| *o > DIFFERS * noise);
    differ.then_some(settled)
}

/// Root mean square difference of two images over their light: a lamp that flickers changes nothing.
fn apart(a: &Plane, b: &Plane) -> f64 {
    let (light_a, light_b) = (a.mean().max(1e-9), b.mean().max(1e-9));
    let sum: f64 = std::iter::zip(&a.data, &b.data)
        .map(|(p, q)| (f64::from(*p) / light_a - f64::from(*q) / light_b).powi(2))
        .sum();
    (sum / a.data.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An image of a scene, with noise of its own.
    fn image(scene: f32, seed: u64) -> Plane {
        let mut rng = scopeservo_geometry::SplitMix64::new(seed);
        let data = (0..64 * 64).map(|k| {
            let wave = (k as f32 * scene).sin();
            0.5 + 0.2 * wave + 0.02 * (rng.uniform() as f32 - 0.5)
        });
        Plane {
            width: 64,
            height: 64,
            data: data.collect(),
        }
    }

    #[test]
    fn images_that_change_while_nothing_moves_and_then_no_more_are_old() {
        for late in [1, 3, 8] {
            let looks: Vec<Plane> = (0..LOOKS as u64)
                .map(|k| {
                    image(
                        if k < late as u64 {
                            0.1 + 0.05 * k as f32
                        } else {
                            0.9
                        },
                        k,
                    )
                })
                .collect();
            assert_eq!(stale(&looks), Some(late), "{late}");
        }
        let rests: Vec<Plane> = (0..LOOKS as u64).map(|k| image(0.9, k)).collect();
        assert_eq!(stale(&rests), None, "nothing changes");
        let drifts: Vec<Plane> = (0..LOOKS as u64)
            .map(|k| image(0.5 + 0.05 * k as f32, k))
            .collect();
        assert_eq!(stale(&drifts), None, "it goes on changing");
        let without_noise: Vec<Plane> = (0..LOOKS as u64).map(|_| image(0.9, 1)).collect();
        assert_eq!(stale(&without_noise), None, "all are the same");
    }
}
