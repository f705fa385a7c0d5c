//! Pixels as video devices send them, put in order.

use crate::camera::picture::{Picture, PictureError};
use scopeservo_scope::{Channels, Samples};

/// How the pixels lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelOrder {
    /// One byte.
    Gray,
    /// So many significant bits in two bytes, the low byte first.
    Gray16 {
        /// 9 to 16.
        bits: u8,
    },
    /// Red, green, blue.
    Rgb,
    /// Blue, green, red.
    Bgr,
    /// Brightness, blueness, brightness, redness for two pixels.
    Yuyv,
    /// Blueness, brightness, redness, brightness for two pixels.
    Uyvy,
    /// All brightnesses, then blueness and redness for two by two pixels.
    Nv12,
}

/// How an image lies in its bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// The pixels of a row.
    pub order: PixelOrder,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// From the start of a row to the start of the next.
    pub row_bytes: usize,
}

impl Layout {
    fn least_row_bytes(&self) -> usize {
        match self.order {
            PixelOrder::Gray | PixelOrder::Nv12 => self.width,
            PixelOrder::Gray16 { .. } => 2 * self.width,
            PixelOrder::Yuyv | PixelOrder::Uyvy => 4 * self.width.div_ceil(2),
            PixelOrder::Rgb | PixelOrder::Bgr => 3 * self.width,
        }
    }
}

/// The image in some bytes. Brightness and colour are taken for ITU-R BT.601 with black at 16 and white at 235, which video
/// devices send unless they say otherwise.
///
/// # Errors
/// [`PictureError::Size`] for too few bytes.
pub fn unpack(layout: &Layout, bytes: &[u8]) -> Result<Picture, PictureError> {
    let Layout {
        order,
        width,
        height,
        row_bytes,
    } = *layout;
    let row_bytes = row_bytes.max(layout.least_row_bytes());
    let rows = match order {
        PixelOrder::Nv12 => height + height.div_ceil(2),
        _ => height,
    };
    // The last row may lack what fills it up.
    let needed = match rows {
        0 => 0,
        rows => row_bytes * (rows - 1) + layout.least_row_bytes(),
    };
    if bytes.len() < needed || width == 0 || height == 0 {
        return Err(PictureError::Size {
            bytes: bytes.len(),
            needed,
        });
    }
    let row = |y: usize| &bytes[y * row_bytes..][..layout.least_row_bytes()];
    let rows = 0..height;
    let gray = |samples| (Channels::Gray, 8, Samples::U8(samples));
    let rgb = |samples| (Channels::Rgb, 8, Samples::U8(samples));
    let (channels, bit_depth, samples) = match order {
        PixelOrder::Gray => gray(rows.flat_map(|y| row(y).to_vec()).collect()),
        PixelOrder::Gray16 { bits } => {
            // What lies above the significant bits is not the image's.
            let mask = u16::MAX >> (16 - u32::from(bits.clamp(9, 16)));
            let pair = |b: &[u8]| u16::from_le_bytes([b[0], b[1]]) & mask;
            let samples = rows.flat_map(|y| row(y).chunks_exact(2).map(pair).collect::<Vec<_>>());
            (
                Channels::Gray,
                bits.clamp(9, 16),
                Samples::U16(samples.collect()),
            )
        }
        PixelOrder::Rgb => rgb(rows.flat_map(|y| row(y).to_vec()).collect()),
        PixelOrder::Bgr => {
            let turned = |p: &[u8]| [p[2], p[1], p[0]];
            rgb(rows
                .flat_map(|y| row(y).chunks_exact(3).flat_map(turned).collect::<Vec<_>>())
                .collect())
        }
        PixelOrder::Yuyv | PixelOrder::Uyvy => {
            let [y0, u, y1, v] = match order {
                PixelOrder::Yuyv => [0, 1, 2, 3],
                _ => [1, 0, 3, 2],
            };
            let two = |p: &[u8]| [colour(p[y0], p[u], p[v]), colour(p[y1], p[u], p[v])];
            rgb(rows
                .flat_map(|y| {
                    let pixels = row(y).chunks_exact(4).flat_map(two).take(width);
                    pixels.flatten().collect::<Vec<_>>()
                })
                .collect())
        }
        PixelOrder::Nv12 => rgb(rows
            .flat_map(|y| {
                let colours = row_of_colours(bytes, row_bytes, height + y / 2, width);
                row(y)
                    .iter()
                    .enumerate()
                    .flat_map(|(x, &v)| colour(v, colours[x & !1], colours[x | 1]))
                    .collect::<Vec<_>>()
            })
            .collect()),
    };
    Ok(Picture {
        width,
        height,
        channels,
        bit_depth,
        samples,
    })
}

/// A row of pairs of blueness and redness, with an even number of them also where the columns are odd.
fn row_of_colours(bytes: &[u8], row_bytes: usize, row: usize, width: usize) -> Vec<u8> {
    let mut colours = bytes[row * row_bytes..][..width].to_vec();
    if width % 2 == 1 {
        let next = bytes.get(row * row_bytes + width);
        colours.push(next.copied().unwrap_or(128));
    }
    colours
}

/// ITU-R BT.601, limited range.
fn colour(y: u8, u: u8, v: u8) -> [u8; 3] {
    let y = 1.164_383 * (f32::from(y) - 16.0);
    let (u, v) = (f32::from(u) - 128.0, f32::from(v) - 128.0);
    [
        y + 1.596_027 * v,
        y - 0.391_762 * u - 0.812_968 * v,
        y + 2.017_232 * u,
    ]
    .map(|c| c.round().clamp(0.0, 255.0) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layout(order: PixelOrder, width: usize, height: usize, row_bytes: usize) -> Layout {
        Layout {
            order,
            width,
            height,
            row_bytes,
        }
    }

    fn bytes(layout: &Layout, bytes: &[u8]) -> Vec<u8> {
        match unpack(layout, bytes).unwrap().samples {
            Samples::U8(samples) => samples,
            Samples::U16(samples) => panic!("{samples:?}"),
        }
    }

    // Red, white, black and blue in BT.601, limited range.
    const RED: [u8; 3] = [81, 90, 240];
    const WHITE: [u8; 3] = [235, 128, 128];
    const BLACK: [u8; 3] = [16, 128, 128];
    const BLUE: [u8; 3] = [41, 240, 110];

    fn near(got: &[u8], want: &[u8]) {
        assert_eq!(got.len(), want.len());
        for (g, w) in got.iter().zip(want) {
            assert!(g.abs_diff(*w) <= 2, "{got:?} {want:?}");
        }
    }

    #[test]
    fn colours_come_out_as_they_went_in() {
        let [r, w, k, b] = [RED, WHITE, BLACK, BLUE];
        // Two rows of two pixels each, filled up to five bytes.
        let yuyv = [[r[0], r[1], r[0], r[2], 99], [b[0], b[1], b[0], b[2], 99]].concat();
        let want = [255, 0, 0, 255, 0, 0, 0, 0, 255, 0, 0, 255];
        near(&bytes(&layout(PixelOrder::Yuyv, 2, 2, 5), &yuyv), &want);
        let uyvy = [w[1], w[0], w[2], k[0]];
        let want = [255, 255, 255, 0, 0, 0];
        near(&bytes(&layout(PixelOrder::Uyvy, 2, 1, 4), &uyvy), &want);
        let nv12 = [r[0], r[0], r[0], r[0], r[1], r[2]];
        let want = [255, 0, 0].repeat(4);
        near(&bytes(&layout(PixelOrder::Nv12, 2, 2, 2), &nv12), &want);
        let odd = [r[0], r[0], r[0], r[1], r[2], r[1], r[2]];
        near(
            &bytes(&layout(PixelOrder::Nv12, 3, 1, 3), &odd),
            &[255, 0, 0].repeat(3),
        );
        assert_eq!(
            bytes(&layout(PixelOrder::Bgr, 1, 2, 4), &[1, 2, 3, 0, 4, 5, 6]),
            [3, 2, 1, 6, 5, 4]
        );
        assert_eq!(
            bytes(&layout(PixelOrder::Rgb, 1, 1, 0), &[1, 2, 3]),
            [1, 2, 3]
        );
    }

    #[test]
    fn grey_keeps_its_depth_and_only_that() {
        let ten = layout(PixelOrder::Gray16 { bits: 10 }, 2, 1, 4);
        let picture = unpack(&ten, &[0xff, 0xff, 0x34, 0x02]).unwrap();
        assert_eq!(picture.samples, Samples::U16(vec![1023, 0x234]));
        assert_eq!((picture.channels, picture.bit_depth), (Channels::Gray, 10));
        assert_eq!(
            bytes(&layout(PixelOrder::Gray, 2, 2, 3), &[1, 2, 0, 3, 4]),
            [1, 2, 3, 4]
        );
    }

    #[test]
    fn too_few_bytes_are_told() {
        for order in [
            PixelOrder::Gray,
            PixelOrder::Gray16 { bits: 12 },
            PixelOrder::Rgb,
            PixelOrder::Bgr,
            PixelOrder::Yuyv,
            PixelOrder::Uyvy,
            PixelOrder::Nv12,
        ] {
            for (width, height) in [(4, 3), (3, 3), (1, 1)] {
                let layout = layout(order, width, height, 0);
                let Err(PictureError::Size { needed, .. }) = unpack(&layout, &[]) else {
                    panic!("{order:?}");
                };
                assert!(unpack(&layout, &vec![0; needed]).is_ok(), "{order:?}");
                assert!(unpack(&layout, &vec![0; needed - 1]).is_err(), "{order:?}");
            }
            assert!(unpack(&layout(order, 0, 0, 0), &[]).is_err());
        }
    }
}
