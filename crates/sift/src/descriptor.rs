//! The descriptor as bytes.

use fearless_simd::{Simd, f32x8, i32x8, prelude::*};
use serde::de::{Error, SeqAccess, Visitor};
use serde::ser::SerializeTuple;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::SiftError;
use crate::simd::sum;

/// Greatest share of one component before the second normalisation.
const CUT: f32 = 0.2;

/// Bytes per unit of the square-rooted vector. A vector of unit length becomes one of at most `250 + sqrt(128) / 2 < 255.7`.
const QUANTUM: f32 = 250.0;

/// RootSIFT descriptor of 4 x 4 x 8 components: index `(row * 4 + column) * 8 + direction` in the keypoint's own frame,
/// `min(127, round(250 v))`, where `v` has unit length.
///
/// No component exceeds 127 and the squares sum to at most 65535. So a component fits a signed byte as well as an unsigned one,
/// the product of any two descriptors (and any part of it) fits 16 bits, and matching can multiply bytes and add 16-bit numbers
/// without ever losing a carry.
///
/// Squared distances are those of Hellinger between the histograms times 250^2, up to the rounding to bytes: at most `2 * 65535`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Descriptor([u8; 128]);

impl Descriptor {
    /// Greatest component.
    pub const MAX_COMPONENT: u8 = 127;

    /// Greatest sum of squared components.
    pub const MAX_NORM_SQ: u32 = 65535;

    /// That of a place without structure.
    pub const ZERO: Self = Self([0; 128]);

    /// A descriptor of these components.
    ///
    /// # Errors
    /// [`SiftError::DescriptorRange`] when one exceeds [`MAX_COMPONENT`](Self::MAX_COMPONENT) or the sum of squares
    /// [`MAX_NORM_SQ`](Self::MAX_NORM_SQ).
    pub fn new(components: [u8; 128]) -> Result<Self, SiftError> {
        let descriptor = Self(components);
        let (greatest, norm_sq) = (
            components.into_iter().fold(0, u8::max),
            descriptor.norm_sq(),
        );
        if greatest > Self::MAX_COMPONENT || norm_sq > Self::MAX_NORM_SQ {
            return Err(SiftError::DescriptorRange { greatest, norm_sq });
        }
        Ok(descriptor)
    }

    /// The 128 components.
    #[must_use]
    pub fn components(&self) -> &[u8; 128] {
        &self.0
    }

    /// Sum of squared components.
    #[inline(always)]
    #[must_use]
    pub fn norm_sq(&self) -> u32 {
        self.0.iter().map(|&v| u32::from(v) * u32::from(v)).sum()
    }
}

/// Normalise, cut, normalise, square root of the share, bytes. What is negative or not a number counts as 0.
#[inline(always)]
pub(crate) fn finish<S: Simd>(s: S, histogram: &[f32; 128]) -> Descriptor {
    let zero = f32x8::splat(s, 0.0);
    let mut norm_sq = zero;
    for values in histogram.chunks_exact(8) {
        let v = f32x8::from_slice(s, values);
        norm_sq = v.mul_add(v, norm_sq);
    }
    let scale = 1.0 / sum(norm_sq).sqrt().max(f32::MIN_POSITIVE);
    let cut = f32x8::splat(s, CUT);
    let mut values = [0.0; 128];
    let mut total = zero;
    for (out, values) in values.chunks_exact_mut(8).zip(histogram.chunks_exact(8)) {
        let v = f32x8::from_slice(s, values) * scale;
        let v = v.simd_gt(zero).select(v.min(cut), zero);
        v.store_slice(out);
        total += v;
    }
    // The second normalisation cancels in the division by the sum.
    let scale = 1.0 / sum(total).max(f32::MIN_POSITIVE);
    let most = f32x8::splat(s, f32::from(Descriptor::MAX_COMPONENT));
    let half = f32x8::splat(s, 0.5);
    let mut bytes = [0; 128];
    for (out, values) in bytes.chunks_exact_mut(8).zip(values.chunks_exact(8)) {
        let root = (f32x8::from_slice(s, values) * scale).sqrt();
        let rounded: i32x8<S> = root
            .mul_add(f32x8::splat(s, QUANTUM), half)
            .min(most)
            .to_int();
        for (out, v) in out.iter_mut().zip(rounded.to_array()) {
            *out = v as u8;
        }
    }
    Descriptor(bytes)
}

impl Serialize for Descriptor {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(128)?;
        for v in &self.0 {
            tuple.serialize_element(v)?;
        }
        tuple.end()
    }
}

impl<'de> Deserialize<'de> for Descriptor {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Bytes;
        impl<'de> Visitor<'de> for Bytes {
            type Value = Descriptor;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("128 descriptor components from 0 to 127")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Descriptor, A::Error> {
                let mut out = [0; 128];
                for (i, v) in out.iter_mut().enumerate() {
                    *v = seq
                        .next_element()?
                        .ok_or_else(|| A::Error::invalid_length(i, &self))?;
                }
                Descriptor::new(out).map_err(A::Error::custom)
            }
        }
        deserializer.deserialize_tuple(128, Bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::at_level;

    fn at_every_level(histogram: &[f32; 128]) -> Descriptor {
        let mut all =
            crate::Simd::available().map(|token| at_level!(token, s => finish(s, histogram)));
        let first = all.next().unwrap();
        assert!(all.all(|d| d == first));
        first
    }

    #[test]
    fn bounds_are_kept_by_every_way_in() {
        let mut v = [64; 128];
        v[0] = 127;
        assert!(
            Descriptor::new(v).is_err(),
            "127 * 64^2 + 127^2 is too long"
        );
        v = [0; 128];
        v[5] = 128;
        let e = Descriptor::new(v).unwrap_err();
        assert!(e.to_string().contains("128"), "{e}");
        assert!(serde_json::from_str::<Descriptor>(&format!("{v:?}")).is_err());
        v[5] = 127;
        assert_eq!(Descriptor::new(v).unwrap().norm_sq(), 127 * 127);
        // 255^2 + 510 = 65535: as long as can be.
        let longest: [u8; 128] = std::array::from_fn(|i| match i {
            0..4 => 127,
            4 => 31,
            5 => 7,
            6 => 3,
            _ => 0,
        });
        let norm_sq = Descriptor::new(longest).unwrap().norm_sq();
        assert!(norm_sq > 65500, "{norm_sq}");
    }

    #[test]
    fn any_histogram_gives_a_descriptor_within_bounds() {
        let one = |at: usize, v: f32| std::array::from_fn(|i| if i == at { v } else { 0.0 });
        let histograms: [[f32; 128]; 9] = [
            [0.0; 128],
            [1.0; 128],
            one(3, 1e-30),
            one(3, 1e30),
            one(3, f32::INFINITY),
            one(3, f32::NAN),
            [-1.0; 128],
            std::array::from_fn(|i| i as f32 - 5.0),
            // Every value rounds up: half a byte above a whole one.
            std::array::from_fn(|i| if i % 2 == 0 { 30.5 * 30.5 } else { 7.5 * 7.5 }),
        ];
        for h in &histograms {
            let d = at_every_level(h);
            assert_eq!(Descriptor::new(*d.components()), Ok(d), "{h:?}");
        }
        assert_eq!(at_every_level(&histograms[0]), Descriptor::ZERO);
        assert_eq!(at_every_level(&histograms[1]).components(), &[22; 128]);
        assert_eq!(at_every_level(&histograms[2]).components()[3], 127);
    }

    #[test]
    fn round_trip_and_wrong_length() {
        let d = Descriptor::new(std::array::from_fn(|i| i as u8 / 4)).unwrap();
        let text = serde_json::to_string(&d).unwrap();
        assert_eq!(serde_json::from_str::<Descriptor>(&text).unwrap(), d);
        assert!(serde_json::from_str::<Descriptor>("[1, 2, 3]").is_err());
        assert!(serde_json::from_str::<Descriptor>(&text.replace("[0,", "[0,0,")).is_err());
    }
}
