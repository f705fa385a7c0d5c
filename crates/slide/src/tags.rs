//! What the tags of TIFF pages say: which pages are levels, what a pixel is made of and how large it is.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use tiff::decoder::Decoder;
use tiff::tags::Tag;
use tiff::{ColorType, TiffResult};

use crate::SlideError;

pub(crate) type Reader = Decoder<BufReader<File>>;

/// Pixel sizes that a microscope can have, um. Others are print resolutions.
const PLAUSIBLE_UM: std::ops::RangeInclusive<f64> = 0.05..=50.0;

/// Samples of one pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Layout {
    Gray,
    GrayAlpha,
    Rgb,
    Rgba,
    YCbCr,
}

impl Layout {
    pub(crate) fn samples(self) -> usize {
        match self {
            Layout::Gray => 1,
            Layout::GrayAlpha => 2,
            Layout::Rgb | Layout::YCbCr => 3,
            Layout::Rgba => 4,
        }
    }
}

/// The pages that are one image at falling resolution, given (page, width, height, tiled).
///
/// A file with tiled pages is a pyramid of those; its stripped pages are thumbnail, label and macro. A file without is
/// its first page.
pub(crate) fn levels_among(pages: &[(usize, u32, u32, bool)]) -> Vec<usize> {
    let area = |w: u32, h: u32| u64::from(w) * u64::from(h);
    let tiled: Vec<_> = pages.iter().filter(|p| p.3).collect();
    let Some(&&(_, w0, h0, _)) = tiled.iter().rev().max_by_key(|&&&(_, w, h, _)| area(w, h)) else {
        return vec![0];
    };
    let mut levels: Vec<_> = tiled
        .into_iter()
        .filter(|&&(_, w, h, _)| {
            let expected = f64::from(h0) * f64::from(w) / f64::from(w0);
            (f64::from(h) - expected).abs() <= (0.01 * expected).max(2.0)
        })
        .collect();
    levels.sort_by_key(|&&(page, w, h, _)| (std::cmp::Reverse(area(w, h)), page));
    levels.dedup_by_key(|&mut &(_, w, h, _)| (w, h));
    levels.into_iter().map(|p| p.0).collect()
}

pub(crate) fn layout_of(
    path: &Path,
    reader: &mut Reader,
    jpeg: bool,
) -> Result<(Layout, bool), SlideError> {
    let tiff = |e| SlideError::from_tiff(path, e);
    if let Some(kind) = sample_format(reader).map_err(tiff)?
        && kind != 1
    {
        return Err(SlideError::unsupported(
            path,
            "a TIFF of signed or floating-point samples",
        ));
    }
    let photometric = reader
        .find_tag_unsigned::<u16>(Tag::PhotometricInterpretation)
        .map_err(tiff)?;
    if photometric == Some(3) {
        return Err(SlideError::unsupported(
            path,
            "a TIFF with a colour palette",
        ));
    }
    let colour = reader.colortype().map_err(tiff)?;
    let alpha = reader
        .find_tag_unsigned_vec::<u16>(Tag::ExtraSamples)
        .map_err(tiff)?
        .is_some_and(|v| matches!(v.first(), Some(1 | 2)));
    let (layout, bits) = match colour {
        ColorType::Gray(bits) => (Layout::Gray, bits),
        ColorType::Multiband {
            bit_depth,
            num_samples: 2,
        } if alpha => (Layout::GrayAlpha, bit_depth),
        ColorType::RGB(bits) => (Layout::Rgb, bits),
        ColorType::RGBA(bits) => (Layout::Rgba, bits),
        ColorType::YCbCr(8) if jpeg => (Layout::YCbCr, 8),
        other => {
            return Err(SlideError::unsupported(
                path,
                format!("a TIFF of pixel kind {other:?}"),
            ));
        }
    };
    if bits != 8 && bits != 16 {
        return Err(SlideError::unsupported(
            path,
            format!("a TIFF of {bits} bits per sample"),
        ));
    }
    Ok((layout, bits == 16))
}

fn sample_format(reader: &mut Reader) -> TiffResult<Option<u16>> {
    let formats = reader.find_tag_unsigned_vec::<u16>(Tag::SampleFormat)?;
    Ok(formats.and_then(|v| v.first().copied()))
}

/// Pixel size stated by the page that the reader is on, micrometres.
pub(crate) fn um_per_px(reader: &mut Reader) -> Option<f64> {
    let text = reader
        .get_tag_ascii_string(Tag::ImageDescription)
        .unwrap_or_default();
    if let Some(mpp) = aperio_mpp(&text) {
        return Some(mpp);
    }
    let um_per_unit = match reader.find_tag_unsigned::<u16>(Tag::ResolutionUnit) {
        Ok(Some(2)) => 25_400.0,
        Ok(Some(3)) => 10_000.0,
        _ => return None,
    };
    let x = um_per_unit / rational(reader, Tag::XResolution)?;
    let y = um_per_unit / rational(reader, Tag::YResolution)?;
    let um = 0.5 * (x + y);
    (PLAUSIBLE_UM.contains(&x) && PLAUSIBLE_UM.contains(&y)).then_some(um)
}

/// `MPP = 0.4990` in an Aperio description.
fn aperio_mpp(description: &str) -> Option<f64> {
    if !description.starts_with("Aperio") {
        return None;
    }
    let value = description
        .split('|')
        .filter_map(|field| field.split_once('='))
        .find(|(key, _)| key.trim() == "MPP")?
        .1;
    let mpp: f64 = value.trim().trim_end_matches('\0').parse().ok()?;
    PLAUSIBLE_UM.contains(&mpp).then_some(mpp)
}

fn rational(reader: &mut Reader, tag: Tag) -> Option<f64> {
    use tiff::decoder::ifd::Value;
    let (n, d) = match reader.find_tag(tag).ok()?? {
        Value::Rational(n, d) => (f64::from(n), f64::from(d)),
        _ => return None,
    };
    (n > 0.0 && d > 0.0).then_some(n / d)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_the_tiled_pages_of_one_shape() {
        // As in an SVS: level 0, thumbnail (strips), level 1, label and macro (strips), and a tiled stranger.
        let pages = [
            (0, 4000, 3000, true),
            (1, 1024, 768, false),
            (2, 1000, 750, true),
            (3, 387, 463, false),
            (4, 1280, 431, false),
            (5, 500, 700, true),
            (6, 250, 187, true),
        ];
        assert_eq!(levels_among(&pages), [0, 2, 6]);
        assert_eq!(levels_among(&pages[1..2]), [0]);
    }

    #[test]
    fn mpp_is_read_from_aperio_only() {
        assert_eq!(
            aperio_mpp("Aperio Image\r\n1x1|AppMag = 20|MPP = 0.4990|Left = 2"),
            Some(0.499)
        );
        assert_eq!(aperio_mpp("Aperio|AppMag = 20"), None);
        assert_eq!(aperio_mpp("Other|MPP = 0.5"), None);
        assert_eq!(aperio_mpp("Aperio|MPP = 0"), None);
    }
}
