//! What features look like, in the form that their engine gives it.

/// Descriptors of one length, one after the other.
#[derive(Debug, Clone, PartialEq)]
pub enum Descriptors {
    /// Whole numbers from 0 to 255, compared by their squared distance.
    Bytes {
        /// Components of each.
        length: usize,
        /// `length` for each feature.
        data: Vec<u8>,
    },
    /// Bits, compared by how many differ.
    Bits {
        /// Bytes of each.
        length: usize,
        /// `length` for each feature.
        data: Vec<u8>,
    },
    /// Vectors of unit length, compared by their squared distance.
    Floats {
        /// Components of each.
        length: usize,
        /// `length` for each feature.
        data: Vec<f32>,
    },
}

/// Squared distances of unit vectors are told in whole numbers, as those of vectors of this length.
const UNIT: f32 = 250.0;
const FARTHEST: f32 = 1e9;

impl Descriptors {
    /// None, of bytes.
    pub fn none() -> Self {
        Self::Bytes {
            length: 1,
            data: Vec::new(),
        }
    }

    /// How many there are; a rest that is no whole descriptor counts as one, so that it is noticed.
    pub fn len(&self) -> usize {
        match self {
            Self::Bytes { length, data } | Self::Bits { length, data } => {
                data.len().div_ceil((*length).max(1))
            }
            Self::Floats { length, data } => data.len().div_ceil((*length).max(1)),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Those at `indices`, in that order.
    ///
    /// # Panics
    /// When an index is not below [`len`](Self::len).
    pub fn subset(&self, indices: &[usize]) -> Self {
        fn of<T: Copy>(data: &[T], length: usize, indices: &[usize]) -> Vec<T> {
            let mut chosen = Vec::with_capacity(length * indices.len());
            for &i in indices {
                chosen.extend_from_slice(&data[i * length..(i + 1) * length]);
            }
            chosen
        }
        match self {
            Self::Bytes { length, data } => Self::Bytes {
                length: *length,
                data: of(data, *length, indices),
            },
            Self::Bits { length, data } => Self::Bits {
                length: *length,
                data: of(data, *length, indices),
            },
            Self::Floats { length, data } => Self::Floats {
                length: *length,
                data: of(data, *length, indices),
            },
        }
    }

    /// Squared distance of one to another; `None` when the two are of different forms or one is not there.
    pub fn distance_sq(&self, one: usize, others: &Self, other: usize) -> Option<u32> {
        match (self, others) {
            (Self::Bytes { length, data }, Self::Bytes { length: l, data: d }) if length == l => {
                let (a, b) = (at(data, *length, one)?, at(d, *length, other)?);
                let square = |(&a, &b): (&u8, &u8)| u32::from(a.abs_diff(b)).pow(2);
                Some(a.iter().zip(b).map(square).sum())
            }
            (Self::Bits { length, data }, Self::Bits { length: l, data: d }) if length == l => {
                let (a, b) = (at(data, *length, one)?, at(d, *length, other)?);
                Some(a.iter().zip(b).map(|(a, b)| (a ^ b).count_ones()).sum())
            }
            (Self::Floats { length, data }, Self::Floats { length: l, data: d }) if length == l => {
                let (a, b) = (at(data, *length, one)?, at(d, *length, other)?);
                let sum: f32 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
                // Also what is not a number: it is as far away as can be.
                Some((UNIT * UNIT * sum).min(FARTHEST) as u32)
            }
            _ => None,
        }
    }
}

fn at<T>(data: &[T], length: usize, index: usize) -> Option<&[T]> {
    data.get(index * length..(index + 1) * length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_squared_and_of_one_form_only() {
        let bytes = |data: &[u8]| Descriptors::Bytes {
            length: 2,
            data: data.to_vec(),
        };
        let (a, b) = (bytes(&[0, 0, 3, 4]), bytes(&[255, 0]));
        assert_eq!((a.len(), b.len()), (2, 1));
        assert_eq!(a.distance_sq(1, &a, 0), Some(25));
        assert_eq!(a.distance_sq(0, &b, 0), Some(255 * 255));
        assert_eq!(a.distance_sq(2, &b, 0), None);
        let bits = Descriptors::Bits {
            length: 2,
            data: vec![0b1010, 0xff, 0, 0xff],
        };
        assert_eq!(bits.distance_sq(0, &bits, 1), Some(2));
        assert_eq!(bits.distance_sq(0, &a, 0), None);
        let floats = Descriptors::Floats {
            length: 2,
            data: vec![1.0, 0.0, 0.0, 1.0, f32::NAN, 0.0],
        };
        assert_eq!(floats.distance_sq(0, &floats, 1), Some(2 * 250 * 250));
        assert_eq!(floats.distance_sq(0, &floats, 2), Some(FARTHEST as u32));
    }

    #[test]
    fn a_subset_is_in_the_order_asked_for() {
        let floats = Descriptors::Floats {
            length: 2,
            data: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        };
        let expected = Descriptors::Floats {
            length: 2,
            data: vec![5.0, 6.0, 1.0, 2.0],
        };
        assert_eq!(floats.subset(&[2, 0]), expected);
        assert_eq!(floats.subset(&[]).len(), 0);
        assert!(Descriptors::none().is_empty());
    }
}
