//! The paper's sharpness of one frame, for who looks at one frame alone.

use super::levels::Plane;
use super::measure::Measure;
use scopeservo_scope::Frame;

/// Mean |Laplacian| of the luminance (4-neighbour mask, inner pixels) over its mean: light that changes with the height, or
/// flickers, is no sharpness. 0 for a black frame.
pub fn sharpness(frame: &Frame) -> f64 {
    let image = Plane::of(frame);
    let (w, h, light) = (image.width, image.height, image.mean());
    if w < 3 || h < 3 || light.is_nan() || light <= 0.0 {
        return 0.0;
    }
    let mut line = vec![0.0f32; w - 2];
    let mut sum = 0.0f64;
    for y in 0..h - 2 {
        let row = |k: usize| &image.data[(y + k) * w..(y + k + 1) * w];
        Measure::Paper
            .measure()
            .row([row(0), row(1), row(2)], &mut line);
        sum += f64::from(line.iter().sum::<f32>());
    }
    sum / ((w - 2) * (h - 2)) as f64 / light
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use scopeservo_scope::{Channels, Samples, Timestamp};

    /// A grey frame of 8 bits, pixel by pixel in order.
    pub(crate) fn frame_of(width: usize, height: usize, f: impl FnMut(usize) -> u8) -> Frame {
        Frame {
            width,
            height,
            channels: Channels::Gray,
            bit_depth: 8,
            samples: Samples::U8((0..width * height).map(f).collect()),
            sequence: 0,
            exposure_start: Timestamp::default(),
            exposure: std::time::Duration::from_millis(10),
        }
    }

    /// A small one, by column and row.
    pub(crate) fn frame(f: impl Fn(usize, usize) -> u8) -> Frame {
        frame_of(32, 24, |i| f(i % 32, i / 32))
    }

    #[test]
    fn a_slope_has_no_laplacian_and_an_edge_has() {
        assert_eq!(sharpness(&frame(|_, _| 77)), 0.0);
        assert!(sharpness(&frame(|x, y| (3 * x + 2 * y) as u8)) < 1e-6);
        // One step between two columns: |L| is its height on both sides of it, 2 of 30 inner columns; the mean is half of it.
        for high in [255, 100] {
            let edge = sharpness(&frame(|x, _| if x < 16 { 0 } else { high }));
            assert!((edge - 2.0 / 30.0 / 0.5).abs() < 1e-6, "{edge}");
        }
        assert_eq!(sharpness(&frame(|_, _| 0)), 0.0);
    }
}
