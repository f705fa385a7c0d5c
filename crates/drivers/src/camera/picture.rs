//! Images as cameras send them, unpacked.

pub use crate::camera::picture_error::PictureError;
use scopeservo_scope::{Channels, Samples};
use scopeservo_slide::{Alpha, Budget, Choice, Fault, Samples as Stored, Wanted};

/// No image takes more memory to unpack.
const BUDGET: Budget = Budget { bytes: 512 << 20 };

/// An unpacked image.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Colour channels.
    pub channels: Channels,
    /// Significant bits per sample.
    pub bit_depth: u8,
    /// Row-major, interleaved.
    pub samples: Samples,
}

/// Unpacks a JPEG, PNG, JPEG 2000 or TIFF file, upright, without its opacity: a sensor has none.
///
/// # Errors
/// [`PictureError`].
pub fn decode(bytes: &[u8]) -> Result<Picture, PictureError> {
    let wanted = Wanted {
        choice: Choice::default(),
        alpha: Alpha::Dropped,
        budget: BUDGET,
    };
    let read = scopeservo_slide::decode(bytes, &wanted).map_err(|fault| match fault {
        Fault::Truncated(_) => PictureError::Cut { bytes: bytes.len() },
        fault => PictureError::Unreadable(fault.to_string()),
    })?;
    // A range of its own for each image would make a frame brighter for a single pixel.
    if read.range_was_estimated {
        return Err(PictureError::Unreadable(
            "its samples have no range of their own: let the camera save whole numbers of 8 or 16 bits".into(),
        ));
    }
    let (bit_depth, samples) = match read.samples {
        Stored::U8(samples) => (8, Samples::U8(samples)),
        Stored::U16(samples) => (16, Samples::U16(samples)),
    };
    Ok(Picture {
        width: read.width,
        height: read.height,
        channels: match read.channels {
            1 => Channels::Gray,
            _ => Channels::Rgb,
        },
        bit_depth,
        samples,
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;
    use image::{DynamicImage, ExtendedColorType, ImageFormat};
    use std::io::Cursor;

    /// An image with structure, and its JPEG.
    pub(crate) fn jpeg(width: u32, height: u32, shade: u8) -> Vec<u8> {
        let pixels: Vec<u8> = (0..width * height)
            .flat_map(|i| {
                let (x, y) = (i % width, i / width);
                [shade, (x * 255 / width) as u8, (y * 255 / height) as u8]
            })
            .collect();
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, 95)
            .encode(&pixels, width, height, ExtendedColorType::Rgb8)
            .unwrap();
        bytes
    }

    #[test]
    fn jpegs_are_unpacked_with_and_without_what_surrounds_them() {
        let bytes = jpeg(40, 24, 90);
        let picture = decode(&bytes).unwrap();
        assert_eq!((picture.width, picture.height), (40, 24));
        assert_eq!((picture.channels, picture.bit_depth), (Channels::Rgb, 8));
        let Samples::U8(samples) = &picture.samples else {
            panic!("{:?}", picture.samples);
        };
        // The middle of the image, as it was made.
        let middle = &samples[3 * (12 * 40 + 20)..][..3];
        for (got, want) in middle.iter().zip([90, 127, 127]) {
            assert!(got.abs_diff(want) <= 6, "{middle:?}");
        }
        let filled = [bytes.as_slice(), &[0; 300]].concat();
        assert_eq!(decode(&filled).unwrap(), picture);
        for cut in [3, bytes.len() / 2, bytes.len() - 1] {
            assert_eq!(decode(&bytes[..cut]), Err(PictureError::Cut { bytes: cut }));
        }
    }

    #[test]
    fn usb_cameras_leave_out_the_tables_of_the_standard() {
        let bytes = jpeg(40, 24, 90);
        let whole = decode(&bytes).unwrap();
        // Without its Huffman segments; the encoder uses the tables of the standard.
        let mut bare = bytes[..2].to_vec();
        let mut at = 2;
        loop {
            let size = usize::from(u16::from_be_bytes([bytes[at + 2], bytes[at + 3]])) + 2;
            match bytes[at + 1] {
                0xda => break,
                0xc4 => {}
                _ => bare.extend_from_slice(&bytes[at..at + size]),
            }
            at += size;
        }
        bare.extend_from_slice(&bytes[at..]);
        assert!(bare.len() < bytes.len() - 300);
        assert_eq!(decode(&bare).unwrap(), whole);
    }

    #[test]
    fn other_files_keep_their_depth_and_lose_their_alpha() {
        let written = |image: DynamicImage, format| {
            let mut bytes = Cursor::new(Vec::new());
            image.write_to(&mut bytes, format).unwrap();
            decode(&bytes.into_inner()).unwrap()
        };
        let deep = image::ImageBuffer::from_raw(2, 1, vec![40_000u16, 3]).unwrap();
        for format in [ImageFormat::Png, ImageFormat::Tiff] {
            let read = written(DynamicImage::ImageLuma16(deep.clone()), format);
            assert_eq!(read.samples, Samples::U16(vec![40_000, 3]));
            assert_eq!((read.channels, read.bit_depth), (Channels::Gray, 16));
        }
        let clear = image::ImageBuffer::from_raw(1, 1, vec![1u8, 2, 3, 128]).unwrap();
        let read = written(DynamicImage::ImageRgba8(clear), ImageFormat::Png);
        assert_eq!(read.samples, Samples::U8(vec![1, 2, 3]));
        assert!(matches!(
            decode(b"GIF89a and so on"),
            Err(PictureError::Unreadable(_))
        ));
        assert!(decode(b"").is_err());
    }
}
