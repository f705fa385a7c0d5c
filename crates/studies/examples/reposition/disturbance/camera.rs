//! A camera whose images are changed on their way.

use scopeservo_geometry::SplitMix64;
use scopeservo_scope::{Camera, CameraInfo, Frame, Samples, ScopeError};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// What is done to an image, of samples from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Change {
    /// This share of it is grey: a rectangle whose corner lies at these shares of what is left.
    Mask(f64, [f64; 2]),
    /// A grey square of so many pixels, at these shares of what is left.
    Square(usize, [f64; 2]),
    /// Gaussian, sigma in px.
    Blur(f64),
    /// So many grey levels of 255 more.
    Add(f64),
    /// So many times as bright.
    Times(f64),
    /// So many times the contrast, about the middle grey.
    Contrast(f64),
    Gamma(f64),
    /// Standard deviation in grey levels of 255.
    Noise(f64),
    /// Brighter to one side by this share and darker to the other.
    Uneven([f64; 2]),
}

pub(crate) struct Disturbed {
    pub(crate) real: Box<dyn Camera>,
    pub(crate) changes: Arc<Mutex<Vec<Change>>>,
}

impl Camera for Disturbed {
    fn info(&self) -> &CameraInfo {
        self.real.info()
    }
    fn exposure(&self) -> Result<Duration, ScopeError> {
        self.real.exposure()
    }
    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
        self.real.set_exposure(exposure)
    }
    fn grab(&self) -> Result<Frame, ScopeError> {
        let frame = self.real.grab()?;
        let changes = self.changes.lock().unwrap_or_else(|e| e.into_inner());
        Ok(match changes.is_empty() {
            true => frame,
            false => changed(frame, &changes),
        })
    }
}

fn changed(frame: Frame, changes: &[Change]) -> Frame {
    let most = f64::from((1u32 << frame.bit_depth) - 1);
    let mut image: Vec<f64> = match &frame.samples {
        Samples::U8(v) => v.iter().map(|&s| f64::from(s) / most).collect(),
        Samples::U16(v) => v.iter().map(|&s| f64::from(s) / most).collect(),
    };
    let mut rng = SplitMix64::new(0xD157 ^ frame.sequence);
    let (width, height, channels) = (frame.width, frame.height, frame.channels.count());
    for change in changes {
        apply(change, &mut image, [width, height, channels], &mut rng);
    }
    let back = |v: &f64| (v * most).round().clamp(0.0, most);
    let samples = match &frame.samples {
        Samples::U8(_) => Samples::U8(image.iter().map(|v| back(v) as u8).collect()),
        Samples::U16(_) => Samples::U16(image.iter().map(|v| back(v) as u16).collect()),
    };
    Frame { samples, ..frame }
}

fn apply(change: &Change, image: &mut [f64], size: [usize; 3], rng: &mut SplitMix64) {
    let [width, height, channels] = size;
    let mut each = |f: &mut dyn FnMut(f64, [f64; 2]) -> f64| {
        for (k, v) in image.iter_mut().enumerate() {
            let pixel = k / channels;
            *v = f(*v, [(pixel % width) as f64, (pixel / width) as f64]);
        }
    };
    let mut cover = |sides: [f64; 2], at: [f64; 2]| {
        let from = [0, 1].map(|k| at[k] * ([width, height][k] as f64 - sides[k]));
        each(&mut |v, p| {
            let inside = (0..2).all(|k| (from[k]..from[k] + sides[k]).contains(&p[k]));
            if inside { 0.5 } else { v }
        });
    };
    match *change {
        Change::Mask(share, at) => {
            cover([width, height].map(|side| side as f64 * share.sqrt()), at);
        }
        Change::Square(side, at) => cover([side as f64; 2], at),
        Change::Blur(sigma) => blur(image, size, sigma),
        Change::Add(levels) => each(&mut |v, _| v + levels / 255.0),
        Change::Times(factor) => each(&mut |v, _| v * factor),
        Change::Contrast(factor) => each(&mut |v, _| 0.5 + factor * (v - 0.5)),
        Change::Gamma(gamma) => each(&mut |v, _| v.max(0.0).powf(gamma)),
        Change::Noise(levels) => each(&mut |v, _| v + levels / 255.0 * normal(rng)),
        Change::Uneven(by) => each(&mut |v, [x, y]| {
            let [x, y] = [x / width as f64 - 0.5, y / height as f64 - 0.5];
            v * (1.0 + 2.0 * (by[0] * x + by[1] * y))
        }),
    }
    for v in image {
        *v = v.clamp(0.0, 1.0);
    }
}

/// By the sum of twelve.
fn normal(rng: &mut SplitMix64) -> f64 {
    (0..12).map(|_| rng.uniform()).sum::<f64>() - 6.0
}

/// Row by row and column by column; the edge goes on.
fn blur(image: &mut [f64], [width, height, channels]: [usize; 3], sigma: f64) {
    let reach = (3.5 * sigma).ceil() as i64;
    let weight = |d: i64| (-0.5 * (d as f64 / sigma).powi(2)).exp();
    let kernel: Vec<f64> = (-reach..=reach).map(weight).collect();
    let sum: f64 = kernel.iter().sum();
    for (count, stride, lines, step) in [
        (width, channels, height, width * channels),
        (height, width * channels, width, channels),
    ] {
        let mut line = vec![0.0; count];
        for first in (0..lines).flat_map(|l| (0..channels).map(move |c| l * step + c)) {
            for (i, v) in line.iter_mut().enumerate() {
                *v = image[first + i * stride];
            }
            for i in 0..count {
                let at = |d: i64| line[(i as i64 + d).clamp(0, count as i64 - 1) as usize];
                let all = (-reach..=reach).zip(&kernel).map(|(d, w)| w * at(d));
                image[first + i * stride] = all.sum::<f64>() / sum;
            }
        }
    }
}
