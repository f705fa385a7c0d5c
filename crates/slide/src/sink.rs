//! Where the rows of a picture go: each is placed, upright, in what was asked for, and reduced on the way.

use crate::layout::{Row, Values};
use crate::orientation::Orientation;
use crate::raster::{luma, to_8};
use crate::{Gray, Rgb8};

/// Takes the rows of a picture, in any order, each pixel once.
pub(crate) trait Sink {
    /// Pixels of stored row `y`, from column `x` on, every `step`-th.
    fn row(&mut self, x: u32, y: u32, step: u32, row: &Row);
    /// `n` pixels of stored row `y` from column `x` on of which the file says nothing; they look like `level`, 0 to 1.
    fn blank(&mut self, x: u32, y: u32, n: u32, level: f32);
}

/// The place of a picture: how it is stored and how it is shown.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// Columns and rows as they are stored.
    pub(crate) stored: [u32; 2],
    pub(crate) orientation: Orientation,
}

impl Place {
    /// Columns and rows as they are shown.
    pub(crate) fn shown(&self) -> [u32; 2] {
        self.orientation.size(self.stored)
    }

    /// Where the pixels of a row are shown, one by one.
    fn pixels(&self, x: u32, y: u32, step: u32) -> impl Iterator<Item = [usize; 2]> + use<> {
        let ([mut x, mut y], [dx, dy]) = self.orientation.place(self.stored, x, y);
        let (dx, dy) = (dx * i64::from(step), dy * i64::from(step));
        std::iter::from_fn(move || {
            let at = [x as usize, y as usize];
            (x, y) = (x + dx, y + dy);
            Some(at)
        })
    }

    fn is_plain(&self, step: u32) -> bool {
        step == 1 && self.orientation.is_upright()
    }
}

/// Colour of 8 bits, full size.
pub(crate) struct RgbSink {
    pub(crate) place: Place,
    pub(crate) out: Rgb8,
}

impl RgbSink {
    pub(crate) fn new(place: Place, outside: [u8; 3]) -> Self {
        let [w, h] = place.shown();
        Self {
            place,
            out: Rgb8::filled(w, h, outside),
        }
    }
}

impl Sink for RgbSink {
    fn row(&mut self, x: u32, y: u32, step: u32, row: &Row) {
        let width = self.out.width as usize;
        let data = &mut self.out.data;
        if let (true, 3, Values::U8(v)) = (self.place.is_plain(step), row.channels, &row.values) {
            let at = 3 * (y as usize * width + x as usize);
            data[at..at + v.len()].copy_from_slice(v);
            return;
        }
        let places = self.place.pixels(x, y, step);
        each_rgb8(row, places, |[x, y], rgb| {
            data[3 * (y * width + x)..][..3].copy_from_slice(&rgb);
        });
    }

    fn blank(&mut self, _x: u32, _y: u32, _n: u32, _level: f32) {}
}

fn each_rgb8(
    row: &Row,
    places: impl Iterator<Item = [usize; 2]>,
    mut put: impl FnMut([usize; 2], [u8; 3]),
) {
    match (&row.values, row.channels) {
        (Values::U8(v), 1) => v.iter().zip(places).for_each(|(v, at)| put(at, [*v; 3])),
        (Values::U16(v), 1) => v
            .iter()
            .zip(places)
            .for_each(|(v, at)| put(at, [to_8(*v); 3])),
        (Values::U8(v), _) => {
            let pixels = v.as_chunks::<3>().0.iter();
            pixels.zip(places).for_each(|(c, at)| put(at, *c));
        }
        (Values::U16(v), _) => {
            let pixels = v.as_chunks::<3>().0.iter();
            pixels.zip(places).for_each(|(c, at)| put(at, c.map(to_8)));
        }
    }
}

/// Grey, as means of blocks of `factor` x `factor` pixels; what does not fill a block at the right and lower border is left out.
pub(crate) struct GraySink {
    place: Place,
    factor: usize,
    out: Gray,
    /// The grey values of a row.
    levels: Vec<f32>,
}

impl GraySink {
    /// Bytes that the result takes.
    pub(crate) fn bytes(place: Place, factor: usize) -> u64 {
        let [w, h] = place.shown().map(|n| u64::from(n) / factor as u64);
        4 * w * h
    }

    pub(crate) fn new(place: Place, factor: usize) -> Self {
        let [width, height] = place.shown().map(|n| n as usize / factor);
        Self {
            place,
            factor,
            out: Gray {
                width,
                height,
                data: vec![0.0; width * height],
            },
            levels: Vec::new(),
        }
    }

    pub(crate) fn finish(mut self) -> Gray {
        if self.factor > 1 {
            let share = 1.0 / (self.factor * self.factor) as f32;
            self.out.data.iter_mut().for_each(|v| *v *= share);
        }
        self.out
    }

    /// Adds `self.levels`.
    fn add(&mut self, x: u32, y: u32, step: u32) {
        let (f, width, height) = (self.factor, self.out.width, self.out.height);
        let data = &mut self.out.data;
        if self.place.is_plain(step) && (x as usize).is_multiple_of(f) {
            let row = y as usize / f;
            if row >= height {
                return;
            }
            let sums = &mut data[row * width..][..width][(x as usize / f).min(width)..];
            for (sum, block) in sums.iter_mut().zip(self.levels.chunks(f)) {
                *sum += block.iter().sum::<f32>();
            }
            return;
        }
        for (level, [x, y]) in self.levels.iter().zip(self.place.pixels(x, y, step)) {
            let (x, y) = (x / f, y / f);
            if x < width && y < height {
                data[y * width + x] += level;
            }
        }
    }
}

impl Sink for GraySink {
    fn row(&mut self, x: u32, y: u32, step: u32, row: &Row) {
        let levels = &mut self.levels;
        levels.clear();
        match (&row.values, row.channels) {
            (Values::U8(v), 1) => levels.extend(v.iter().map(|v| f32::from(*v) / 255.0)),
            (Values::U16(v), 1) => levels.extend(v.iter().map(|v| f32::from(*v) / 65535.0)),
            (Values::U8(v), _) => levels.extend(v.as_chunks::<3>().0.iter().map(|c| {
                let [r, g, b] = c.map(f32::from);
                luma(r, g, b, 255.0)
            })),
            (Values::U16(v), _) => levels.extend(v.as_chunks::<3>().0.iter().map(|c| {
                let [r, g, b] = c.map(f32::from);
                luma(r, g, b, 65535.0)
            })),
        }
        self.add(x, y, step);
    }

    fn blank(&mut self, x: u32, y: u32, n: u32, level: f32) {
        self.levels.clear();
        self.levels.resize(n as usize, level);
        self.add(x, y, 1);
    }
}

/// All that the picture has: its channels and its depth.
pub(crate) struct DeepSink {
    place: Place,
    channels: usize,
    pub(crate) values: Values,
}

impl DeepSink {
    pub(crate) fn new(place: Place, channels: usize, depth: u8) -> Self {
        let [w, h] = place.shown().map(|n| n as usize);
        let n = w * h * channels;
        Self {
            place,
            channels,
            values: match depth {
                8 => Values::U8(vec![0; n]),
                _ => Values::U16(vec![0; n]),
            },
        }
    }
}

impl Sink for DeepSink {
    fn row(&mut self, x: u32, y: u32, step: u32, row: &Row) {
        let (place, channels) = (&self.place, self.channels);
        match (&mut self.values, &row.values) {
            (Values::U8(to), Values::U8(from)) => put(to, from, channels, place, [x, y, step]),
            (Values::U16(to), Values::U16(from)) => put(to, from, channels, place, [x, y, step]),
            // A picture has one depth.
            _ => {}
        }
    }

    fn blank(&mut self, x: u32, y: u32, n: u32, level: f32) {
        let n = n as usize * self.channels;
        let values = match self.values {
            Values::U8(_) => Values::U8(vec![(level * 255.0) as u8; n]),
            Values::U16(_) => Values::U16(vec![(level * 65535.0) as u16; n]),
        };
        let channels = self.channels;
        self.row(x, y, 1, &Row { channels, values });
    }
}

fn put<T: Copy>(to: &mut [T], from: &[T], channels: usize, place: &Place, [x, y, step]: [u32; 3]) {
    let width = place.shown()[0] as usize;
    if place.is_plain(step) {
        let at = channels * (y as usize * width + x as usize);
        to[at..at + from.len()].copy_from_slice(from);
        return;
    }
    for (pixel, [x, y]) in from.chunks_exact(channels).zip(place.pixels(x, y, step)) {
        to[channels * (y * width + x)..][..channels].copy_from_slice(pixel);
    }
}
