//! What states hold much of, in bytes: places, cells. In JSON these are base64, so that a state is small and its long parts can be kept
//! apart.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

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

/// A size of two bytes, on a scale of ratios: right to 0.03 % from 1e-13 to 10, and 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Size(u16);

impl Size {
    const LEAST: f64 = 1e-13;
    const STEPS: f64 = 2000.0;

    pub(crate) fn get(self) -> f64 {
        match self.0 {
            0 => 0.0,
            n => Self::LEAST * (f64::from(n) / Self::STEPS).exp(),
        }
    }
}

impl From<f64> for Size {
    fn from(size: f64) -> Self {
        let steps = (size.max(0.0) / Self::LEAST).ln() * Self::STEPS;
        Self(steps.round().clamp(0.0, f64::from(u16::MAX)) as u16)
    }
}

/// For `#[serde(with = ...)]`: lists of sizes.
pub(crate) mod sizes {
    use super::*;

    pub(crate) fn serialize<S: Serializer>(list: &[Size], to: S) -> Result<S::Ok, S::Error> {
        let bytes: Vec<u8> = list.iter().flat_map(|size| size.0.to_le_bytes()).collect();
        STANDARD.encode(bytes).serialize(to)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Size>, D::Error> {
        let text = String::deserialize(from)?;
        let bytes = STANDARD.decode(text).map_err(D::Error::custom)?;
        if bytes.len() % 2 != 0 {
            return Err(D::Error::custom("a list of sizes is cut off"));
        }
        let size = |two: &[u8]| Size(u16::from_le_bytes([two[0], two[1]]));
        Ok(bytes.chunks_exact(2).map(size).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct State {
        #[serde(with = "numbers")]
        places: Vec<[f32; 3]>,
    }

    #[test]
    fn a_state_comes_back_to_the_last_bit_and_what_is_cut_off_is_noticed() {
        let state = State {
            places: vec![[0.1, f32::MAX, -3.0], [4.0, 5.0, 6.0]],
        };
        let json = serde_json::to_string(&state).unwrap();
        assert_eq!(serde_json::from_str::<State>(&json).unwrap(), state);
        let cut = r#"{"places": "zczMPf//f38="}"#;
        assert!(serde_json::from_str::<State>(cut).is_err());
    }

    #[test]
    fn sizes_of_two_bytes_are_right_to_a_third_of_a_thousandth() {
        for size in [2e-13, 1e-9, 3.7e-4, 1.0, 9.9] {
            assert!((Size::from(size).get() / size - 1.0).abs() < 3e-4, "{size}");
        }
        assert_eq!(Size::from(0.0).get(), 0.0);
        assert_eq!(Size::from(f64::NAN).get(), 0.0);
        assert!(Size::from(1e9).get() > 10.0);
    }
}
