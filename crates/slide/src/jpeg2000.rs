//! JPEG 2000, decoded in one piece to 8 bits.

use std::panic::{AssertUnwindSafe, catch_unwind};

use hayro_jpeg2000::{DecodeSettings, Image};

use crate::{Budget, Fault};

/// Bytes that decoding holds for each sample.
const BYTES_PER_SAMPLE: u64 = 24;

/// Whether these are the first bytes of a JPEG 2000 file or of its bare codes.
pub(crate) fn begins(head: &[u8]) -> bool {
    head.starts_with(b"\0\0\0\x0cjP  ") || head.starts_with(b"\xff\x4f\xff\x51")
}

/// Samples, interleaved, of 8 bits; columns and rows; samples of a pixel.
pub(crate) fn decode(bytes: &[u8], budget: Budget) -> Result<(Vec<u8>, [u32; 2], usize), Fault> {
    let damaged =
        |e: &dyn std::fmt::Display| Fault::Damaged(format!("the JPEG 2000 makes no sense: {e}"));
    let settings = DecodeSettings {
        resolve_palette_indices: true,
        strict: true,
        target_resolution: None,
    };
    // The decoder is young: should it lose its way in damaged data, the data are damaged.
    let lost = |_| damaged(&"its decoder lost its way");
    let image = catch_unwind(|| Image::new(bytes, &settings)).map_err(lost)?;
    let image = image.map_err(|e| damaged(&e))?;
    let size = [image.width(), image.height()];
    crate::error::check_not_empty(size[0], size[1])?;
    let samples = usize::from(image.color_space().num_channels()) + usize::from(image.has_alpha());
    let count = u64::from(size[0]) * u64::from(size[1]) * samples as u64;
    budget.check(
        size,
        count.saturating_mul(BYTES_PER_SAMPLE) + bytes.len() as u64,
    )?;
    let decoded = catch_unwind(AssertUnwindSafe(|| image.decode())).map_err(lost)?;
    let decoded = decoded.map_err(|e| damaged(&e))?;
    match decoded.len() as u64 == count {
        true => Ok((decoded, size, samples)),
        false => Err(Fault::Damaged(
            "the JPEG 2000 decodes to another size".into(),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 16 x 12 pixels, `10 x + 7 y`, without loss.
    const SLOPE: &[u8] = include_bytes!("../tests/data/slope.j2k");

    const BUDGET: Budget = Budget { bytes: 1 << 20 };

    #[test]
    fn a_slope_comes_back() {
        assert!(begins(SLOPE));
        let (samples, size, channels) = decode(SLOPE, BUDGET).unwrap();
        assert_eq!((size, channels), ([16, 12], 1));
        for (i, v) in (0..).zip(samples) {
            assert_eq!(v, (10 * (i % 16) + 7 * (i / 16)) as u8);
        }
    }

    #[test]
    fn what_is_cut_or_too_large_is_refused() {
        for cut in [20, SLOPE.len() / 2, 60] {
            assert!(decode(&SLOPE[..cut], BUDGET).is_err(), "{cut}");
        }
        let mut large = SLOPE.to_vec();
        for at in [8, 12, 24, 28] {
            large[at..at + 4].copy_from_slice(&30_000_u32.to_be_bytes());
        }
        let e = decode(&large, BUDGET).unwrap_err();
        assert!(matches!(e, Fault::TooLarge { .. }), "{e}");
    }
}
