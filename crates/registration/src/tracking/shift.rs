//! The shift between two small images by phase correlation (Kuglin, Hines, 1975), over the waves that tell most.

use crate::fourier::{C32, Fourier};

/// Shifts up to this share of the sides are told.
const REACH: f32 = 0.3;
/// Waves shorter than this, pixels, are noise, and longer than that shading.
const WAVES: [f32; 2] = [4.0, 40.0];

/// What is kept of the reference, and room for a frame.
pub(super) struct Shifts {
    fourier: Fourier,
    window: Vec<f32>,
    /// The conjugate of its spectrum, of equal size for all waves that count and 0 for others.
    reference: Vec<C32>,
    plane: Vec<C32>,
    spectrum: Vec<C32>,
    scratch: Vec<C32>,
}

impl Shifts {
    pub(super) fn new(reference: &[f32], size: [usize; 2]) -> Self {
        let fourier = Fourier::new(size);
        let hann = |k: usize, n: usize| {
            0.5 - 0.5 * (std::f32::consts::TAU * (k as f32 + 0.5) / n as f32).cos()
        };
        let window = (0..fourier.len())
            .map(|i| hann(i % size[0], size[0]) * hann(i / size[0], size[1]))
            .collect();
        let mut shifts = Self {
            window,
            reference: fourier.plane(),
            plane: fourier.plane(),
            spectrum: fourier.plane(),
            scratch: fourier.scratch(),
            fourier,
        };
        shifts.transform(reference);
        for (i, (kept, c)) in (shifts.reference.iter_mut().zip(&shifts.spectrum)).enumerate() {
            let [u, v] = [i / size[1], i % size[1]];
            let wave = |k: usize, n: usize| k.min(n - k) as f32 / n as f32;
            let turns = f32::hypot(wave(u, size[0]), wave(v, size[1]));
            if (1.0 / WAVES[1]..1.0 / WAVES[0]).contains(&turns) {
                *kept = c.conj() / c.norm().max(1e-12);
            }
        }
        shifts
    }

    fn transform(&mut self, image: &[f32]) {
        let mean = image.iter().sum::<f32>() / image.len() as f32;
        for ((c, v), w) in self.plane.iter_mut().zip(image).zip(&self.window) {
            *c = C32::new((v - mean) * w, 0.0);
        }
        self.fourier
            .forward(&mut self.plane, &mut self.spectrum, &mut self.scratch);
    }

    /// Where a frame shows the reference's middle, from its own, whole pixels.
    pub(super) fn of(&mut self, frame: &[f32]) -> [f32; 2] {
        self.transform(frame);
        for (c, r) in self.spectrum.iter_mut().zip(&self.reference) {
            // Half-way to equal sizes: strong waves say more, and not by all that they are stronger.
            let size = c.norm().sqrt().max(1e-12);
            *c = *c * r / size;
        }
        self.fourier
            .inverse(&mut self.spectrum, &mut self.plane, &mut self.scratch);
        let [width, height] = self.fourier.size;
        let signed = |k: usize, n: usize| match 2 * k > n {
            true => k as f32 - n as f32,
            false => k as f32,
        };
        let mut best = (f32::NEG_INFINITY, [0.0; 2]);
        for (i, c) in self.plane.iter().enumerate() {
            if c.re <= best.0 {
                continue;
            }
            let at = [signed(i % width, width), signed(i / width, height)];
            let near = at[0].abs() <= REACH * width as f32 && at[1].abs() <= REACH * height as f32;
            if near {
                best = (c.re, at);
            }
        }
        best.1
    }
}
