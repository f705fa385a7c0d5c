//! A frame as the page shows it: 8-bit colour, and brighter than it was taken where it would be too dark to see anything.

use scopeservo_scope::{Channels, Frame, Samples};

/// The share of an image's pixels that may be lost to white: so few extreme ones set no range.
const EXTREME: f64 = 0.001;
/// An image whose brightest pixels, those aside, use more of the camera's range than this is shown as it was taken.
const DIM: f64 = 0.25;
/// Where the brightest pixels of a dim one are put, as a share of the range.
const BRIGHT: f64 = 0.8;

/// 8-bit RGB, row-major, and how many times as bright as taken that is. The frame itself stays what it is.
pub(crate) fn rgb8(frame: &Frame) -> (Vec<u8>, f64) {
    let full = f64::from((1_u32 << frame.bit_depth.clamp(1, 16)) - 1);
    let samples: Vec<u16> = match &frame.samples {
        Samples::U8(s) => s.iter().map(|&v| v.into()).collect(),
        Samples::U16(s) => s.clone(),
    };
    let bright = brightest(&samples) / full;
    if samples.is_empty() || bright >= DIM {
        return (frame.rgb8(), 1.0);
    }
    // All channels alike, so that colours stay what they are.
    let gain = BRIGHT / bright.max(1.0 / full);
    let byte = |v: u16| (f64::from(v) * gain * 255.0 / full).round().min(255.0) as u8;
    let bytes = samples.iter().map(|&v| byte(v));
    let rgb = match frame.channels {
        Channels::Rgb => bytes.collect(),
        Channels::Gray => bytes.flat_map(|v| [v, v, v]).collect(),
    };
    (rgb, gain)
}

/// The value that all but a few samples do not exceed.
fn brightest(samples: &[u16]) -> f64 {
    let mut counts = vec![0_usize; 1 << 16];
    for &v in samples {
        counts[usize::from(v)] += 1;
    }
    let mut left = (EXTREME * samples.len() as f64).ceil() as usize;
    let mut value = counts.len() - 1;
    while value > 0 && counts[value] <= left {
        left -= counts[value];
        value -= 1;
    }
    value as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::Timestamp;
    use std::time::Duration;

    fn frame(bit_depth: u8, channels: Channels, samples: Samples) -> Frame {
        Frame {
            width: 100,
            height: 100,
            channels,
            bit_depth,
            samples,
            sequence: 0,
            exposure_start: Timestamp::default(),
            exposure: Duration::ZERO,
        }
    }

    /// 0 to `most` along each row.
    fn ramp(most: u16) -> Vec<u16> {
        (0..10_000)
            .map(|i: u32| (i % 100 * u32::from(most) / 99) as u16)
            .collect()
    }

    #[test]
    fn dim_images_of_every_depth_are_brightened_alike_and_bright_ones_are_not() {
        for (bits, most) in [(16, 1023), (16, 4095), (12, 255), (10, 200), (16, 300)] {
            let full = f64::from((1_u32 << bits) - 1);
            let (rgb, gain) = rgb8(&frame(bits, Channels::Gray, Samples::U16(ramp(most))));
            assert!(
                (gain - 0.8 * full / f64::from(most)).abs() < 1e-9,
                "{bits} {most}: {gain}"
            );
            // The brightest is where it is to be, the darkest stays dark, and the middle is the middle.
            assert_eq!([rgb[0], rgb[3 * 99]], [0, 204], "{bits} {most}");
            assert!(
                rgb[3 * 50].abs_diff(103) <= 1,
                "{bits} {most}: {}",
                rgb[3 * 50]
            );
        }
        let eight = ramp(40).iter().map(|&v| v as u8).collect();
        assert_eq!(
            rgb8(&frame(8, Channels::Gray, Samples::U8(eight))).0[3 * 99],
            204
        );
        for (bits, most) in [(16, 65535), (12, 4095), (16, 20000), (8, 64)] {
            let taken = frame(bits, Channels::Gray, Samples::U16(ramp(most)));
            assert_eq!(rgb8(&taken), (taken.rgb8(), 1.0), "{bits} {most}");
        }
    }

    #[test]
    fn a_few_extreme_pixels_set_no_range_and_colours_stay() {
        let (plain, gain) = rgb8(&frame(16, Channels::Gray, Samples::U16(ramp(1000))));
        for (at, value) in [(5, 65535), (777, 30_000), (9_999, 65_535)] {
            let mut hot = ramp(1000);
            hot[at] = value;
            let (shown, with) = rgb8(&frame(16, Channels::Gray, Samples::U16(hot)));
            assert_eq!((shown[3 * at], with), (255, gain));
            let others = |rgb: &[u8]| [&rgb[..3 * at], &rgb[3 * at + 3..]].concat();
            assert_eq!(others(&shown), others(&plain));
        }
        let colour: Vec<u16> = (0..30_000).map(|i| [100, 50, 25][i % 3]).collect();
        let (rgb, _) = rgb8(&frame(12, Channels::Rgb, Samples::U16(colour)));
        assert_eq!(rgb[..3], [204, 102, 51]);
        // Nothing but black stays black.
        let (black, _) = rgb8(&frame(16, Channels::Gray, Samples::U16(vec![0; 10_000])));
        assert!(black.iter().all(|&v| v == 0));
    }
}
