//! The luminance of a frame, smoothed and halved again and again.

use scopeservo_scope::Frame;

/// The binomial kernel of five taps: a Gaussian of 1 pixel.
const KERNEL: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];

/// A grey image, row by row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Plane {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) data: Vec<f32>,
}

impl Plane {
    pub(crate) fn of(frame: &Frame) -> Self {
        Self {
            width: frame.width,
            height: frame.height,
            data: frame.luminance(),
        }
    }

    /// The mean of all values.
    pub(crate) fn mean(&self) -> f64 {
        let sum: f64 = self.data.iter().map(|&v| f64::from(v)).sum();
        sum / self.data.len().max(1) as f64
    }

    /// Smoothed twice by the kernel; at the border its own values go on.
    pub(crate) fn smoothed(&self) -> Self {
        self.pass().pass()
    }

    fn pass(&self) -> Self {
        let (w, h) = (self.width, self.height);
        let mut along = vec![0.0f32; w * h];
        for (out, row) in along.chunks_exact_mut(w).zip(self.data.chunks_exact(w)) {
            let at = |x: isize| row[x.clamp(0, w as isize - 1) as usize];
            let weighted = |x: isize| (0..5).map(|k| KERNEL[k as usize] * at(x + k - 2)).sum();
            for x in (0..2.min(w)).chain(w.saturating_sub(2)..w) {
                out[x] = weighted(x as isize);
            }
            if w > 4 {
                for (x, v) in row.windows(5).enumerate() {
                    out[x + 2] =
                        KERNEL[0] * (v[0] + v[4]) + KERNEL[1] * (v[1] + v[3]) + KERNEL[2] * v[2];
                }
            }
        }
        let mut data = vec![0.0f32; w * h];
        for (y, out) in data.chunks_exact_mut(w).enumerate() {
            let row = |dy: isize| {
                let y = (y as isize + dy).clamp(0, h as isize - 1) as usize;
                &along[y * w..(y + 1) * w]
            };
            let rows = [row(-2), row(-1), row(0), row(1), row(2)];
            for (x, v) in out.iter_mut().enumerate() {
                *v = KERNEL[0] * (rows[0][x] + rows[4][x])
                    + KERNEL[1] * (rows[1][x] + rows[3][x])
                    + KERNEL[2] * rows[2][x];
            }
        }
        Self {
            width: w,
            height: h,
            data,
        }
    }

    /// Every second pixel of every second row.
    fn halved(&self) -> Self {
        let rows = self.data.chunks_exact(self.width).step_by(2);
        Self {
            width: self.width.div_ceil(2),
            height: self.height.div_ceil(2),
            data: rows
                .flat_map(|row| row.iter().step_by(2).copied())
                .collect(),
        }
    }
}

/// The image smoothed, then halved and smoothed again, `count` levels in all. A Gaussian of about `1.5 * 2^level` pixels of the image
/// stands for each.
pub(crate) fn levels(image: &Plane, count: usize) -> Vec<Plane> {
    let mut all: Vec<Plane> = Vec::with_capacity(count);
    for _ in 0..count {
        let next = match all.last() {
            None => image.smoothed(),
            Some(finer) => finer.halved().smoothed(),
        };
        all.push(next);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smoothing_keeps_what_is_even_and_spreads_a_point_as_the_binomial_does() {
        let even = Plane {
            width: 7,
            height: 5,
            data: vec![0.25; 35],
        };
        let all = levels(&even, 3);
        assert!(
            all.iter()
                .flat_map(|p| &p.data)
                .all(|v| (v - 0.25).abs() < 1e-6)
        );
        assert_eq!((all[2].width, all[2].height), (2, 2));
        let mut point = vec![0.0; 21 * 21];
        point[10 * 21 + 10] = 1.0;
        let point = Plane {
            width: 21,
            height: 21,
            data: point,
        };
        let seen = point.smoothed();
        // (1 4 6 4 1) with itself has 70 of 256 in its middle.
        assert!((f64::from(seen.data[10 * 21 + 10]) - (70.0f64 / 256.0).powi(2)).abs() < 1e-7);
        let x: f64 = seen
            .data
            .iter()
            .enumerate()
            .map(|(i, v)| f64::from(*v) * ((i % 21) as f64 - 10.0).powi(2))
            .sum();
        assert!((x - 2.0).abs() < 1e-5, "two Gaussians of 1 px: {x}");
    }
}
