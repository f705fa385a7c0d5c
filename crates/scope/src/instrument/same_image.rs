//! Whether a camera shows one image again and again, with new time stamps.

use super::Instrument;
use crate::{Axis, Frame, Samples, ScopeError, StagePose};

/// So many samples tell whether two images are the same.
const LOOKED_AT: usize = 1 << 16;
/// An image with fewer levels than this may come twice: black, or white.
const LEVELS: usize = 16;
/// A stage that went less far may show the same, m and rad.
const MOVED: [f64; 2] = [0.5e-6, 5e-5];
/// So often may an image come again that a move was to change: frames are sometimes sent twice.
const AGAIN: u32 = 1;

/// The last image.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shown {
    print: u64,
    at: StagePose,
    /// How often it came again, since a move was to change it.
    again: u32,
}

impl Instrument {
    /// Notices a camera that has frozen: no two exposures of a sensor are the same to the last sample, and least of all with a move of the
    /// stage between them.
    ///
    /// # Errors
    /// [`ScopeError::Frozen`] once the same image has come again twice.
    pub fn check_new(&self, frame: &Frame) -> Result<(), ScopeError> {
        let (Some(print), Some(at)) = (print(&frame.samples), self.gate.last_reported()) else {
            return Ok(());
        };
        let mut last = self.shown.lock().unwrap_or_else(|e| e.into_inner());
        let again = match *last {
            Some(before) if before.print == print => {
                let stays = before.again == 0 && !moved(&before.at, &at);
                before.again + u32::from(!stays)
            }
            _ => 0,
        };
        *last = Some(Shown { print, at, again });
        if again > AGAIN {
            // Once it is told it counts anew: who goes on may have mended it.
            *last = None;
            return Err(ScopeError::Frozen { device: "camera" });
        }
        Ok(())
    }
}

fn moved(from: &StagePose, to: &StagePose) -> bool {
    Axis::ALL.into_iter().any(|axis| {
        let least = MOVED[usize::from(axis.is_rotation())];
        let way = to.si(axis).zip(from.si(axis)).map(|(b, a)| (b - a).abs());
        way.is_some_and(|way| way > least)
    })
}

/// A number that two images share only when they are the same; `None` for one of too few levels.
fn print(samples: &Samples) -> Option<u64> {
    match samples {
        Samples::U8(v) => hash(v.len(), |i| u16::from(v[i])),
        Samples::U16(v) => hash(v.len(), |i| v[i]),
    }
}

/// FNV-1a of samples spread over all.
fn hash(count: usize, at: impl Fn(usize) -> u16) -> Option<u64> {
    let mut levels = std::collections::BTreeSet::new();
    let mut print = 0xcbf2_9ce4_8422_2325_u64;
    for i in (0..count).step_by(count / LOOKED_AT + 1) {
        let sample = at(i);
        if levels.len() < LEVELS {
            levels.insert(sample);
        }
        print = (print ^ u64::from(sample)).wrapping_mul(0x0100_0000_01b3);
    }
    (levels.len() >= LEVELS).then_some(print)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_told_apart_by_one_sample_and_flat_ones_are_not_told_at_all() {
        let ramp = |change: u8| {
            let mut v: Vec<u8> = (0..200).collect();
            v[150] = v[150].wrapping_add(change);
            print(&Samples::U8(v))
        };
        assert!(ramp(0).is_some() && ramp(0) == ramp(0));
        assert_ne!(ramp(0), ramp(1));
        assert_eq!(print(&Samples::U16(vec![4095; 1000])), None);
        assert_eq!(print(&Samples::U8(Vec::new())), None);
    }

    #[test]
    fn what_counts_as_a_move_is_half_a_micrometre() {
        let at = |x: f64, rz: f64| {
            StagePose::default()
                .with_si(Axis::X, x)
                .with_si(Axis::Rz, rz)
        };
        assert!(!moved(&at(0.0, 0.0), &at(0.4e-6, 4e-5)));
        assert!(moved(&at(0.0, 0.0), &at(0.6e-6, 0.0)));
        assert!(moved(&at(0.0, 0.0), &at(0.0, 6e-5)));
    }
}
