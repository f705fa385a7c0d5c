//! The codes of a JPEG: its segments, Huffman tables and the bits of a scan (ITU-T T.81, annexes B and F).

const SCAN: u8 = 0xda;

/// A segment before the first scan's data, that of the scan included.
pub(super) struct Segment<'a> {
    pub(super) kind: u8,
    /// With its marker.
    pub(super) whole: &'a [u8],
    /// Where it ends in the file.
    pub(super) end: usize,
}

impl<'a> Segment<'a> {
    pub(super) fn data(&self) -> &'a [u8] {
        &self.whole[4..]
    }
}

pub(super) fn segments(bytes: &[u8]) -> impl Iterator<Item = Segment<'_>> {
    let mut at = 2;
    let mut over = false;
    std::iter::from_fn(move || {
        // Any number of 0xff may stand before a marker.
        while bytes.get(at) == Some(&0xff) && bytes.get(at + 1) == Some(&0xff) {
            at += 1;
        }
        let &[0xff, kind, high, low] = bytes.get(at..at + 4)?.first_chunk()? else {
            return None;
        };
        let end = at + 2 + usize::from(u16::from_be_bytes([high, low]));
        let whole = bytes.get(at..end).filter(|w| w.len() >= 4 && !over)?;
        over = kind == SCAN;
        at = end;
        Some(Segment { kind, whole, end })
    })
}

/// The segment that begins at `at` or after bytes that are none: its kind, its data, and where it ends.
pub(super) fn segment_at(bytes: &[u8], mut at: usize) -> Option<(u8, &[u8], usize)> {
    loop {
        let &[lead, kind] = bytes.get(at..)?.first_chunk()?;
        match (lead, kind) {
            (0xff, 0xd9) => return None,
            (0xff, 0x01 | 0xd0..=0xd8) => at += 2,
            (0xff, 1..=0xfe) => break,
            _ => at += 1,
        }
    }
    let &[_, kind, high, low] = bytes.get(at..)?.first_chunk()?;
    let end = at + 2 + usize::from(u16::from_be_bytes([high, low]));
    Some((kind, bytes.get(at + 4..end)?, end))
}

/// The Huffman tables that are in force, by class and number.
#[derive(Debug, Default)]
pub(super) struct Tables([[Option<Table>; 4]; 2]);

impl Tables {
    /// Takes the tables of a segment.
    pub(super) fn read(&mut self, mut rest: &[u8]) -> Option<()> {
        while let [class, more @ ..] = rest {
            let counts = more.get(..16)?;
            let n = counts.iter().map(|c| usize::from(*c)).sum::<usize>();
            let values = more.get(16..16 + n)?;
            let place = self.0.get_mut(usize::from(class >> 4))?;
            *place.get_mut(usize::from(class & 15))? = Some(Table::new(counts, values));
            rest = &more[16 + n..];
        }
        Some(())
    }

    /// 0 for means, 1 for the others.
    pub(super) fn get(&self, class: usize, number: u8) -> Option<Table> {
        self.0[class].get(usize::from(number))?.clone()
    }
}

/// Codes of up to so many bits are looked up at once.
const SHORT: u32 = 9;

/// A Huffman table.
#[derive(Debug, Clone)]
pub(super) struct Table {
    /// For lengths 1 to 16: first code, number of codes, place of the first value.
    lengths: [(u32, u32, usize); 16],
    values: Vec<u8>,
    /// For the next bits: how many of them are a code, 0 for a longer one, and its value.
    short: Vec<(u8, u8)>,
}

impl Table {
    fn new(counts: &[u8], values: &[u8]) -> Self {
        let (mut code, mut place) = (0_u32, 0);
        let mut lengths = [(0, 0, 0); 16];
        let mut short = vec![(0, 0); 1 << SHORT];
        for ((bits, length), count) in (1..).zip(&mut lengths).zip(counts) {
            *length = (code, u32::from(*count), place);
            for k in 0..u32::from(*count) {
                if bits <= SHORT {
                    let from = ((code + k) << (SHORT - bits)) as usize;
                    let codes = short.iter_mut().skip(from).take(1 << (SHORT - bits));
                    codes.for_each(|s| *s = (bits as u8, values[place + k as usize]));
                }
            }
            code = (code + u32::from(*count)) << 1;
            place += usize::from(*count);
        }
        Self {
            lengths,
            values: values.to_vec(),
            short,
        }
    }

    pub(super) fn read(&self, bits: &mut Bits<'_>) -> Option<u8> {
        let next = bits.peek();
        let (length, value) = self.short[(next >> (16 - SHORT)) as usize];
        if length > 0 {
            bits.pass(length.into())?;
            return Some(value);
        }
        for (length, (first, count, place)) in (1..).zip(&self.lengths) {
            let code = next >> (16 - length);
            if code >= *first && code - first < *count {
                bits.pass(length)?;
                return self.values.get(place + (code - first) as usize).copied();
            }
        }
        None
    }
}

/// The bits of a scan, up to a marker.
pub(super) struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The bits that were taken from the bytes and not passed yet, in the low ones.
    held: u64,
    left: u32,
}

impl<'a> Bits<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self {
            bytes,
            at: 0,
            held: 0,
            left: 0,
        }
    }

    /// Where the marker is that ends these bits, or may be.
    pub(super) fn marker(&self) -> usize {
        self.at
    }

    /// A number of so many bits, up to 16.
    pub(super) fn number(&mut self, count: u32) -> Option<u32> {
        let value = self.peek() >> (16 - count);
        self.pass(count)?;
        Some(value)
    }

    /// The next 16 bits; zeros stand for those beyond the end.
    pub(super) fn peek(&mut self) -> u32 {
        while self.left < 32 {
            match (self.bytes.get(self.at), self.bytes.get(self.at + 1)) {
                // A zero after it is filling; anything else is a marker.
                (Some(0xff), Some(0)) => self.at += 2,
                (None | Some(0xff), _) => break,
                (Some(_), _) => self.at += 1,
            }
            // After 0xff the filling was passed, too.
            let byte = match self.bytes[self.at - 1] {
                0 if self.at > 1 && self.bytes[self.at - 2] == 0xff => 0xff,
                byte => byte,
            };
            self.held = self.held << 8 | u64::from(byte);
            self.left += 8;
        }
        let held = match self.left {
            16.. => self.held >> (self.left - 16),
            short => self.held << (16 - short),
        };
        (held & 0xffff) as u32
    }

    /// Passes over bits that were looked at. `None` when there are not as many.
    pub(super) fn pass(&mut self, count: u32) -> Option<()> {
        self.left = self.left.checked_sub(count)?;
        self.held &= (1 << self.left) - 1;
        Some(())
    }

    /// A number of so many bits, of which the lower half is negative.
    pub(super) fn signed(&mut self, size: u8) -> Option<i32> {
        let size = u32::from(size);
        if size > 16 {
            return None;
        }
        let value = (self.peek() >> (16 - size)) as i32;
        self.pass(size)?;
        let below = size > 0 && value < 1 << (size - 1);
        Some(if below {
            value + 1 - (1 << size)
        } else {
            value
        })
    }

    /// Passes over the restart marker of that number, which must come next.
    pub(super) fn restart(&mut self, number: usize) -> Option<()> {
        self.peek();
        if self.left >= 8 {
            return None;
        }
        (self.left, self.held) = (0, 0);
        while self.bytes.get(self.at) == Some(&0xff) && self.bytes.get(self.at + 1) == Some(&0xff) {
            self.at += 1;
        }
        let marker = [0xff, 0xd0 + ((number - 1) % 8) as u8];
        let found = self.bytes.get(self.at..self.at + 2)? == marker;
        self.at += 2;
        found.then_some(())
    }
}
