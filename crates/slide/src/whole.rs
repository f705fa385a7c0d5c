//! PNG and JPEG: decoded in one piece.

use std::io::Cursor;
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader};

use crate::raster::{luma, over_white_8, over_white_16, to_8};
use crate::{Gray, Rgb8, SlideError, jpeg};

/// Decodes to 8-bit colour. The flag says that the file holds 16 bits per channel.
pub(crate) fn decode_rgb8(path: &Path, format: ImageFormat) -> Result<(Rgb8, bool), SlideError> {
    let decoded = decode(path, format)?;
    let (width, height) = (decoded.width(), decoded.height());
    let deep = matches!(
        decoded,
        DynamicImage::ImageLuma16(_)
            | DynamicImage::ImageLumaA16(_)
            | DynamicImage::ImageRgb16(_)
            | DynamicImage::ImageRgba16(_)
    );
    let n = 3 * width as usize * height as usize;
    let mut data = Vec::new();
    match decoded {
        DynamicImage::ImageRgb8(img) => data = img.into_raw(),
        DynamicImage::ImageRgba8(img) => {
            // In place: the output is shorter than the input at every step.
            data = img.into_raw();
            for i in 0..n / 3 {
                let [r, g, b, a] = [0, 1, 2, 3].map(|c| data[4 * i + c]);
                for (c, v) in [r, g, b].into_iter().enumerate() {
                    data[3 * i + c] = over_white_8(v, a);
                }
            }
            data.truncate(n);
        }
        DynamicImage::ImageLuma8(img) => {
            data.reserve_exact(n);
            img.as_raw().iter().for_each(|&v| data.extend([v; 3]));
        }
        DynamicImage::ImageLumaA8(img) => {
            data.reserve_exact(n);
            for p in img.as_raw().as_chunks::<2>().0 {
                data.extend([over_white_8(p[0], p[1]); 3]);
            }
        }
        other => {
            data.reserve_exact(n);
            for_each_16(path, &other, |rgb| data.extend(rgb.map(to_8)))?;
        }
    }
    Ok((
        Rgb8 {
            width,
            height,
            data,
        },
        deep,
    ))
}

/// Decodes a 16-bit file again, to grey at full precision.
pub(crate) fn decode_gray_16(path: &Path, format: ImageFormat) -> Result<Gray, SlideError> {
    let decoded = decode(path, format)?;
    let (width, height) = (decoded.width() as usize, decoded.height() as usize);
    let mut data = Vec::with_capacity(width * height);
    for_each_16(path, &decoded, |rgb| {
        let [r, g, b] = rgb.map(f32::from);
        data.push(luma(r, g, b, 65535.0));
    })?;
    Ok(Gray {
        width,
        height,
        data,
    })
}

/// Calls `each` with the opaque colour of every pixel of a 16-bit image.
fn for_each_16(
    path: &Path,
    image: &DynamicImage,
    mut each: impl FnMut([u16; 3]),
) -> Result<(), SlideError> {
    match image {
        DynamicImage::ImageLuma16(i) => i.as_raw().iter().for_each(|&v| each([v; 3])),
        DynamicImage::ImageLumaA16(i) => {
            for p in i.as_raw().as_chunks::<2>().0 {
                each([over_white_16(p[0], p[1]); 3]);
            }
        }
        DynamicImage::ImageRgb16(i) => i.as_raw().as_chunks::<3>().0.iter().for_each(|&p| each(p)),
        DynamicImage::ImageRgba16(i) => {
            for &[r, g, b, a] in i.as_raw().as_chunks::<4>().0 {
                each([r, g, b].map(|v| over_white_16(v, a)));
            }
        }
        other => {
            let what = format!("a pixel of kind {:?}", other.color());
            return Err(SlideError::unsupported(path, what));
        }
    }
    Ok(())
}

fn decode(path: &Path, format: ImageFormat) -> Result<DynamicImage, SlideError> {
    let bytes = std::fs::read(path).map_err(|e| SlideError::io(path, e))?;
    if format == ImageFormat::Jpeg && !jpeg::is_complete(&bytes) {
        return Err(SlideError::truncated(path, "the JPEG has no end marker"));
    }
    let mut reader = ImageReader::with_format(Cursor::new(&bytes), format);
    // The size is checked below, against the crate's own limit.
    reader.no_limits();
    let decoder = reader
        .into_decoder()
        .map_err(|e| SlideError::from_image(path, e))?;
    let (width, height) = decoder.dimensions();
    SlideError::check_size(path, width, height)?;
    DynamicImage::from_decoder(decoder).map_err(|e| SlideError::from_image(path, e))
}
