//! Directories of a TIFF: tags and their values, classic and big, either byte order.

use std::collections::{BTreeMap, HashSet};

use crate::Fault;
use crate::input::Input;

pub(crate) const NEW_SUBFILE_TYPE: u16 = 254;
pub(crate) const WIDTH: u16 = 256;
pub(crate) const HEIGHT: u16 = 257;
pub(crate) const BITS: u16 = 258;
pub(crate) const COMPRESSION: u16 = 259;
pub(crate) const PHOTOMETRIC: u16 = 262;
pub(crate) const FILL_ORDER: u16 = 266;
pub(crate) const DESCRIPTION: u16 = 270;
pub(crate) const STRIP_OFFSETS: u16 = 273;
pub(crate) const ORIENTATION: u16 = 274;
pub(crate) const SAMPLES: u16 = 277;
pub(crate) const ROWS_PER_STRIP: u16 = 278;
pub(crate) const STRIP_COUNTS: u16 = 279;
pub(crate) const X_RESOLUTION: u16 = 282;
pub(crate) const Y_RESOLUTION: u16 = 283;
pub(crate) const PLANAR: u16 = 284;
pub(crate) const FAX3_OPTIONS: u16 = 292;
pub(crate) const RESOLUTION_UNIT: u16 = 296;
pub(crate) const PREDICTOR: u16 = 317;
pub(crate) const COLOR_MAP: u16 = 320;
pub(crate) const TILE_WIDTH: u16 = 322;
pub(crate) const TILE_HEIGHT: u16 = 323;
pub(crate) const TILE_OFFSETS: u16 = 324;
pub(crate) const TILE_COUNTS: u16 = 325;
pub(crate) const SUB_IFDS: u16 = 330;
pub(crate) const EXTRA_SAMPLES: u16 = 338;
pub(crate) const SAMPLE_FORMAT: u16 = 339;
pub(crate) const JPEG_TABLES: u16 = 347;
pub(crate) const SUBSAMPLING: u16 = 530;

/// Directories looked at before the rest is left out.
const MAX_DIRECTORIES: usize = 10_000;
/// Tags of one directory.
const MAX_TAGS: u64 = 4096;
/// Bytes of one tag's values: the offsets of a gigapixel of small tiles, and no more.
const MAX_VALUE_BYTES: u64 = 32 << 20;

/// Byte order and width of offsets.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Form {
    pub(crate) big_endian: bool,
    /// BigTIFF: offsets of 8 bytes.
    wide: bool,
}

impl Form {
    fn number(self, bytes: &[u8]) -> u64 {
        let fold = |v: u64, b: &u8| v << 8 | u64::from(*b);
        match self.big_endian {
            true => bytes.iter().fold(0, fold),
            false => bytes.iter().rev().fold(0, fold),
        }
    }
}

/// One tag.
#[derive(Clone, Debug)]
struct Entry {
    kind: u64,
    count: u64,
    /// The field of the value itself, or of its offset.
    field: Vec<u8>,
}

/// The tags of one directory.
#[derive(Clone, Debug)]
pub(crate) struct Directory {
    pub(crate) form: Form,
    tags: BTreeMap<u16, Entry>,
}

/// Bytes of a value by its type.
fn size_of(kind: u64) -> Option<u64> {
    Some(match kind {
        1 | 2 | 6 | 7 => 1,
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16 | 17 | 18 => 8,
        _ => return None,
    })
}

/// All directories that follow each other in a file, the first first.
pub(crate) fn all(input: &Input<'_>) -> Result<Vec<Directory>, Fault> {
    let head = input.bytes(0, 8)?;
    let big_endian = head.starts_with(b"MM");
    let mut form = Form {
        big_endian,
        wide: false,
    };
    form.wide = form.number(&head[2..4]) == 43;
    let first = match form.wide {
        true => form.number(&input.bytes(8, 8)?),
        false => form.number(&head[4..8]),
    };
    let directories = chain(input, form, first, MAX_DIRECTORIES)?;
    match directories.is_empty() {
        true => Err(Fault::Damaged("it has no directory of an image".into())),
        false => Ok(directories),
    }
}

/// The directories from an offset on. A later one that cannot be read, or one again, ends them.
fn chain(input: &Input<'_>, form: Form, first: u64, most: usize) -> Result<Vec<Directory>, Fault> {
    let (mut at, mut seen, mut all) = (first, HashSet::new(), Vec::new());
    while at != 0 && all.len() < most && seen.insert(at) {
        match Directory::read(input, form, at) {
            Ok((directory, next)) => {
                all.push(directory);
                at = next;
            }
            Err(fault) if all.is_empty() => return Err(fault),
            Err(_) => break,
        }
    }
    Ok(all)
}

impl Directory {
    /// A directory, and where the next one is, 0 after the last.
    fn read(input: &Input<'_>, form: Form, at: u64) -> Result<(Self, u64), Fault> {
        let (count_bytes, entry_bytes, offset_bytes) =
            if form.wide { (8, 20, 8) } else { (2, 12, 4) };
        let count = form.number(&input.bytes(at, count_bytes)?);
        if count == 0 || count > MAX_TAGS {
            return Err(Fault::Damaged(format!("a directory has {count} tags")));
        }
        let entries = input.bytes(at + count_bytes, count * entry_bytes)?;
        let mut tags = BTreeMap::new();
        for entry in entries.chunks_exact(entry_bytes as usize) {
            let (tag, kind) = (form.number(&entry[..2]) as u16, form.number(&entry[2..4]));
            let (count, field) = match form.wide {
                true => (form.number(&entry[4..12]), &entry[12..]),
                false => (form.number(&entry[4..8]), &entry[8..]),
            };
            tags.entry(tag).or_insert_with(|| Entry {
                kind,
                count,
                field: field.to_vec(),
            });
        }
        // The last directory of some files is cut off before its link.
        let next = input.bytes(at + count_bytes + count * entry_bytes, offset_bytes);
        let next = next.map_or(0, |bytes| form.number(&bytes));
        Ok((Self { form, tags }, next))
    }

    pub(crate) fn has(&self, tag: u16) -> bool {
        self.tags.contains_key(&tag)
    }

    /// The bytes of a tag's values, each of so many bytes, and their type.
    pub(crate) fn bytes(
        &self,
        input: &Input<'_>,
        tag: u16,
    ) -> Result<Option<(Vec<u8>, u64, u64)>, Fault> {
        let Some(entry) = self.tags.get(&tag) else {
            return Ok(None);
        };
        let Some(size) = size_of(entry.kind) else {
            return Ok(None);
        };
        let total = entry.count.saturating_mul(size);
        if total > MAX_VALUE_BYTES {
            return Err(Fault::Damaged(format!(
                "tag {tag} claims an impossible size"
            )));
        }
        let bytes = match total <= entry.field.len() as u64 {
            true => entry.field[..total as usize].to_vec(),
            false => input.bytes(self.form.number(&entry.field), total)?,
        };
        Ok(Some((bytes, size, entry.kind)))
    }

    /// The values of a tag of whole numbers; none for one that is not there, or of another type.
    pub(crate) fn numbers(&self, input: &Input<'_>, tag: u16) -> Result<Option<Vec<u64>>, Fault> {
        let Some((bytes, size, kind)) = self.bytes(input, tag)? else {
            return Ok(None);
        };
        if !matches!(kind, 1 | 3 | 4 | 7 | 13 | 16 | 18) {
            return Ok(None);
        }
        let values = bytes.chunks_exact(size as usize);
        Ok(Some(values.map(|v| self.form.number(v)).collect()))
    }

    /// The first value of a tag of whole numbers.
    pub(crate) fn number(&self, input: &Input<'_>, tag: u16) -> Result<Option<u64>, Fault> {
        Ok(self.numbers(input, tag)?.and_then(|v| v.first().copied()))
    }

    /// The text of a tag, up to its end.
    pub(crate) fn text(&self, input: &Input<'_>, tag: u16) -> Option<String> {
        let (bytes, size, _) = self.bytes(input, tag).ok()??;
        let bytes = bytes.split(|b| *b == 0).next()?;
        (size == 1).then(|| String::from_utf8_lossy(bytes).into_owned())
    }

    /// The first value of a tag of fractions, above 0.
    pub(crate) fn fraction(&self, input: &Input<'_>, tag: u16) -> Option<f64> {
        let (bytes, size, kind) = self.bytes(input, tag).ok()??;
        let value = match (kind, size) {
            (5, 8) => {
                let (n, d) = (
                    self.form.number(bytes.get(..4)?),
                    self.form.number(bytes.get(4..8)?),
                );
                n as f64 / d as f64
            }
            (11, 4) => f64::from(f32::from_bits(self.form.number(bytes.get(..4)?) as u32)),
            (12, 8) => f64::from_bits(self.form.number(bytes.get(..8)?)),
            _ => return None,
        };
        (value > 0.0 && value.is_finite()).then_some(value)
    }

    /// Directories that hang on this one: reduced images of it.
    pub(crate) fn children(&self, input: &Input<'_>) -> Vec<Directory> {
        let offsets = self
            .numbers(input, SUB_IFDS)
            .ok()
            .flatten()
            .unwrap_or_default();
        let mut all = Vec::new();
        for at in offsets.into_iter().take(64).filter(|at| *at != 0) {
            all.extend(chain(input, self.form, at, 64).unwrap_or_default());
        }
        all
    }

    /// Columns and rows.
    pub(crate) fn size(&self, input: &Input<'_>) -> Result<[u32; 2], Fault> {
        let side = |tag: u16| {
            let n = self.number(input, tag)?.unwrap_or(0);
            u32::try_from(n).map_err(|_| Fault::Damaged(format!("it claims {n} pixels across")))
        };
        Ok([side(WIDTH)?, side(HEIGHT)?])
    }
}
