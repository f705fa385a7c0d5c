//! Which way round a picture is shown: tag 274 of TIFF and of EXIF.

/// Where the first row and the first column of a file are shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Orientation {
    /// Rows and columns change places, first.
    transposed: bool,
    /// then columns run from right to left,
    flip_x: bool,
    /// and rows from the bottom up.
    flip_y: bool,
}

impl Orientation {
    /// By its number, 1 to 8; others mean nothing and leave the picture as it is.
    pub(crate) fn of(number: u64) -> Self {
        let (transposed, flip_x, flip_y) = match number {
            2 => (false, true, false),
            3 => (false, true, true),
            4 => (false, false, true),
            5 => (true, false, false),
            6 => (true, true, false),
            7 => (true, true, true),
            8 => (true, false, true),
            _ => (false, false, false),
        };
        Self {
            transposed,
            flip_x,
            flip_y,
        }
    }

    pub(crate) fn is_upright(self) -> bool {
        self == Self::default()
    }

    /// The size as it is shown, of a size as it is stored.
    pub(crate) fn size(self, [w, h]: [u32; 2]) -> [u32; 2] {
        match self.transposed {
            true => [h, w],
            false => [w, h],
        }
    }

    /// Where a stored pixel is shown, and the step from it to the next of its row, in a picture that is stored with this size.
    pub(crate) fn place(self, stored: [u32; 2], x: u32, y: u32) -> ([i64; 2], [i64; 2]) {
        let [w, h] = self.size(stored).map(i64::from);
        let (x, y) = (i64::from(x), i64::from(y));
        let (mut at, mut step) = match self.transposed {
            true => ([y, x], [0, 1]),
            false => ([x, y], [1, 0]),
        };
        if self.flip_x {
            (at[0], step[0]) = (w - 1 - at[0], -step[0]);
        }
        if self.flip_y {
            (at[1], step[1]) = (h - 1 - at[1], -step[1]);
        }
        (at, step)
    }

    /// The stored rectangle (x, y, columns, rows) of one that is shown.
    pub(crate) fn stored(self, stored: [u32; 2], [x, y, w, h]: [i64; 4]) -> [i64; 4] {
        let [width, height] = self.size(stored).map(i64::from);
        let x = if self.flip_x { width - x - w } else { x };
        let y = if self.flip_y { height - y - h } else { y };
        match self.transposed {
            true => [y, x, h, w],
            false => [x, y, w, h],
        }
    }
}

/// The orientation that EXIF data tell, with or without their name before them.
pub(crate) fn of_exif(data: &[u8]) -> Orientation {
    let data = data.strip_prefix(b"Exif\0\0").unwrap_or(data);
    Orientation::of(tag_274(data).unwrap_or(1))
}

fn tag_274(data: &[u8]) -> Option<u64> {
    let big = match data.get(..4)? {
        b"II\x2a\0" => false,
        b"MM\0\x2a" => true,
        _ => return None,
    };
    let number = |at: usize, n: usize| -> Option<u64> {
        let bytes = data.get(at..at.checked_add(n)?)?;
        let fold = |v: u64, b: &u8| v << 8 | u64::from(*b);
        Some(match big {
            true => bytes.iter().fold(0, fold),
            false => bytes.iter().rev().fold(0, fold),
        })
    };
    let at = number(4, 4)? as usize;
    let count = number(at, 2)? as usize;
    (0..count).find_map(|i| {
        let entry = at.checked_add(2 + 12 * i)?;
        // A SHORT in the first two bytes of the value.
        (number(entry, 2)? == 274).then(|| number(entry + 8, 2))?
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The words of EXIF: where row 0 and column 0 are.
    #[test]
    fn rows_and_columns_are_where_the_standard_says() {
        // Of a picture stored 3 wide, 2 high: where pixel (0, 0) and pixel (2, 0) are shown.
        let cases = [
            (1, [0, 0], [2, 0]),
            (2, [2, 0], [0, 0]),
            (3, [2, 1], [0, 1]),
            (4, [0, 1], [2, 1]),
            (5, [0, 0], [0, 2]),
            (6, [1, 0], [1, 2]),
            (7, [1, 2], [1, 0]),
            (8, [0, 2], [0, 0]),
            (99, [0, 0], [2, 0]),
        ];
        for (number, first, third) in cases {
            let o = Orientation::of(number);
            let (at, step) = o.place([3, 2], 0, 0);
            assert_eq!(at, first, "{number}");
            assert_eq!(
                [at[0] + 2 * step[0], at[1] + 2 * step[1]],
                third,
                "{number}"
            );
            // A single pixel that is shown is where it was stored.
            for (x, y) in [(0, 0), (2, 0), (1, 1)] {
                let ([sx, sy], _) = o.place([3, 2], x, y);
                assert_eq!(
                    o.stored([3, 2], [sx, sy, 1, 1]),
                    [i64::from(x), i64::from(y), 1, 1],
                    "{number}"
                );
            }
        }
    }

    #[test]
    fn exif_data_are_read_and_nonsense_is_not() {
        let little = b"Exif\0\0II\x2a\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
        let big = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x03\0\0\0\0\0\0";
        assert_eq!(of_exif(little), Orientation::of(6));
        assert_eq!(of_exif(big), Orientation::of(3));
        for cut in 0..little.len() - 4 {
            let _ = of_exif(&little[..cut]);
        }
        assert!(of_exif(b"II\x2a\0\xff\xff\xff\xff").is_upright());
    }
}
