//! Images as cameras send them, unpacked.

use crate::camera::jpeg;
pub use crate::camera::picture_error::PictureError;
use image::{DynamicImage, ImageReader};
use scopeservo_scope::{Channels, Samples};
use std::borrow::Cow;
use std::io::Cursor;

/// No image has more columns or rows.
const MAX_SIDE_PX: u32 = 16_384;
/// Unpacking needs no more memory.
const MAX_UNPACKED_BYTES: u64 = 512 << 20;

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

/// Unpacks a JPEG, PNG or TIFF file.
///
/// # Errors
/// [`PictureError`].
pub fn decode(bytes: &[u8]) -> Result<Picture, PictureError> {
    let bytes = match bytes.starts_with(&[0xff, 0xd8]) {
        true => jpeg::whole(bytes)?,
        false => Cow::Borrowed(bytes),
    };
    let unreadable = |e: &dyn std::fmt::Display| PictureError::Unreadable(e.to_string());
    let mut reader = ImageReader::new(Cursor::new(&*bytes))
        .with_guessed_format()
        .map_err(|e| unreadable(&e))?;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_SIDE_PX);
    limits.max_image_height = Some(MAX_SIDE_PX);
    limits.max_alloc = Some(MAX_UNPACKED_BYTES);
    reader.limits(limits);
    let image = reader.decode().map_err(|e| unreadable(&e))?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    let (channels, bit_depth, samples) = match image {
        DynamicImage::ImageLuma8(i) => (Channels::Gray, 8, Samples::U8(i.into_raw())),
        DynamicImage::ImageLuma16(i) => (Channels::Gray, 16, Samples::U16(i.into_raw())),
        DynamicImage::ImageRgb16(i) => (Channels::Rgb, 16, Samples::U16(i.into_raw())),
        DynamicImage::ImageRgba16(_) => {
            let rgb = image.into_rgb16().into_raw();
            (Channels::Rgb, 16, Samples::U16(rgb))
        }
        DynamicImage::ImageLumaA8(_) => {
            let gray = image.into_luma8().into_raw();
            (Channels::Gray, 8, Samples::U8(gray))
        }
        DynamicImage::ImageLumaA16(_) => {
            let gray = image.into_luma16().into_raw();
            (Channels::Gray, 16, Samples::U16(gray))
        }
        DynamicImage::ImageRgb8(_) | DynamicImage::ImageRgba8(_) => {
            (Channels::Rgb, 8, Samples::U8(image.into_rgb8().into_raw()))
        }
        _ => {
            return Err(PictureError::Unreadable(
                "its samples are no whole numbers".into(),
            ));
        }
    };
    Ok(Picture {
        width,
        height,
        channels,
        bit_depth,
        samples,
    })
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;
    use image::{ExtendedColorType, ImageFormat};

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
