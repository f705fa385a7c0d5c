//! JPEG 2000, decoded in one piece to 8 bits.

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
    let image = Image::new(bytes, &settings).map_err(|e| damaged(&e))?;
    let size = [image.width(), image.height()];
    crate::error::check_not_empty(size[0], size[1])?;
    let samples = usize::from(image.color_space().num_channels()) + usize::from(image.has_alpha());
    let count = u64::from(size[0]) * u64::from(size[1]) * samples as u64;
    budget.check(
        size,
        count.saturating_mul(BYTES_PER_SAMPLE) + bytes.len() as u64,
    )?;
    let decoded = image.decode().map_err(|e| damaged(&e))?;
    match decoded.len() as u64 == count {
        true => Ok((decoded, size, samples)),
        false => Err(Fault::Damaged(
            "the JPEG 2000 decodes to another size".into(),
        )),
    }
}
