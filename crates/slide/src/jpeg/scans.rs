//! JPEGs in several scans, progressive ones above all: whether each scan is there to its end. The codes are walked through without
//! decoding them; of each block it is kept which coefficients are not 0, as later scans refine only those (ITU-T T.81, annex G).

use super::codes::{Bits, Table, Tables, segment_at};
use crate::{Budget, Fault};

const TABLES: u8 = 0xc4;
const SCAN: u8 = 0xda;
const RESTART_INTERVAL: u8 = 0xdd;
const PROGRESSIVE: u8 = 0xc2;
const FRAMES: [u8; 3] = [0xc0, 0xc1, PROGRESSIVE];

/// A colour of the image.
struct Component {
    id: u8,
    /// Blocks of an MCU, across and down.
    sampling: [usize; 2],
    /// Blocks across in a scan of several components, and in one of its own; and down.
    padded: [usize; 2],
    own: [usize; 2],
    /// Of each block, which coefficients are not 0.
    seen: Vec<u64>,
    /// Whether all bits of the mean are there.
    has_mean: bool,
}

struct Frame {
    progressive: bool,
    components: Vec<Component>,
    mcus: [usize; 2],
}

/// What one scan brings.
struct Scan {
    /// Each component with its tables.
    parts: Vec<(usize, Option<Table>, Option<Table>)>,
    /// First and last coefficient.
    from: usize,
    to: usize,
    /// Whether bits of them were there before, and whether more are to come.
    refines: bool,
    is_last: bool,
}

/// Walks through all scans. What this does not know is left to the decoder.
///
/// # Errors
/// [`Fault::Damaged`] for a scan that ends early, [`Fault::TooLarge`].
pub(super) fn walk(bytes: &[u8], budget: Budget) -> Result<(), Fault> {
    let mut tables = Tables::default();
    let (mut frame, mut interval, mut at, mut scans): (Option<Frame>, _, _, _) = (None, 0, 2, 0);
    while let Some((kind, data, end)) = segment_at(bytes, at) {
        at = end;
        match kind {
            TABLES if tables.read(data).is_none() => return Ok(()),
            RESTART_INTERVAL => {
                let Some(&[high, low]) = data.first_chunk() else {
                    return Ok(());
                };
                interval = usize::from(u16::from_be_bytes([high, low]));
            }
            kind if FRAMES.contains(&kind) => {
                let Some(read) = Frame::read(kind == PROGRESSIVE, data, budget)? else {
                    return Ok(());
                };
                frame = Some(read);
            }
            SCAN => {
                let Some(frame) = &mut frame else {
                    return Ok(());
                };
                let Some(scan) = Scan::read(data, frame, &tables) else {
                    return Ok(());
                };
                scans += 1;
                let mut bits = Bits::new(&bytes[at..]);
                scan.walk(frame, &mut bits, interval).ok_or_else(|| {
                    Fault::Damaged(format!(
                        "the image has a hole: scan {scans} makes no sense before its end"
                    ))
                })?;
                at += bits.marker();
            }
            _ => {}
        }
    }
    let means = frame.is_none_or(|f| f.components.iter().all(|c| c.has_mean));
    match means {
        true => Ok(()),
        false => Err(Fault::Truncated("scans of the JPEG are missing".into())),
    }
}

impl Frame {
    /// `None` for what the decoder tells better.
    fn read(progressive: bool, data: &[u8], budget: Budget) -> Result<Option<Self>, Fault> {
        let &[8, h1, h0, w1, w0, n, ref parts @ ..] = data else {
            return Ok(None);
        };
        let size = [[w1, w0], [h1, h0]].map(|b| usize::from(u16::from_be_bytes(b)));
        let parts: Vec<&[u8]> = parts.chunks_exact(3).take(n.into()).collect();
        let sampling = |p: &[u8]| [usize::from(p[1] >> 4), usize::from(p[1] & 15)];
        let most = |axis: usize| parts.iter().map(|p| sampling(p)[axis]).max().unwrap_or(0);
        let most = [most(0), most(1)];
        let odd = parts
            .iter()
            .any(|p| sampling(p).iter().any(|s| !(1..=4).contains(s)));
        if parts.len() != usize::from(n) || parts.is_empty() || size.contains(&0) || odd {
            return Ok(None);
        }
        let mcus = [0, 1].map(|k| size[k].div_ceil(8 * most[k]));
        let blocks: usize = parts
            .iter()
            .map(|p| sampling(p).iter().product::<usize>())
            .sum();
        let held = 8 * blocks as u64 * mcus[0] as u64 * mcus[1] as u64;
        budget.check(size.map(|n| n as u32), held)?;
        let component = |p: &&[u8]| {
            let sampling = sampling(p);
            let padded = [0, 1].map(|k| mcus[k] * sampling[k]);
            Component {
                id: p[0],
                sampling,
                padded,
                own: [0, 1].map(|k| (size[k] * sampling[k]).div_ceil(most[k]).div_ceil(8)),
                seen: vec![0; padded[0] * padded[1]],
                has_mean: false,
            }
        };
        Ok(Some(Self {
            progressive,
            components: parts.iter().map(component).collect(),
            mcus,
        }))
    }
}

impl Scan {
    fn read(data: &[u8], frame: &Frame, tables: &Tables) -> Option<Self> {
        let (&n, rest) = data.split_first()?;
        let chosen = rest.get(..2 * usize::from(n))?;
        let &[from, to, bits] = rest.get(2 * usize::from(n)..)?.first_chunk()?;
        let mut parts = Vec::new();
        for pair in chosen.chunks_exact(2) {
            let k = frame.components.iter().position(|c| c.id == pair[0])?;
            parts.push((k, tables.get(0, pair[1] >> 4), tables.get(1, pair[1] & 15)));
        }
        let (from, to) = match frame.progressive {
            true => (usize::from(from), usize::from(to)),
            false => (0, 63),
        };
        let sane = from <= to && to < 64 && !parts.is_empty();
        // Means and others come in scans of their own.
        let sane = sane && (!frame.progressive || (from == 0) == (to == 0));
        let sane = sane && (from == 0 || parts.len() == 1);
        sane.then_some(Self {
            parts,
            from,
            to,
            refines: frame.progressive && bits >> 4 != 0,
            is_last: !frame.progressive || bits & 15 == 0,
        })
    }

    fn walk(&self, frame: &mut Frame, bits: &mut Bits<'_>, interval: usize) -> Option<()> {
        let alone = self.parts.len() == 1;
        let units = match alone {
            true => frame.components[self.parts[0].0].own,
            false => frame.mcus,
        };
        let mut run = 0;
        for unit in 0..units[0] * units[1] {
            if interval > 0 && unit > 0 && unit.is_multiple_of(interval) {
                bits.restart(unit / interval)?;
                run = 0;
            }
            let [x, y] = [unit % units[0], unit / units[0]];
            for (k, dc, ac) in &self.parts {
                let component = &mut frame.components[*k];
                let [h, v] = if alone { [1, 1] } else { component.sampling };
                for block in 0..h * v {
                    let at = (y * v + block / h) * component.padded[0] + x * h + block % h;
                    let seen = component.seen.get_mut(at)?;
                    self.block(
                        bits,
                        (dc.as_ref(), ac.as_ref()),
                        seen,
                        &mut run,
                        frame.progressive,
                    )?;
                }
            }
        }
        for (k, _, _) in &self.parts {
            frame.components[*k].has_mean |= self.from == 0 && self.is_last;
        }
        Some(())
    }

    fn block(
        &self,
        bits: &mut Bits<'_>,
        (dc, ac): (Option<&Table>, Option<&Table>),
        seen: &mut u64,
        run: &mut u32,
        progressive: bool,
    ) -> Option<()> {
        if self.from == 0 {
            match self.refines {
                true => drop(bits.number(1)?),
                false => {
                    let size = dc?.read(bits)?;
                    bits.signed(size)?;
                }
            }
            if progressive {
                return Some(());
            }
        }
        match self.refines {
            true => self.refine(bits, ac?, seen, run),
            false => self.first(bits, ac?, seen, run),
        }
    }

    /// Coefficients of which nothing was there before.
    fn first(&self, bits: &mut Bits<'_>, ac: &Table, seen: &mut u64, run: &mut u32) -> Option<()> {
        if *run > 0 {
            *run -= 1;
            return Some(());
        }
        let mut k = self.from.max(1);
        while k <= self.to {
            let symbol = ac.read(bits)?;
            let (zeros, size) = (usize::from(symbol >> 4), symbol & 15);
            if size > 0 {
                k += zeros;
                bits.signed(size)?;
                *seen |= 1_u64.checked_shl(k as u32).filter(|_| k <= self.to)?;
                k += 1;
            } else if zeros == 15 {
                k += 16;
            } else {
                // The blocks from here on end, as many as it says.
                *run = (1 << zeros) - 1 + bits.number(zeros as u32)?;
                return Some(());
            }
        }
        // More than there are: it has lost its way.
        (k == self.to + 1).then_some(())
    }

    /// One more bit of those that are not 0, and new ones between them.
    fn refine(&self, bits: &mut Bits<'_>, ac: &Table, seen: &mut u64, run: &mut u32) -> Option<()> {
        let mut k = self.from.max(1);
        while *run == 0 && k <= self.to {
            let symbol = ac.read(bits)?;
            let (mut zeros, size) = (usize::from(symbol >> 4), symbol & 15);
            match (size, zeros) {
                (0, 15) => {}
                (0, _) => {
                    *run = (1 << zeros) + bits.number(zeros as u32)?;
                    break;
                }
                (1, _) => drop(bits.number(1)?),
                _ => return None,
            }
            while k <= self.to {
                if *seen >> k & 1 == 1 {
                    bits.number(1)?;
                } else if zeros == 0 {
                    break;
                } else {
                    zeros -= 1;
                }
                k += 1;
            }
            if size == 1 {
                *seen |= 1_u64.checked_shl(k as u32).filter(|_| k <= self.to)?;
            }
            k += 1;
        }
        if *run > 0 {
            for k in k..=self.to {
                if *seen >> k & 1 == 1 {
                    bits.number(1)?;
                }
            }
            *run -= 1;
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 16 x 12 pixels, `10 x + 7 y`, progressive.
    const SLOPE: &[u8] = include_bytes!("../../tests/data/progressive.jpg");

    const BUDGET: Budget = Budget { bytes: 1 << 20 };

    #[test]
    fn a_whole_one_passes_and_any_cut_with_an_end_does_not() {
        walk(SLOPE, BUDGET).unwrap();
        let jpeg = super::super::Jpeg::open(SLOPE, BUDGET).unwrap();
        let (samples, channels) = jpeg.samples(super::super::Colours::Own, BUDGET, 0).unwrap();
        assert_eq!(channels, 1);
        for (i, v) in (0..).zip(samples) {
            let want = 10 * (i % 16) + 7 * (i / 16);
            assert!(i32::from(v).abs_diff(want) < 9, "{i}: {v} {want}");
        }
        let first = SLOPE.windows(2).position(|w| w == [0xff, SCAN]).unwrap();
        let (mut told, mut all) = (0, 0);
        for cut in first + 12..SLOPE.len() - 3 {
            let mut bytes = SLOPE[..cut].to_vec();
            bytes.extend([0xff, 0xd9]);
            all += 1;
            told += usize::from(super::super::Jpeg::open(&bytes[..], BUDGET).is_err());
        }
        // Between scans nothing is missing but how fine it is.
        assert!(all > 100 && told * 10 > all * 3, "{told} of {all}");
        let third = [&SLOPE[..first + 12], &[0xff, 0xd9]].concat();
        assert!(super::super::Jpeg::open(&third[..], BUDGET).is_err());
    }

    #[test]
    fn more_blocks_than_there_may_be_are_not_held() {
        let mut large = SLOPE.to_vec();
        let frame = large
            .windows(2)
            .position(|w| w == [0xff, PROGRESSIVE])
            .unwrap();
        large[frame + 5..frame + 9].copy_from_slice(&[0xff, 0xdc, 0xff, 0xdc]);
        assert!(matches!(walk(&large, BUDGET), Err(Fault::TooLarge { .. })));
    }
}
