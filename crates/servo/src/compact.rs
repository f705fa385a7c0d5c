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
        #[serde(with = "numbers")]
        places: Vec<[f32; 3]>,
        #[serde(with = "cells")]
        cells: Vec<u32>,
    }

    #[test]
    fn a_state_comes_back_to_the_last_bit_and_what_is_cut_off_is_noticed() {
        let state = State {
            places: vec![[0.1, f32::MAX, -3.0], [4.0, 5.0, 6.0]],
            cells: vec![0, 7, u32::MAX],
        };
        let json = serde_json::to_string(&state).unwrap();
        assert_eq!(serde_json::from_str::<State>(&json).unwrap(), state);
        let cut = r#"{"places": "zczMPf//f38AAEDA", "cells": "AAAAAAc="}"#;
        assert!(serde_json::from_str::<State>(cut).is_err());
    }
}
