//! Small files written for the tests: every PNG kind, JPEG, stripped TIFF, and tiled TIFF pyramids by hand.
#![allow(
    dead_code,
    unreachable_pub,
    reason = "each test file uses a part of these helpers"
)]

pub mod tif;

use std::path::{Path, PathBuf};

use image::{DynamicImage, ImageFormat};

pub fn save(dir: &Path, name: &str, image: &DynamicImage, format: ImageFormat) -> PathBuf {
    let path = dir.join(name);
    image.save_with_format(&path, format).unwrap();
    path
}

/// An image with something different at every pixel.
pub fn rgb_at(x: u32, y: u32) -> [u8; 3] {
    [(x * 7 + y) as u8, (y * 5) as u8, (x ^ y) as u8]
}

pub fn picture(w: u32, h: u32) -> image::RgbImage {
    image::RgbImage::from_fn(w, h, |x, y| image::Rgb(rgb_at(x, y)))
}

/// One page of a hand-written TIFF: uncompressed 8-bit RGB, tiled (`tile > 0`, square) or in one strip.
pub struct PageSpec {
    pub w: u32,
    pub h: u32,
    pub tile: u32,
    pub rgb: fn(u32, u32) -> [u8; 3],
    pub description: &'static str,
    pub compression: u16,
    /// (pixels per unit, unit code: 2 inch, 3 centimetre)
    pub resolution: Option<(u32, u16)>,
}

impl PageSpec {
    pub fn new(w: u32, h: u32, tile: u32, rgb: fn(u32, u32) -> [u8; 3]) -> Self {
        PageSpec {
            w,
            h,
            tile,
            rgb,
            description: "",
            compression: 1,
            resolution: None,
        }
    }
}

/// Little-endian TIFF: header, then for each page its pixel data, its out-of-line values, its directory.
pub fn write_tiff(path: &Path, pages: &[PageSpec]) {
    let mut out = b"II\x2a\0".to_vec();
    let mut link = out.len();
    out.extend([0; 4]);
    for page in pages {
        let (tw, th) = if page.tile > 0 {
            (page.tile, page.tile)
        } else {
            (page.w, page.h)
        };
        let (mut offsets, mut counts) = (Vec::new(), Vec::new());
        for ty in 0..page.h.div_ceil(th) {
            for tx in 0..page.w.div_ceil(tw) {
                offsets.push(out.len() as u32);
                for y in ty * th..(ty + 1) * th {
                    for x in tx * tw..(tx + 1) * tw {
                        let inside = x < page.w && y < page.h;
                        out.extend(if inside { (page.rgb)(x, y) } else { [1, 2, 3] });
                    }
                }
                counts.push(3 * tw * th);
            }
        }
        let mut description = page.description.as_bytes().to_vec();
        description.push(0);
        let short = |v: u16| (3_u16, 1_u32, u32::from(v).to_le_bytes().to_vec());
        let longs = |v: &[u32]| {
            (
                4_u16,
                v.len() as u32,
                v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>(),
            )
        };
        let mut tags = vec![
            (256_u16, longs(&[page.w])),
            (257, longs(&[page.h])),
            (
                258,
                (
                    3,
                    3,
                    [8_u16; 3].iter().flat_map(|v| v.to_le_bytes()).collect(),
                ),
            ),
            (259, short(page.compression)),
            (262, short(2)),
            (270, (2, description.len() as u32, description)),
            (277, short(3)),
        ];
        if page.tile > 0 {
            tags.extend([
                (322, longs(&[tw])),
                (323, longs(&[th])),
                (324, longs(&offsets)),
                (325, longs(&counts)),
            ]);
        } else {
            tags.extend([
                (273, longs(&offsets)),
                (278, longs(&[th])),
                (279, longs(&counts)),
            ]);
        }
        if let Some((per_unit, unit)) = page.resolution {
            let rational: Vec<u8> = [per_unit, 1].iter().flat_map(|v| v.to_le_bytes()).collect();
            tags.extend([
                (282, (5, 1, rational.clone())),
                (283, (5, 1, rational)),
                (296, short(unit)),
            ]);
        }
        tags.sort_by_key(|t| t.0);
        for (_, (_, _, bytes)) in &mut tags {
            if bytes.len() > 4 {
                let at = out.len() as u32;
                out.extend(&*bytes);
                *bytes = at.to_le_bytes().to_vec();
            }
            bytes.resize(4, 0);
        }
        let here = (out.len() as u32).to_le_bytes();
        out[link..link + 4].copy_from_slice(&here);
        out.extend((tags.len() as u16).to_le_bytes());
        for (tag, (kind, count, value)) in tags {
            out.extend(tag.to_le_bytes());
            out.extend(kind.to_le_bytes());
            out.extend(count.to_le_bytes());
            out.extend(value);
        }
        link = out.len();
        out.extend([0; 4]);
    }
    std::fs::write(path, out).unwrap();
}
