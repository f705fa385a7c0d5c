//! What a camera shows that has a fault, in place of what it has just taken.

use scopeservo_scope::{Frame, Samples};
use std::collections::VecDeque;

/// Images are late by so many grabs at the most.
const MOST: usize = 12;

/// The images of before, and what is wrong.
#[derive(Debug)]
pub(crate) struct Shown {
    /// It gives none at all.
    pub(crate) silent: bool,
    frozen: bool,
    /// By how many grabs images are late.
    late: usize,
    binned: usize,
    /// The last ones that were taken.
    kept: VecDeque<Samples>,
}

impl Default for Shown {
    fn default() -> Self {
        Self {
            silent: false,
            frozen: false,
            late: 0,
            binned: 1,
            kept: VecDeque::new(),
        }
    }
}

impl Shown {
    pub(crate) fn freeze(&mut self, frozen: bool) {
        self.frozen = frozen;
    }

    pub(crate) fn lag(&mut self, grabs: usize) {
        self.late = grabs.min(MOST);
    }

    pub(crate) fn bin(&mut self, count: usize) {
        self.binned = count.max(1);
    }

    /// What is shown of a frame.
    pub(crate) fn show(&mut self, taken: Frame) -> Frame {
        if !self.frozen || self.kept.is_empty() {
            self.kept.push_back(taken.samples.clone());
            if self.kept.len() > MOST {
                self.kept.pop_front();
            }
        }
        let there = self.kept.len().saturating_sub(1 + self.late);
        let samples = match self.kept.get(there) {
            Some(shown) => shown.clone(),
            None => taken.samples.clone(),
        };
        binned(Frame { samples, ..taken }, self.binned)
    }
}

/// So many pixels by as many become one, their mean; what is left at the edges goes.
fn binned(frame: Frame, count: usize) -> Frame {
    if count == 1 {
        return frame;
    }
    let channels = frame.channels.count();
    let (width, height) = (frame.width / count, frame.height / count);
    let mean = |at: &dyn Fn(usize) -> u32, k: usize| {
        let (pixel, channel) = (k / channels, k % channels);
        let (x, y) = (pixel % width * count, pixel / width * count);
        let block = (0..count * count).map(|b| (y + b / count) * frame.width + x + b % count);
        let sum: u32 = block.map(|p| at(p * channels + channel)).sum();
        sum / (count * count) as u32
    };
    let all = 0..width * height * channels;
    // A mean is no larger than what it is of.
    let samples = match &frame.samples {
        Samples::U8(v) => {
            let at = |i: usize| u32::from(v[i]);
            Samples::U8(all.map(|k| mean(&at, k) as u8).collect())
        }
        Samples::U16(v) => {
            let at = |i: usize| u32::from(v[i]);
            Samples::U16(all.map(|k| mean(&at, k) as u16).collect())
        }
    };
    Frame {
        width,
        height,
        samples,
        ..frame
    }
}
