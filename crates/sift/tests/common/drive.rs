//! What the fuzzer and `tests/fuzz_corpus.rs` run: any bytes become images, options, features and gates, good and bad ones.
//!
//! Whatever they are, each call ends in a typed error or a result that passes its check, the same on a used engine as on a new
//! one; matching gives the same at every level.

use scopeservo_sift::{
    Descriptor, Features, Gate, GrayImage, Keypoint, MatchOptions, Options, Sift, Simd,
    match_features_at,
};

/// Bytes to draw from; after the last come those of a simple generator that depends on all before.
struct Bytes<'a> {
    data: &'a [u8],
    state: u32,
}

impl Bytes<'_> {
    fn byte(&mut self) -> u8 {
        self.state = self
            .state
            .wrapping_mul(1_664_525)
            .wrapping_add(1_013_904_223);
        let value = match self.data.split_first() {
            Some((first, rest)) => {
                self.data = rest;
                *first
            }
            None => (self.state >> 24) as u8,
        };
        self.state ^= u32::from(value);
        value
    }

    /// In `0..n`, n at most 65536.
    fn below(&mut self, n: usize) -> usize {
        usize::from(u16::from_le_bytes([self.byte(), self.byte()])) % n
    }

    /// One time in n.
    fn rarely(&mut self, n: usize) -> bool {
        self.below(n) == n - 1
    }

    /// Any bit pattern.
    fn wild(&mut self) -> f32 {
        f32::from_le_bytes([self.byte(), self.byte(), self.byte(), self.byte()])
    }

    /// Mostly between `low` and `high`, now and then anything.
    fn f32(&mut self, low: f32, high: f32) -> f32 {
        if self.rarely(40) {
            return self.wild();
        }
        low + (high - low) * self.below(1 << 16) as f32 / 65536.0
    }
}

/// Runs everything on what `data` stands for.
///
/// # Panics
/// When a promise of the crate is broken.
pub(crate) fn drive(data: &[u8]) {
    let mut bytes = Bytes { data, state: 1 };
    let options = options(&mut bytes);
    let images = [image(&mut bytes), image(&mut bytes)];
    let fits = options.check().is_ok();
    let any = keypoints(&mut bytes);
    let mut found = Vec::new();
    for simd in Simd::available() {
        let Ok(mut used) = Sift::with(options.clone(), simd) else {
            assert!(!fits);
            continue;
        };
        for image in images.iter().flatten() {
            let keypoints = used.detect(image);
            let features = used.detect_and_describe(image);
            features.check().unwrap();
            assert_eq!(features.keypoints, keypoints);
            assert_eq!(
                used.describe(image, &keypoints).as_deref(),
                Ok(&features.descriptors[..])
            );
            if let Ok(all) = used.describe(image, &any) {
                assert_eq!(all.len(), any.len());
            }
            let new = Sift::with(options.clone(), simd)
                .unwrap()
                .detect_and_describe(image);
            assert_eq!(features, new);
            for d in &features.descriptors {
                assert_eq!(Descriptor::new(*d.components()), Ok(*d));
            }
            found.push(features);
        }
    }
    let made = [features(&mut bytes), features(&mut bytes)];
    matches(&mut bytes, &made[0], &made[1]);
    if let [a, .., b] = &found[..] {
        matches(&mut bytes, a, b);
    }
}

fn options(bytes: &mut Bytes<'_>) -> Options {
    let mut options = Options {
        first_octave: bytes.below(4) as i32 - 1,
        adapt_contrast: !bytes.rarely(3),
        ..Options::default()
    };
    if bytes.rarely(2) {
        options.max_features = [1, 2, 17, 300, usize::MAX][bytes.below(5)];
        options.intervals = [2, 3, 4, 7, 16][bytes.below(5)];
        options.sigma = bytes.f32(0.5, 4.0);
        options.assumed_blur = bytes.f32(0.0, 0.5);
        options.edge_ratio = bytes.f32(1.1, 30.0);
        options.contrast_threshold = bytes.f32(0.0, 0.1);
    }
    if bytes.rarely(30) {
        options.sigma = 16.0;
        options.max_features = bytes.below(2);
        options.intervals = bytes.below(20);
        options.first_octave = bytes.below(14) as i32 - 3;
    }
    options
}

/// Mostly small; now and then a line, a strip wider than a tile, or nothing that can be an image.
fn image(bytes: &mut Bytes<'_>) -> Option<GrayImage> {
    let (mut width, mut height) = (bytes.below(48), bytes.below(48));
    if bytes.rarely(30) {
        width = bytes.below(1400);
        height = bytes.below(24);
    }
    if bytes.rarely(2) {
        std::mem::swap(&mut width, &mut height);
    }
    let stride = if bytes.rarely(20) {
        [0, width / 2, usize::MAX, usize::MAX / 2][bytes.below(4)]
    } else {
        width + bytes.below(40)
    };
    let whole = stride.saturating_mul(height).min(1 << 18);
    let len = whole.saturating_sub(if bytes.rarely(3) { bytes.below(80) } else { 0 });
    let kind = bytes.below(6);
    let scale = [1.0, 1e-3, 1e-40, 1e12, f32::MAX][bytes.below(5)];
    let (fx, fy) = (bytes.f32(0.0, 1.5), bytes.f32(0.0, 1.5));
    let result = match kind {
        // Bytes as they come.
        0 => {
            let data: Vec<u8> = (0..len).map(|_| bytes.byte()).collect();
            GrayImage::from_u8(width, height, stride, &data)
        }
        // Floats as they come: soon one is not finite.
        1 => {
            let data: Vec<f32> = (0..len).map(|_| bytes.wild()).collect();
            GrayImage::from_rows(width, height, stride, &data, |v| v)
        }
        // All good, from the least to the greatest.
        2 => {
            let data: Vec<f32> = (0..len).map(|_| bytes.wild()).collect();
            GrayImage::from_rows(width, height, stride, &data, |v| {
                if v.abs() < 1e12 { v } else { 0.0 }
            })
        }
        // Few values, so that neighbours are equal.
        3 => {
            let data: Vec<u8> = (0..len).map(|_| bytes.byte() & 1).collect();
            GrayImage::from_rows(width, height, stride, &data, |v| scale * f32::from(v))
        }
        // Waves with some noise.
        4 => GrayImage::from_fn(width, height, |x, y| {
            let wave = (fx * x as f32).sin() * (fy * y as f32).cos();
            scale * (0.5 + 0.4 * wave + 0.0004 * f32::from(bytes.byte()))
        }),
        // A length that may or may not fit.
        _ => {
            let len = if bytes.rarely(2) { width * height } else { len };
            let data = (0..len)
                .map(|_| scale * f32::from(bytes.byte()) / 255.0)
                .collect();
            GrayImage::new(width, height, data)
        }
    };
    result.ok()
}

/// Features that no image gave: any descriptor within its bounds, keypoints with anything in them.
/// A few places that may or may not be ones.
fn keypoints(bytes: &mut Bytes<'_>) -> Vec<Keypoint> {
    (0..bytes.below(4)).map(|_| keypoint(bytes)).collect()
}

fn keypoint(bytes: &mut Bytes<'_>) -> Keypoint {
    Keypoint {
        x: bytes.f32(0.0, 100.0),
        y: bytes.f32(0.0, 100.0),
        sigma: bytes.f32(0.5, 20.0),
        angle: bytes.f32(-7.0, 7.0),
        response: bytes.f32(0.0, 1.0),
        bright: bytes.rarely(2),
        octave: bytes.below(4) as i32 - 1,
        layer: bytes.below(4) as u32,
    }
}

fn features(bytes: &mut Bytes<'_>) -> Features {
    let many = bytes.rarely(16);
    let n = bytes.below(if many { 400 } else { 50 });
    let most = [1, 5, 22, 127, 255][bytes.below(5)];
    let descriptor = |bytes: &mut Bytes<'_>| {
        let fill = 1 + bytes.below(8);
        let components = std::array::from_fn(|k| match k % fill {
            0 => bytes.below(most + 1) as u8,
            _ => 0,
        });
        Descriptor::new(components).unwrap_or(Descriptor::ZERO)
    };
    let keypoint = |bytes: &mut Bytes<'_>| Keypoint {
        octave: 0,
        layer: 1,
        ..keypoint(bytes)
    };
    Features {
        width: 100,
        height: 100,
        keypoints: (0..n).map(|_| keypoint(bytes)).collect(),
        descriptors: (0..n).map(|_| descriptor(bytes)).collect(),
    }
}

/// Matches at every level.
fn matches(bytes: &mut Bytes<'_>, query: &Features, train: &Features) {
    let options = MatchOptions {
        ratio: bytes.f32(0.5, 1.2),
        mutual: bytes.rarely(2),
    };
    let mut pair = |low, high| Some((bytes.f32(low, high), bytes.f32(low, high)));
    let (sigma_ratio, turn_rad) = (pair(0.2, 3.0), pair(-4.0, 4.0));
    let gate = Gate {
        sigma_ratio: sigma_ratio.filter(|_| bytes.rarely(2)),
        turn_rad: turn_rad.filter(|_| bytes.rarely(2)),
        same_polarity: bytes.rarely(2),
    };
    let mut first = None;
    for simd in Simd::available() {
        let found = match_features_at(simd, query, train, &options, &gate);
        for m in &found {
            assert!(gate.admits(&query.keypoints[m.query], &train.keypoints[m.train]));
        }
        assert_eq!(
            first.get_or_insert_with(|| found.clone()),
            &found,
            "{}",
            simd.level()
        );
    }
}
