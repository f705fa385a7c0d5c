//! Features as bytes, for files and states.

use crate::sift_engine;
use crate::{Descriptors, FeatureError, Features, Keypoint};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Those of any engine.
const MAGIC: &[u8; 4] = b"SSF2";
/// SIFT alone, as it was written before there was more than one engine.
const SIFT_ONLY: &[u8; 4] = b"SSF1";
/// Bytes of a keypoint.
const KEYPOINT: usize = 5 * 4 + 4;

fn to_text(features: &Features) -> String {
    STANDARD.encode(features.to_bytes())
}

fn from_text(text: &str) -> Result<Features, FeatureError> {
    let bytes = STANDARD.decode(text);
    Features::from_bytes(&bytes.map_err(|e| FeatureError::Damaged(e.to_string()))?)
}

impl Features {
    /// In bytes, little endian: "SSF2", the length of the engine's name and the name, width, height, count (u32), form (u32: 0 bytes, 1 bits,
    /// 2 floats), components of a descriptor (u32); then for each x, y, sigma, angle, response (f32), octave (i8), layer (u8), bright
    /// (u8), 0, and the components (u8 or f32).
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        let mut whole = |number: usize| bytes.extend((number as u32).to_le_bytes());
        whole(self.engine.len());
        bytes.extend(self.engine.as_bytes());
        let (form, length) = match &self.descriptors {
            Descriptors::Bytes { length, .. } => (0, *length),
            Descriptors::Bits { length, .. } => (1, *length),
            Descriptors::Floats { length, .. } => (2, *length),
        };
        for number in [self.width, self.height, self.len(), form, length] {
            bytes.extend((number as u32).to_le_bytes());
        }
        for (i, k) in self.keypoints.iter().enumerate() {
            for v in [k.x, k.y, k.sigma, k.angle, k.response] {
                bytes.extend(v.to_le_bytes());
            }
            bytes.extend([k.octave as i8 as u8, k.layer as u8, u8::from(k.bright), 0]);
            let own = i * length..(i + 1) * length;
            match &self.descriptors {
                Descriptors::Bytes { data, .. } | Descriptors::Bits { data, .. } => {
                    bytes.extend_from_slice(&data[own]);
                }
                Descriptors::Floats { data, .. } => {
                    bytes.extend(data[own].iter().flat_map(|v| v.to_le_bytes()));
                }
            }
        }
        bytes
    }

    /// The same back, checked.
    ///
    /// # Errors
    /// [`FeatureError::Damaged`], or what [`check`](Self::check) finds.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FeatureError> {
        let features =
            read(bytes).ok_or_else(|| FeatureError::Damaged("they are cut off".into()))?;
        if features.engine == sift_engine::NAME {
            // Its bytes have bounds that matching leans on.
            sift_engine::typed(&features)?;
        }
        features.check()?;
        Ok(features)
    }
}

/// Takes the parts off, one after the other.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn take(&mut self, n: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(n)?;
        self.0 = rest;
        Some(taken)
    }

    fn four(&mut self) -> Option<[u8; 4]> {
        self.take(4)?.try_into().ok()
    }

    fn whole(&mut self) -> Option<usize> {
        Some(u32::from_le_bytes(self.four()?) as usize)
    }

    fn real(&mut self) -> Option<f32> {
        Some(f32::from_le_bytes(self.four()?))
    }
}

fn read(bytes: &[u8]) -> Option<Features> {
    let mut rest = Rest(bytes);
    let magic = rest.four()?;
    let engine = match &magic {
        MAGIC => {
            let length = rest.whole()?;
            String::from_utf8(rest.take(length)?.to_vec()).ok()?
        }
        SIFT_ONLY => sift_engine::NAME.into(),
        _ => return None,
    };
    let [width, height, count] = [rest.whole()?, rest.whole()?, rest.whole()?];
    let (form, length) = match &magic {
        MAGIC => (rest.whole()?, rest.whole()?),
        _ => (0, sift_engine::COMPONENTS),
    };
    let size = if form == 2 { 4 } else { 1 };
    let each = length.checked_mul(size)?.checked_add(KEYPOINT)?;
    if count.checked_mul(each)? != rest.0.len() {
        return None;
    }
    let mut keypoints = Vec::with_capacity(count);
    let mut data = Vec::with_capacity(count * length * size);
    for _ in 0..count {
        let [x, y, sigma, angle, response] = [
            rest.real()?,
            rest.real()?,
            rest.real()?,
            rest.real()?,
            rest.real()?,
        ];
        let [octave, layer, bright, _] = rest.four()?;
        keypoints.push(Keypoint {
            x,
            y,
            sigma,
            angle,
            response,
            octave: i32::from(octave as i8),
            layer: u32::from(layer),
            bright: bright != 0,
        });
        data.extend_from_slice(rest.take(length * size)?);
    }
    let descriptors = match form {
        0 => Descriptors::Bytes { length, data },
        1 => Descriptors::Bits { length, data },
        2 => Descriptors::Floats {
            length,
            data: data
                .as_chunks()
                .0
                .iter()
                .map(|four| f32::from_le_bytes(*four))
                .collect(),
        },
        _ => return None,
    };
    Some(Features {
        engine,
        width,
        height,
        keypoints,
        descriptors,
    })
}

impl Serialize for Features {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to_text(self).serialize(to)
    }
}

impl<'de> Deserialize<'de> for Features {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        /// As text, and as it was written out before there was more than one engine.
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Stored {
            Text(String),
            Written(scopeservo_sift::Features),
        }
        let features = match Stored::deserialize(from)? {
            Stored::Text(text) => from_text(&text),
            Stored::Written(features) => {
                let features = Self::from(&features);
                features.check().map(|()| features)
            }
        };
        features.map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features(engine: &str, descriptors: Descriptors) -> Features {
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
        Features {
            engine: engine.into(),
            width: 4,
            height: 5,
            keypoints: vec![keypoint; descriptors.len()],
            descriptors,
        }
    }

    #[test]
    fn features_of_any_form_come_back_to_the_last_bit_and_what_is_cut_off_is_noticed() {
        let forms = [
            Descriptors::Bytes {
                length: 3,
                data: vec![0, 1, 2, 253, 254, 255],
            },
            Descriptors::Bits {
                length: 2,
                data: vec![0xa5; 6],
            },
            Descriptors::Floats {
                length: 2,
                data: vec![0.6, -0.8, f32::MIN_POSITIVE, 1.0],
            },
        ];
        for form in forms {
            let features = features("corners of mine", form);
            let bytes = features.to_bytes();
            assert_eq!(Features::from_bytes(&bytes), Ok(features.clone()));
            for cut in 0..bytes.len() {
                assert!(Features::from_bytes(&bytes[..cut]).is_err(), "{cut}");
            }
            let json = serde_json::to_string(&features).unwrap();
            assert_eq!(serde_json::from_str::<Features>(&json).unwrap(), features);
        }
    }

    #[test]
    fn what_was_written_when_there_was_one_engine_is_read() {
        let sift = features(
            sift_engine::NAME,
            Descriptors::Bytes {
                length: 128,
                data: vec![7; 256],
            },
        );
        let mut bytes = SIFT_ONLY.to_vec();
        bytes.extend(&sift.to_bytes()[8 + sift.engine.len()..]);
        // No form and no length then.
        bytes.drain(16..24);
        assert_eq!(Features::from_bytes(&bytes), Ok(sift.clone()));
        let written = serde_json::to_string(&sift_engine::typed(&sift).unwrap()).unwrap();
        assert_eq!(serde_json::from_str::<Features>(&written).unwrap(), sift);
        // A byte that no descriptor of SIFT can have would be a wrong distance later.
        *bytes.last_mut().unwrap() = 200;
        assert!(Features::from_bytes(&bytes).is_err());
    }
}
