//! What states hold much of, in bytes: features, places, cells. In JSON these are base64, so that a state is small and its long parts can
//! be kept apart.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use scopeservo_sift::{Descriptor, Features, Keypoint};
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

const MAGIC: &[u8; 4] = b"SSF1";
/// Bytes of a feature.
const FEATURE: usize = 5 * 4 + 4 + 128;

/// Features in bytes, little endian: "SSF1", width, height, count (u32), then for each x, y, sigma, angle, response (f32), octave (i8),
/// layer (u8), bright (u8), 0, and 128 components (u8).
pub fn features_to_bytes(features: &Features) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    for number in [features.width, features.height, features.len()] {
        bytes.extend((number as u32).to_le_bytes());
    }
    for (k, d) in features.keypoints.iter().zip(&features.descriptors) {
        for v in [k.x, k.y, k.sigma, k.angle, k.response] {
            bytes.extend(v.to_le_bytes());
        }
        bytes.extend([k.octave as i8 as u8, k.layer as u8, u8::from(k.bright), 0]);
        bytes.extend(d.components());
    }
    bytes
}

/// The same back; else what is wrong with the bytes.
///
/// # Errors
/// A sentence for people.
pub fn features_from_bytes(bytes: &[u8]) -> Result<Features, String> {
    let short = || "the features are cut off".to_owned();
    let (magic, rest) = bytes.split_at_checked(4).ok_or_else(short)?;
    let (sizes, rest) = rest.split_at_checked(12).ok_or_else(short)?;
    let [width, height, count] = [0, 4, 8].map(|i| {
        let mut four = [0; 4];
        four.copy_from_slice(&sizes[i..i + 4]);
        u32::from_le_bytes(four) as usize
    });
    if magic != MAGIC || count.checked_mul(FEATURE) != Some(rest.len()) {
        return Err(short());
    }
    let mut features = Features {
        width,
        height,
        ..Features::default()
    };
    for one in rest.chunks_exact(FEATURE) {
        let real = |i: usize| {
            let mut four = [0; 4];
            four.copy_from_slice(&one[4 * i..4 * i + 4]);
            f32::from_le_bytes(four)
        };
        features.keypoints.push(Keypoint {
            x: real(0),
            y: real(1),
            sigma: real(2),
            angle: real(3),
            response: real(4),
            octave: i32::from(one[20] as i8),
            layer: u32::from(one[21]),
            bright: one[22] != 0,
        });
        let mut components = [0; 128];
        components.copy_from_slice(&one[24..]);
        let descriptor = Descriptor::new(components).map_err(|e| e.to_string())?;
        features.descriptors.push(descriptor);
    }
    features.check().map_err(|e| e.to_string())?;
    Ok(features)
}

/// For `#[serde(with = ...)]`: features that may be missing.
pub(crate) mod features {
    use super::*;

    pub(crate) fn serialize<S: Serializer>(f: &Option<Features>, to: S) -> Result<S::Ok, S::Error> {
        let text = f.as_ref().map(|f| STANDARD.encode(features_to_bytes(f)));
        text.serialize(to)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Option<Features>, D::Error> {
        let text = Option::<String>::deserialize(from)?;
        text.map(|text| {
            let bytes = STANDARD.decode(text).map_err(D::Error::custom)?;
            features_from_bytes(&bytes).map_err(D::Error::custom)
        })
        .transpose()
    }
}

/// For `#[serde(with = ...)]`: lists of N numbers of four bytes each.
pub(crate) mod numbers {
    use super::*;

    /// A number of four bytes.
    pub(crate) trait Number: Copy {
        fn bytes(self) -> [u8; 4];
        fn of(bytes: [u8; 4]) -> Self;
    }

    impl Number for f32 {
        fn bytes(self) -> [u8; 4] {
            self.to_le_bytes()
        }
        fn of(bytes: [u8; 4]) -> Self {
            Self::from_le_bytes(bytes)
        }
    }

    impl Number for u32 {
        fn bytes(self) -> [u8; 4] {
            self.to_le_bytes()
        }
        fn of(bytes: [u8; 4]) -> Self {
            Self::from_le_bytes(bytes)
        }
    }

    pub(crate) fn serialize<S: Serializer, T: Number, const N: usize>(
        list: &[[T; N]],
        to: S,
    ) -> Result<S::Ok, S::Error> {
        let bytes: Vec<u8> = list.iter().flatten().flat_map(|v| v.bytes()).collect();
        STANDARD.encode(bytes).serialize(to)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>, T: Number, const N: usize>(
        from: D,
    ) -> Result<Vec<[T; N]>, D::Error> {
        let text = String::deserialize(from)?;
        let bytes = STANDARD.decode(text).map_err(D::Error::custom)?;
        if bytes.len() % (4 * N) != 0 {
            return Err(D::Error::custom("a list of numbers is cut off"));
        }
        let number = |four: &[u8]| T::of([four[0], four[1], four[2], four[3]]);
        let row = |row: &[u8]| std::array::from_fn(|i| number(&row[4 * i..4 * i + 4]));
        Ok(bytes.chunks_exact(4 * N).map(row).collect())
    }
}

/// For `#[serde(with = ...)]`: a list of whole numbers.
pub(crate) mod cells {
    use super::*;

    pub(crate) fn serialize<S: Serializer>(list: &[u32], to: S) -> Result<S::Ok, S::Error> {
        let rows: Vec<[u32; 1]> = list.iter().map(|v| [*v]).collect();
        numbers::serialize(&rows, to)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<u32>, D::Error> {
        let rows: Vec<[u32; 1]> = numbers::deserialize(from)?;
        Ok(rows.into_iter().flatten().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct State {
        #[serde(with = "features")]
        reference: Option<Features>,
        #[serde(with = "numbers")]
        places: Vec<[f32; 3]>,
    }

    #[test]
    fn a_state_comes_back_to_the_last_bit_and_what_is_cut_off_is_noticed() {
        let keypoint = Keypoint {
            x: 1.25,
            y: 3.0,
            sigma: 2.5,
            angle: -1.0,
            response: 0.01,
            bright: true,
            octave: -1,
            layer: 2,
        };
        let state = State {
            reference: Some(Features {
                width: 4,
                height: 5,
                keypoints: vec![keypoint; 3],
                descriptors: (0..3).map(|i| Descriptor::new([i; 128]).unwrap()).collect(),
            }),
            places: vec![[0.1, f32::MAX, -3.0], [4.0, 5.0, 6.0]],
        };
        let json = serde_json::to_string(&state).unwrap();
        assert_eq!(serde_json::from_str::<State>(&json).unwrap(), state);
        let bytes = features_to_bytes(state.reference.as_ref().unwrap());
        for cut in 0..bytes.len() {
            assert!(features_from_bytes(&bytes[..cut]).is_err(), "{cut}");
        }
        let none = State {
            reference: None,
            places: Vec::new(),
        };
        let json = serde_json::to_string(&none).unwrap();
        assert_eq!(serde_json::from_str::<State>(&json).unwrap(), none);
    }
}
