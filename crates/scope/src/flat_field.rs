//! The camera's fixed pattern: shadows of dust on the sensor's window, that every image is multiplied with.

use crate::ScopeError;

/// A pixel that lets less through is as good as black: dividing by less would show noise only.
const LEAST: f32 = 0.25;
/// Within so many pixels of a shadow the specimen is looked at as well, to tell whether the shadow is still there.
const RIM_PX: usize = 4;
/// A shadow of fewer pixels is noise.
const LEAST_AREA: usize = 9;
/// A shadow is there when an image shows at least this share of its depth.
const THERE: f64 = 0.5;

/// What share of the light each pixel of the camera gets, 1 where nothing lies on it.
///
/// Dust comes and goes: each shadow is divided out only where the image shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatField {
    width: usize,
    height: usize,
    /// Row by row.
    transmission: Vec<f32>,
    shadows: Vec<Shadow>,
}

/// One connected shadow.
#[derive(Debug, Clone, PartialEq)]
struct Shadow {
    pixels: Vec<u32>,
    /// The pixels around it.
    rim: Vec<u32>,
}

impl FlatField {
    /// From the transmission of `width * height` pixels, row by row.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`] when their number is another, or one of them is not in (0, 4].
    pub fn new(
        width: usize,
        height: usize,
        mut transmission: Vec<f32>,
    ) -> Result<Self, ScopeError> {
        if transmission.len() != width * height {
            return Err(ScopeError::BadSetting {
                what: format!(
                    "a fixed pattern of {width} x {height} pixels has {} values",
                    transmission.len()
                ),
            });
        }
        if let Some(bad) = transmission.iter().find(|t| !(**t > 0.0 && **t <= 4.0)) {
            return Err(ScopeError::BadSetting {
                what: format!("a pixel lets {bad} of the light through: that is no fixed pattern"),
            });
        }
        for t in &mut transmission {
            *t = t.max(LEAST);
        }
        let shadows = Self::connected(width, height, |i| transmission[i] != 1.0)
            .into_iter()
            .filter(|pixels| pixels.len() >= LEAST_AREA)
            .map(|pixels| Shadow {
                rim: Self::rim(width, height, &pixels, RIM_PX, |i| transmission[i] == 1.0),
                pixels,
            })
            .collect();
        Ok(Self {
            width,
            height,
            transmission,
            shadows,
        })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The share of the light that each pixel gets, row by row.
    pub fn transmission(&self) -> &[f32] {
        &self.transmission
    }

    /// How many shadows there are.
    pub fn shadows(&self) -> usize {
        self.shadows.len()
    }

    /// Divides the shadows that an image shows out of it, and tells how many these are. An image of another size is one of another
    /// camera, and stays as it is.
    pub fn correct(&self, width: usize, height: usize, luminance: &mut [f32]) -> usize {
        if [width, height] != [self.width, self.height] || luminance.len() != width * height {
            return 0;
        }
        let mut there = 0;
        for shadow in &self.shadows {
            if self
                .depth(shadow, luminance)
                .is_none_or(|depth| depth < THERE)
            {
                continue;
            }
            there += 1;
            for &i in &shadow.pixels {
                luminance[i as usize] /= self.transmission[i as usize];
            }
        }
        there
    }

    /// The 4-connected sets of the pixels that `holds` picks, each in order.
    pub fn connected(width: usize, height: usize, holds: impl Fn(usize) -> bool) -> Vec<Vec<u32>> {
        let mut seen = vec![false; width * height];
        let mut sets = Vec::new();
        for start in 0..width * height {
            if seen[start] || !holds(start) {
                continue;
            }
            seen[start] = true;
            let mut set = vec![start as u32];
            let mut next = 0;
            while let Some(&at) = set.get(next) {
                next += 1;
                for i in neighbours(width, height, at as usize) {
                    if !seen[i] && holds(i) {
                        seen[i] = true;
                        set.push(i as u32);
                    }
                }
            }
            set.sort_unstable();
            sets.push(set);
        }
        sets
    }

    /// The pixels within `steps` steps of a set that `free` picks.
    pub fn rim(
        width: usize,
        height: usize,
        set: &[u32],
        steps: usize,
        free: impl Fn(usize) -> bool,
    ) -> Vec<u32> {
        let mut all = std::collections::BTreeSet::new();
        let mut front = set.to_vec();
        for _ in 0..steps {
            let around: Vec<u32> = front
                .iter()
                .flat_map(|&i| neighbours(width, height, i as usize))
                .filter(|&i| free(i))
                .map(|i| i as u32)
                .collect();
            front = around.into_iter().filter(|i| all.insert(*i)).collect();
        }
        all.into_iter().collect()
    }

    /// How deep a shadow is in an image, as a share of how deep it was: the slope of the logarithms' regression over it and its rim.
    fn depth(&self, shadow: &Shadow, luminance: &[f32]) -> Option<f64> {
        let both = shadow.pixels.iter().chain(&shadow.rim).map(|&i| {
            let (t, l) = (self.transmission[i as usize], luminance[i as usize]);
            (f64::from(t.ln()), f64::from(l.max(1e-3).ln()))
        });
        let n = (shadow.pixels.len() + shadow.rim.len()) as f64;
        let (mut st, mut sl, mut stt, mut stl) = (0.0, 0.0, 0.0, 0.0);
        for (t, l) in both {
            st += t;
            sl += l;
            stt += t * t;
            stl += t * l;
        }
        let variance = stt - st * st / n;
        (variance > 1e-9).then(|| (stl - st * sl / n) / variance)
    }
}

fn neighbours(width: usize, height: usize, i: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (i % width, i / width);
    let all = [
        (x > 0).then(|| i - 1),
        (x + 1 < width).then(|| i + 1),
        (y > 0).then(|| i - width),
        (y + 1 < height).then(|| i + width),
    ];
    all.into_iter().flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two specks, 6 pixels wide, that let half and 0.8 of the light through.
    fn two_specks() -> FlatField {
        let t = |i: usize| match (i % 40, i / 40) {
            (5..=10, 5..=10) => 0.5,
            (25..=30, 12..=17) => 0.8,
            _ => 1.0,
        };
        FlatField::new(40, 24, (0..40 * 24).map(t).collect()).unwrap()
    }

    /// A specimen with a slope and some structure.
    fn specimen() -> Vec<f32> {
        let value = |i: usize| 100.0 + (i % 40) as f32 + 5.0 * ((i / 40) as f32).sin();
        (0..40 * 24).map(value).collect()
    }

    #[test]
    fn shadows_that_are_there_are_divided_out() {
        let field = two_specks();
        assert_eq!(field.shadows(), 2);
        let clean = specimen();
        let mut seen: Vec<f32> = clean
            .iter()
            .zip(field.transmission())
            .map(|(s, t)| s * t)
            .collect();
        assert_eq!(field.correct(40, 24, &mut seen), 2);
        for (a, b) in seen.iter().zip(&clean) {
            assert!((a - b).abs() < 1e-3, "{a} {b}");
        }
    }

    #[test]
    fn a_shadow_that_went_is_not_printed_into_the_picture() {
        let field = two_specks();
        let clean = specimen();
        let mut seen = clean.clone();
        assert_eq!(field.correct(40, 24, &mut seen), 0);
        assert_eq!(seen, clean);
        // One is still there.
        seen.iter_mut()
            .zip(field.transmission())
            .filter(|(_, t)| **t < 0.7)
            .for_each(|(s, t)| *s *= t);
        assert_eq!(field.correct(40, 24, &mut seen), 1);
    }

    #[test]
    fn what_is_no_pattern_is_refused_and_other_cameras_are_left_alone() {
        assert!(FlatField::new(4, 4, vec![1.0; 15]).is_err());
        for bad in [0.0, -1.0, f32::NAN, 5.0] {
            assert!(FlatField::new(1, 1, vec![bad]).is_err(), "{bad}");
        }
        let mut other = vec![0.5; 12];
        assert_eq!(two_specks().correct(4, 3, &mut other), 0);
        assert_eq!(other, [0.5; 12]);
    }
}
