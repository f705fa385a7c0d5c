//! Whether a camera shows one image again and again, with new time stamps: no two exposures of a sensor are the same to the last sample, and
//! least of all with a move of the stage between them.

use crate::{Axis, Frame, Samples, StagePose};

/// So many samples tell whether two images are the same.
const LOOKED_AT: usize = 1 << 16;
/// An image with fewer levels than this may come twice: black, or white.
const LEVELS: usize = 16;
/// So does one without noise of what is out of focus: more than this share of its neighbours are equal.
const EQUAL: f64 = 0.7;
/// A stage that went less far may show the same, m and rad.
const MOVED: [f64; 2] = [0.5e-6, 5e-5];
/// So often may an image come again that a move was to change: frames are sometimes sent twice.
const AGAIN: u32 = 1;

/// A camera is known to have noise when so many images of a stage at rest differed from the one before, and none was the same.
const NOISY: u32 = 3;

/// What the images of a stage at rest have shown.
#[derive(Debug, Default)]
pub(super) struct AtRest {
    /// Images that differed from the one before.
    differed: u32,
    /// Whether one was the same before noise was known: the camera may have none.
    quiet: bool,
    /// Whether the last one was the same, of a camera that has noise.
    again: bool,
    /// Whether it is asked if the camera still lives, as it shows nothing new.
    doubted: bool,
    /// Whether it was asked, and lived: its images at rest are the same now.
    alike: bool,
}

impl AtRest {
    /// Takes the next image of a stage that has not moved: whether it is the same as the one before.
    fn take(&mut self, same: bool) {
        let noisy = !self.quiet && self.differed >= NOISY;
        self.again = same && noisy && !self.alike;
        match same {
            false => {
                self.differed = self.differed.saturating_add(1);
                (self.alike, self.doubted) = (false, false);
            }
            true => self.quiet |= !noisy,
        }
    }

    /// The images of a stage at rest have been the same for long: that is no proof. Whether the camera lives is seen after the next move.
    pub(super) fn doubt(&mut self) {
        self.doubted = true;
    }

    /// Takes an image from elsewhere that is another one than the last.
    fn changed(&mut self) {
        self.alike |= std::mem::take(&mut self.doubted);
    }

    /// Whether the last image was the very same as the one before it, of a camera whose images at rest differ.
    pub(super) fn again(&self) -> bool {
        self.again
    }

    /// Nothing of the last image is known.
    pub(super) fn forget(&mut self) {
        self.again = false;
    }
}

/// The last image.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shown {
    print: u64,
    at: StagePose,
    /// How often it came again, since a move was to change it.
    again: u32,
}

impl Shown {
    /// Whether it has come again since a move was to change it.
    pub(super) fn is_from_before(&self) -> bool {
        self.again > 0
    }

    /// Takes the next image, with where the stage stands. Returns whether it is one that has come again too often.
    pub(super) fn comes_again(
        (last, at_rest): &mut (Option<Self>, AtRest),
        frame: &Frame,
        at: StagePose,
    ) -> bool {
        at_rest.forget();
        let Some(print) = print(&frame.samples, frame.channels.count()) else {
            return false;
        };
        match *last {
            Some(before) if before.at == at => at_rest.take(before.print == print),
            Some(before) if before.print != print => at_rest.changed(),
            _ => {}
        }
        let again = match *last {
            Some(before) if before.print == print => {
                let stays = before.again == 0 && !moved(&before.at, &at);
                before.again + u32::from(!stays)
            }
            _ => 0,
        };
        // Once it is told it counts anew: who goes on may have mended it.
        let is_told = again > AGAIN;
        *last = (!is_told).then_some(Self { print, at, again });
        is_told
    }
}

fn moved(from: &StagePose, to: &StagePose) -> bool {
    Axis::ALL.into_iter().any(|axis| {
        let least = MOVED[usize::from(axis.is_rotation())];
        let way = to.si(axis).zip(from.si(axis)).map(|(b, a)| (b - a).abs());
        way.is_some_and(|way| way > least)
    })
}

/// A number that two images share only when they are the same; `None` for one of too few levels, or without noise and structure.
fn print(samples: &Samples, channels: usize) -> Option<u64> {
    match samples {
        Samples::U8(v) => hash(v.len(), channels, |i| u16::from(v[i])),
        Samples::U16(v) => hash(v.len(), channels, |i| v[i]),
    }
}

/// FNV-1a of samples spread over all.
fn hash(count: usize, channels: usize, at: impl Fn(usize) -> u16) -> Option<u64> {
    let mut levels = std::collections::BTreeSet::new();
    let mut print = 0xcbf2_9ce4_8422_2325_u64;
    let (mut equal, mut looked_at) = (0usize, 0usize);
    for i in (0..count.saturating_sub(channels)).step_by(count / LOOKED_AT + 1) {
        let sample = at(i);
        equal += usize::from(sample == at(i + channels));
        looked_at += 1;
        if levels.len() < LEVELS {
            levels.insert(sample);
        }
        print = (print ^ u64::from(sample)).wrapping_mul(0x0100_0000_01b3);
    }
    let differs = equal as f64 <= EQUAL * looked_at as f64;
    (levels.len() >= LEVELS && differs).then_some(print)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_told_apart_by_one_sample_and_flat_ones_are_not_told_at_all() {
        let ramp = |change: u8| {
            let mut v: Vec<u8> = (0..200).collect();
            v[150] = v[150].wrapping_add(change);
            print(&Samples::U8(v), 1)
        };
        assert!(ramp(0).is_some() && ramp(0) == ramp(0));
        assert_ne!(ramp(0), ramp(1));
        assert_eq!(print(&Samples::U16(vec![4095; 1000]), 1), None);
        assert_eq!(print(&Samples::U8(Vec::new()), 1), None);
        // Without noise, and blurred: hardly any step from one sample to the next.
        let smooth = (0..2000u16).map(|i| (i / 10) as u8).collect();
        assert_eq!(print(&Samples::U8(smooth), 1), None);
    }

    #[test]
    fn a_camera_whose_images_differ_at_rest_shows_none_again() {
        let again = |same: &[bool]| {
            let mut at_rest = AtRest::default();
            let each = same.iter().map(|same| {
                at_rest.take(*same);
                at_rest.again()
            });
            each.collect::<Vec<_>>()
        };
        let (d, s) = (false, true);
        assert_eq!(again(&[d, d, d, s, s, d, s]), [d, d, d, s, s, d, s]);
        // One without noise: the specimen was moved.
        assert_eq!(again(&[s, s, d, d, d, d, s]), [d; 7]);
        assert_eq!(again(&[d, d, s, d, d, d, s]), [d; 7]);
    }

    #[test]
    fn a_camera_that_is_doubted_and_shows_another_image_may_have_lost_its_noise() {
        let mut at_rest = AtRest::default();
        let take = |at_rest: &mut AtRest, same: bool| {
            at_rest.take(same);
            at_rest.again()
        };
        for _ in 0..NOISY {
            assert!(!take(&mut at_rest, false));
        }
        assert!(take(&mut at_rest, true));
        // Another image alone is no answer where nobody asked.
        at_rest.changed();
        assert!(take(&mut at_rest, true));
        at_rest.doubt();
        assert!(take(&mut at_rest, true), "nothing has moved yet");
        at_rest.changed();
        assert!(!take(&mut at_rest, true), "it lives, and has no noise");
        assert!(!take(&mut at_rest, true));
        // What differs at rest has noise, asked or not: then the same image counts again.
        at_rest.doubt();
        assert!(!take(&mut at_rest, false));
        at_rest.changed();
        assert!(take(&mut at_rest, true));
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
