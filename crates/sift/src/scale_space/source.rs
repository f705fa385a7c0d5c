//! Where the first level of an octave comes from.

use std::ops::Range;

use fearless_simd::{Simd, f32x8, prelude::*};

use super::plane::Plane;
use crate::GrayImage;

/// Rows that a level takes as they are.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Source<'a> {
    /// The image itself.
    Image(&'a GrayImage),
    /// A plane as it is.
    Whole(&'a Plane),
    /// Every second pixel of every second row, starting with the first.
    Halved(&'a Plane),
}

impl Source<'_> {
    /// Columns and rows.
    pub(crate) fn size(&self) -> (usize, usize) {
        match self {
            Self::Image(i) => (i.width(), i.height()),
            Self::Whole(p) => (p.width, p.height),
            Self::Halved(p) => (p.width.div_ceil(2), p.height.div_ceil(2)),
        }
    }

    /// Columns `columns` of row `y`.
    #[inline(always)]
    pub(super) fn row<S: Simd>(&self, s: S, y: usize, columns: Range<usize>, out: &mut [f32]) {
        let out = &mut out[..columns.len()];
        match self {
            Self::Image(image) => {
                out.copy_from_slice(&image.data()[y * image.width()..][columns]);
            }
            Self::Whole(plane) => out.copy_from_slice(&plane.row(y)[columns]),
            Self::Halved(plane) => copy_even(s, &plane.row(2 * y)[2 * columns.start..], out),
        }
    }
}

/// The first, third, ... value of `row`, as many as `out` takes.
#[inline(always)]
pub(super) fn copy_even<S: Simd>(s: S, row: &[f32], out: &mut [f32]) {
    let whole = (row.len() / 16).min(out.len() / 8);
    let (runs, rest) = out.split_at_mut(8 * whole);
    for (out, row) in runs.chunks_exact_mut(8).zip(row.chunks_exact(16)) {
        let (low, high) = (
            f32x8::from_slice(s, &row[..8]),
            f32x8::from_slice(s, &row[8..]),
        );
        low.deinterleave(high).0.store_slice(out);
    }
    for (out, value) in rest.iter_mut().zip(row[16 * whole..].iter().step_by(2)) {
        *out = *value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Simd as Token;
    use crate::simd::at_level;

    #[test]
    fn copying_every_second_value_at_every_length() {
        let row: Vec<f32> = (0..90).map(|i| i as f32).collect();
        for simd in Token::available() {
            for n in 0..44 {
                for len in [2 * n, 2 * n + 1, 90] {
                    let mut out = vec![-1.0; n];
                    at_level!(simd, s => copy_even(s, &row[..len], &mut out));
                    assert!(
                        out.iter().enumerate().all(|(i, v)| *v == 2.0 * i as f32),
                        "{n}"
                    );
                }
            }
        }
    }
}
