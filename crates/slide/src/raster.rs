//! Pixels in memory and the colour rules: Rec. 601 luma, alpha over white, full-range YCbCr.

/// Colour image, 8 bits per channel, rows from the top, no padding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rgb8 {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `3 * width * height` bytes, red first.
    pub data: Vec<u8>,
}

/// Grey image, 0 (black) to 1 (white), rows from the top, no padding.
#[derive(Clone, Debug, PartialEq)]
pub struct Gray {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height` values.
    pub data: Vec<f32>,
}

impl Rgb8 {
    /// An image of one colour.
    #[must_use]
    pub fn filled(width: u32, height: u32, rgb: [u8; 3]) -> Self {
        let n = width as usize * height as usize;
        let data = if rgb[0] == rgb[1] && rgb[1] == rgb[2] {
            vec![rgb[0]; 3 * n]
        } else {
            rgb.repeat(n)
        };
        Self {
            width,
            height,
            data,
        }
    }

    /// Copies the part of `from` that falls on this image when the first pixel of `from` lies at column `x`, row `y`
    /// of this image.
    pub(crate) fn paste(&mut self, from: &Rgb8, x: i64, y: i64) {
        let x0 = x.max(0);
        let x1 = (x + i64::from(from.width)).min(self.width.into());
        let y0 = y.max(0);
        let y1 = (y + i64::from(from.height)).min(self.height.into());
        if x1 <= x0 {
            return;
        }
        let n = 3 * (x1 - x0) as usize;
        for row in y0..y1 {
            let to = 3 * (row as usize * self.width as usize + x0 as usize);
            let at = 3 * ((row - y) as usize * from.width as usize + (x0 - x) as usize);
            self.data[to..to + n].copy_from_slice(&from.data[at..at + n]);
        }
    }
}

/// Rec. 601 luma of channels 0..=`full`, as 0..1. Equal channels come back exactly as themselves.
pub(crate) fn luma(r: f32, g: f32, b: f32, full: f32) -> f32 {
    if r == g && g == b {
        return r / full;
    }
    (0.299 * r + 0.587 * g + 0.114 * b) / full
}

/// Channel `c` of opacity `a` over white, all on 0..=`full`.
pub(crate) fn over_white(c: u64, a: u64, full: u64) -> u64 {
    (c * a + full * (full - a) + full / 2) / full
}

/// Rec. 601 luma of a colour in 8 bits, rounded.
pub(crate) fn gray_u8([r, g, b]: [u8; 3]) -> u8 {
    (255.0 * luma(r.into(), g.into(), b.into(), 255.0)).round() as u8
}

/// 16 to 8 bits, rounded: 65535 / 255 = 257.
pub(crate) fn to_8(v: u16) -> u8 {
    ((u32::from(v) + 128) / 257) as u8
}

/// Full-range (JFIF) YCbCr to RGB.
pub(crate) fn ycbcr_to_rgb([y, cb, cr]: [u8; 3]) -> [u8; 3] {
    let (y, cb, cr) = (f32::from(y), f32::from(cb) - 128.0, f32::from(cr) - 128.0);
    [
        y + 1.402 * cr,
        y - 0.344_136 * cb - 0.714_136 * cr,
        y + 1.772 * cb,
    ]
    .map(|v| v.round().clamp(0.0, 255.0) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alpha_over_white_at_its_ends_and_in_the_middle() {
        let over_8 = |c, a| over_white(c, a, 255);
        assert_eq!(
            [over_8(10, 255), over_8(10, 0), over_8(0, 128)],
            [10, 255, 127]
        );
        assert_eq!(over_white(1000, 65535, 65535), 1000);
        assert_eq!(over_white(1000, 0, 65535), 65535);
        assert_eq!((to_8(65535), to_8(257 * 7), to_8(0)), (255, 7, 0));
    }

    #[test]
    fn ycbcr_neutral_and_primaries() {
        assert_eq!(ycbcr_to_rgb([90, 128, 128]), [90, 90, 90]);
        assert_eq!(ycbcr_to_rgb([76, 85, 255]), [254, 0, 0]);
    }

    #[test]
    fn paste_clips_on_every_side() {
        let mut to = Rgb8::filled(3, 3, [0, 0, 0]);
        let from = Rgb8::filled(2, 2, [9, 9, 9]);
        for (x, y) in [(-1, -1), (2, 2), (-5, 0), (0, 7)] {
            to.paste(&from, x, y);
        }
        let set: Vec<usize> = (0..9).filter(|&i| to.data[3 * i] == 9).collect();
        assert_eq!(set, [0, 8]);
    }
}
