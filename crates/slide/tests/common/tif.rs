//! TIFF files of any kind, written tag by tag.

pub const SHORT: u16 = 3;
pub const LONG: u16 = 4;
pub const RATIONAL: u16 = 5;
pub const TEXT: u16 = 2;

/// One directory: its tags but for those that say where the chunks are, its chunks, and what hangs on it.
#[derive(Clone, Default)]
pub struct Image {
    pub tags: Vec<(u16, u16, Vec<u64>)>,
    /// An empty one was never written: offset 0, length 0.
    pub chunks: Vec<Vec<u8>>,
    pub tiled: bool,
    pub children: Vec<Image>,
}

impl Image {
    /// `w` x `h` pixels of `samples` samples of `bits` bits, of a photometric kind; one strip unless `tile` says otherwise.
    pub fn new([w, h]: [u32; 2], samples: u64, bits: u64, photometric: u64) -> Self {
        let mut image = Self::default();
        image
            .tag(256, LONG, &[w.into()])
            .tag(257, LONG, &[h.into()]);
        image.tag(258, SHORT, &vec![bits; samples as usize]);
        image
            .tag(262, SHORT, &[photometric])
            .tag(277, SHORT, &[samples]);
        image
    }

    pub fn tag(&mut self, tag: u16, kind: u16, values: &[u64]) -> &mut Self {
        self.tags.retain(|t| t.0 != tag);
        self.tags.push((tag, kind, values.to_vec()));
        self
    }

    pub fn text(&mut self, tag: u16, text: &str) -> &mut Self {
        let bytes: Vec<u64> = text.bytes().chain([0]).map(u64::from).collect();
        self.tag(tag, TEXT, &bytes)
    }

    pub fn tiles(&mut self, [w, h]: [u64; 2], chunks: Vec<Vec<u8>>) -> &mut Self {
        self.tag(322, LONG, &[w]).tag(323, LONG, &[h]);
        (self.tiled, self.chunks) = (true, chunks);
        self
    }

    pub fn strips(&mut self, rows: u64, chunks: Vec<Vec<u8>>) -> &mut Self {
        self.tag(278, LONG, &[rows]);
        self.chunks = chunks;
        self
    }
}

/// How a file is written.
#[derive(Clone, Copy, Default, Debug)]
pub struct Form {
    pub big_endian: bool,
    /// BigTIFF.
    pub wide: bool,
}

impl Form {
    pub fn all() -> [Form; 4] {
        [(false, false), (true, false), (false, true), (true, true)]
            .map(|(big_endian, wide)| Form { big_endian, wide })
    }

    pub fn number(self, v: u64, bytes: usize) -> Vec<u8> {
        match self.big_endian {
            true => v.to_be_bytes()[8 - bytes..].to_vec(),
            false => v.to_le_bytes()[..bytes].to_vec(),
        }
    }

    /// The bytes of a file of these images.
    pub fn file(self, images: &[Image]) -> Vec<u8> {
        let mut out = if self.big_endian {
            b"MM".to_vec()
        } else {
            b"II".to_vec()
        };
        out.extend(self.number(if self.wide { 43 } else { 42 }, 2));
        if self.wide {
            out.extend(self.number(8, 2));
            out.extend(self.number(0, 2));
        }
        let mut link = out.len();
        out.extend(vec![0; self.offset()]);
        for image in images {
            let at = self.put(&mut out, image);
            self.set(&mut out, link, at.0);
            link = at.1;
        }
        out
    }

    fn offset(self) -> usize {
        if self.wide { 8 } else { 4 }
    }

    fn set(self, out: &mut [u8], at: usize, value: usize) {
        let n = self.offset();
        out[at..at + n].copy_from_slice(&self.number(value as u64, n));
    }

    /// Where the directory begins, and where its link to the next one is.
    fn put(self, out: &mut Vec<u8>, image: &Image) -> (usize, usize) {
        let mut tags = image.tags.clone();
        let (mut offsets, mut counts) = (Vec::new(), Vec::new());
        for chunk in &image.chunks {
            offsets.push(if chunk.is_empty() {
                0
            } else {
                out.len() as u64
            });
            counts.push(chunk.len() as u64);
            out.extend(chunk);
        }
        let (at, count) = if image.tiled { (324, 325) } else { (273, 279) };
        tags.extend([(at, LONG, offsets), (count, LONG, counts)]);
        let children: Vec<u64> = image
            .children
            .iter()
            .map(|c| self.put(out, c).0 as u64)
            .collect();
        if !children.is_empty() {
            tags.push((330, LONG, children));
        }
        tags.sort();
        let mut fields = Vec::new();
        for (tag, kind, values) in tags {
            let size = match kind {
                TEXT | 7 => 1,
                SHORT => 2,
                RATIONAL => 8,
                _ => 4,
            };
            let mut bytes = Vec::new();
            let mut n = values.len();
            match kind {
                RATIONAL => {
                    values.iter().for_each(|v| bytes.extend(self.number(*v, 4)));
                    n /= 2;
                }
                _ => values
                    .iter()
                    .for_each(|v| bytes.extend(self.number(*v, size))),
            }
            if bytes.len() > self.offset() {
                let at = out.len() as u64;
                out.extend(&bytes);
                bytes = self.number(at, self.offset());
            }
            bytes.resize(self.offset(), 0);
            fields.extend(self.number(tag.into(), 2));
            fields.extend(self.number(kind.into(), 2));
            fields.extend(self.number(n as u64, self.offset()));
            fields.extend(bytes);
        }
        let here = out.len();
        let entry = if self.wide { 20 } else { 12 };
        out.extend(self.number((fields.len() / entry) as u64, if self.wide { 8 } else { 2 }));
        out.extend(fields);
        out.extend(vec![0; self.offset()]);
        (here, out.len() - self.offset())
    }
}
