//! Bad and borderline input, each kind by name: a typed error or an empty result, never a panic. In a build with debug assertions
//! also never a read outside a buffer.

mod common;

use std::time::{Duration, Instant};

use common::{Random, Scene};
use scopeservo_sift::{
    Features, GrayImage, Keypoint, MatchOptions, Options, Sift, SiftError, Simd, match_features,
};

fn first_octave(first_octave: i32) -> Options {
    Options {
        first_octave,
        ..Options::default()
    }
}

/// The features at every level and three first octaves, each checked.
fn everywhere(image: &GrayImage) -> Vec<Features> {
    let mut all = Vec::new();
    for simd in Simd::available() {
        for octave in [-1, 0, 2] {
            let mut sift = Sift::with(first_octave(octave), simd).unwrap();
            let features = sift.detect_and_describe(image);
            features.check().unwrap();
            assert_eq!(sift.detect(image), features.keypoints);
            let _ = match_features(&features, &features, &MatchOptions::default());
            all.push(features);
        }
    }
    all
}

#[test]
fn a_size_of_zero_is_an_error() {
    for (width, height) in [(0, 0), (0, 7), (7, 0), (0, usize::MAX), (usize::MAX, 0)] {
        let empty = Err(SiftError::EmptyImage { width, height });
        assert_eq!(GrayImage::new(width, height, vec![]), empty);
        assert_eq!(GrayImage::from_fn(width, height, |_, _| 0.5), empty);
        assert_eq!(GrayImage::from_u8(width, height, 10, &[0; 100]), empty);
        assert_eq!(
            GrayImage::from_rows(width, height, 10, &[0.0; 100], |v| v),
            empty
        );
    }
}

#[test]
fn a_stride_below_the_width_is_an_error() {
    for stride in [0, 1, 9] {
        let wrong = Err(SiftError::Stride { width: 10, stride });
        assert_eq!(GrayImage::from_u8(10, 4, stride, &[0; 100]), wrong);
        assert_eq!(
            GrayImage::from_rows(10, 1, stride, &[0.0; 100], |v| v),
            wrong
        );
    }
}

#[test]
fn a_buffer_that_ends_too_early_is_an_error() {
    assert!(
        GrayImage::from_u8(10, 4, 12, &[0; 46]).is_ok(),
        "nothing need follow the last row"
    );
    for (width, height, stride, found) in [
        (10, 4, 12, 45),
        (10, 1, 10, 9),
        (10, 1, 10, 0),
        (1, usize::MAX, usize::MAX, 100),
        (usize::MAX, 2, usize::MAX, 100),
        (2, usize::MAX, 2, 100),
    ] {
        let error = GrayImage::from_u8(width, height, stride, &vec![0; found]).unwrap_err();
        assert_eq!(
            error,
            SiftError::DataTooShort {
                width,
                height,
                stride,
                found
            }
        );
        assert!(error.to_string().contains(&stride.to_string()));
    }
}

#[test]
fn a_wrong_length_without_stride_is_an_error() {
    for found in [0, 5, 7] {
        assert_eq!(
            GrayImage::new(3, 2, vec![0.0; found]),
            Err(SiftError::DataLength {
                width: 3,
                height: 2,
                found
            })
        );
    }
}

#[test]
fn a_size_beyond_all_memory_is_an_error() {
    for (width, height) in [
        (usize::MAX, 2),
        (usize::MAX, usize::MAX),
        (isize::MAX as usize, 1),
    ] {
        assert_eq!(
            GrayImage::from_fn(width, height, |_, _| 0.0),
            Err(SiftError::TooLarge { width, height })
        );
    }
}

#[test]
fn padding_is_not_read() {
    let mut r = Random(1);
    let bytes: Vec<u8> = (0..40 * 30).map(|_| (256.0 * r.unit()) as u8).collect();
    let tight = GrayImage::from_u8(40, 30, 40, &bytes).unwrap();
    for stride in [41, 48, 64, 97] {
        let mut padded = vec![f32::NAN; 29 * stride + 40];
        for (row, from) in padded.chunks_mut(stride).zip(bytes.chunks(40)) {
            for (v, b) in row.iter_mut().zip(from) {
                *v = f32::from(*b) / 255.0;
            }
        }
        assert_eq!(
            GrayImage::from_rows(40, 30, stride, &padded, |v| v).unwrap(),
            tight
        );
    }
    assert_eq!(tight.get(7, 9), f32::from(bytes[9 * 40 + 7]) / 255.0);
    assert_eq!(
        GrayImage::from_u8(2, 1, 2, &[0, 255]).unwrap().data(),
        [0.0, 1.0]
    );
}

#[test]
fn a_value_that_is_not_finite_is_an_error_with_its_place() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut data = vec![0.5; 6 * 4];
        data[2 * 6 + 5] = bad;
        for result in [
            GrayImage::new(6, 4, data.clone()),
            GrayImage::from_fn(6, 4, |x, y| data[y * 6 + x]),
            GrayImage::from_rows(6, 4, 6, &data, |v| v),
        ] {
            match result {
                Err(SiftError::NotFinite { x: 5, y: 2, value }) => {
                    assert_eq!(value.to_bits(), bad.to_bits());
                }
                other => panic!("{other:?}"),
            }
        }
    }
}

#[test]
fn a_keypoint_that_cannot_be_is_an_error() {
    let image = long(64, 48);
    for simd in Simd::available() {
        let mut sift = Sift::with(Options::default(), simd).unwrap();
        let found = sift.detect_and_describe(&image);
        let good = found.keypoints[0];
        // The same from all keypoints at once, from them in reverse, one by one, and from none.
        let described = |sift: &mut Sift, k: &[Keypoint]| sift.describe(&image, k).unwrap();
        assert_eq!(described(&mut sift, &found.keypoints), found.descriptors);
        let reversed: Vec<Keypoint> = found.keypoints.iter().rev().copied().collect();
        let back: Vec<_> = described(&mut sift, &reversed).into_iter().rev().collect();
        assert_eq!(back, found.descriptors);
        assert_eq!(described(&mut sift, &[good]), found.descriptors[..1]);
        assert_eq!(described(&mut sift, &[]), []);
        let change = |f: fn(&mut Keypoint)| {
            let mut k = good;
            f(&mut k);
            k
        };
        for bad in [
            change(|k| k.x = 64.0),
            change(|k| k.y = -0.6),
            change(|k| k.x = f32::NAN),
            change(|k| k.sigma *= 4.0),
            change(|k| k.sigma = -k.sigma),
            change(|k| k.sigma = f32::INFINITY),
            change(|k| k.angle = f32::NAN),
            change(|k| k.octave = 7),
            change(|k| k.octave = i32::MAX),
            change(|k| k.octave = i32::MIN),
            change(|k| k.layer = 3),
            change(|k| k.layer = u32::MAX),
            change(|k| (k.octave, k.layer, k.sigma) = (-1, 0, 0.8)),
        ] {
            let error = sift.describe(&image, &[good, bad, bad]).unwrap_err();
            assert_eq!(error, SiftError::ForeignKeypoint { index: 1 }, "{bad:?}");
            assert!(error.to_string().contains("keypoint 1"));
        }
        // An image in which nothing is searched has no place for any.
        let small = GrayImage::from_fn(3, 3, |x, y| (x * y) as f32).unwrap();
        let error = sift.describe(&small, &[good]).unwrap_err();
        assert_eq!(error, SiftError::ForeignKeypoint { index: 0 });
        assert_eq!(sift.describe(&small, &[]), Ok(vec![]));
    }
}

#[test]
fn a_keypoint_budget_of_zero_is_an_error() {
    let options = Options {
        max_features: 0,
        ..Options::default()
    };
    for simd in Simd::available() {
        assert!(matches!(
            Sift::with(options.clone(), simd),
            Err(SiftError::Option {
                name: "max_features",
                ..
            })
        ));
    }
}

#[test]
fn a_keypoint_budget_of_one_gives_one_place() {
    let image = long(64, 48);
    for simd in Simd::available() {
        let options = Options {
            max_features: 1,
            ..Options::default()
        };
        let keypoints = Sift::with(options, simd).unwrap().detect(&image);
        let place = |i: usize| (keypoints[i].x, keypoints[i].y, keypoints[i].sigma);
        assert!(!keypoints.is_empty());
        assert!((0..keypoints.len()).all(|i| place(i) == place(0)));
    }
}

#[test]
fn a_constant_image_gives_nothing() {
    for (width, height) in [(1, 1), (12, 12), (33, 17), (160, 120), (700, 20)] {
        for value in [
            0.0,
            -0.0,
            0.3,
            1.0,
            -7.0,
            1e-40,
            1e9,
            GrayImage::GREATEST,
            -1e12,
        ] {
            let image = GrayImage::from_fn(width, height, |_, _| value).unwrap();
            assert!(
                everywhere(&image).iter().all(Features::is_empty),
                "{width} x {height} of {value}"
            );
        }
    }
}

#[test]
fn an_image_smaller_than_the_first_octave_gives_nothing() {
    let mut r = Random(2);
    for short in 1..=6 {
        for long in [1, 3, 6, 12, 13, 100, 1000] {
            for (width, height) in [(short, long), (long, short)] {
                let image = GrayImage::from_fn(width, height, |_, _| r.unit() as f32).unwrap();
                assert!(
                    everywhere(&image).iter().all(Features::is_empty),
                    "{width} x {height}"
                );
            }
        }
    }
    // 95 columns are 12 three octaves on, 88 are 11.
    for (size, octave) in [(11, 0), (22, 1), (88, 3), (1000, 8)] {
        let image = GrayImage::from_fn(size, size, |_, _| r.unit() as f32).unwrap();
        for simd in Simd::available() {
            let mut sift = Sift::with(first_octave(octave), simd).unwrap();
            assert!(sift.detect(&image).is_empty());
        }
    }
}

#[test]
fn sizes_about_the_least_one_are_searched_to_the_last_pixel() {
    let mut r = Random(3);
    for width in 6..=14 {
        for height in 6..=14 {
            let image = GrayImage::from_fn(width, height, |_, _| r.unit() as f32).unwrap();
            everywhere(&image);
        }
    }
}

/// A little noise, and a spot at either end.
fn long(width: usize, height: usize) -> GrayImage {
    let mut r = Random(4);
    let end = (width.max(height) - 8) as f32;
    GrayImage::from_fn(width, height, |x, y| {
        let along = if width > height { x } else { y } as f32;
        let across = if width > height { y } else { x } as f32;
        let spot = |at: f32| (-((along - at).powi(2) + (across - 8.0).powi(2)) / 8.0).exp();
        0.02 * r.unit() as f32 + spot(8.0) + spot(end)
    })
    .unwrap()
}

#[test]
fn a_line_of_65535_pixels_gives_nothing() {
    for (width, height) in [(65535, 1), (1, 65535)] {
        let image = GrayImage::from_fn(width, height, |x, y| ((x + y) % 7) as f32 / 7.0).unwrap();
        assert!(everywhere(&image).iter().all(Features::is_empty));
    }
}

#[test]
fn a_strip_of_65535_pixels_takes_about_as_long_as_a_square_of_as_many() {
    let square = long(1024, 1024);
    for (width, height) in [(65535, 16), (16, 65535)] {
        let image = long(width, height);
        for simd in Simd::available() {
            let options = Options {
                max_features: 20,
                ..Options::default()
            };
            let timed = |image: &GrayImage| {
                let begin = Instant::now();
                let mut sift = Sift::with(options.clone(), simd).unwrap();
                (sift.detect_and_describe(image), begin.elapsed())
            };
            let (features, took) = timed(&image);
            let (_, took_by_square) = timed(&square);
            features.check().unwrap();
            for at in [8.0, 65535.0 - 8.0] {
                let place = if width > height { (at, 8.0) } else { (8.0, at) };
                assert!(
                    (features.keypoints.iter()).any(|k| (k.x - place.0).hypot(k.y - place.1) < 0.1),
                    "{width} x {height}, {}: nothing at {at}",
                    simd.level()
                );
            }
            // The margin is for what tiles of a strip overlap, for the one thread of 16 rows, and for busy machines.
            assert!(
                took < 20 * took_by_square + Duration::from_secs(5),
                "{took:?}, {took_by_square:?}"
            );
        }
    }
}

#[test]
fn a_huge_value_is_an_error_with_its_place() {
    for value in [1.001e12, -1e13, 1e30, f32::MAX, f32::MIN] {
        let image = GrayImage::from_fn(6, 4, |x, y| if (x, y) == (5, 2) { value } else { 0.5 });
        assert_eq!(image, Err(SiftError::TooGreat { x: 5, y: 2, value }));
    }
}

#[test]
fn the_greatest_values_give_checked_features() {
    let mut r = Random(5);
    let greatest = GrayImage::GREATEST;
    let noise = GrayImage::from_fn(90, 70, |_, _| greatest * r.unit() as f32).unwrap();
    everywhere(&noise);
    let checks = |x: usize, y: usize| {
        if (x / 5 + y / 7).is_multiple_of(2) {
            greatest
        } else {
            -greatest
        }
    };
    assert!(!everywhere(&GrayImage::from_fn(90, 70, checks).unwrap())[0].is_empty());
    let spike = |x, y| if (x, y) == (40, 30) { greatest } else { 0.5 };
    everywhere(&GrayImage::from_fn(90, 70, spike).unwrap());
}

/// Powers of two round nothing: as long as nothing overflows either, every bit but the exponents stays.
#[test]
fn spots_of_every_magnitude_give_the_same_features() {
    let scene = Scene::random(7, 60, 90.0, 1.0..6.0).render(90, 70, |x, y| (x, y));
    let expected = everywhere(&scene);
    assert!(expected[0].len() > 20);
    for exponent in [-30, -12, 4, 20, 39] {
        let scale = 2.0_f32.powi(exponent);
        let scaled = GrayImage::from_fn(90, 70, |x, y| scale * scene.get(x, y)).unwrap();
        for (mut found, expected) in everywhere(&scaled).into_iter().zip(&expected) {
            for k in &mut found.keypoints {
                k.response /= scale;
            }
            assert_eq!(found, *expected, "2^{exponent}");
        }
    }
}

#[test]
fn subnormal_values_give_checked_features() {
    let mut r = Random(8);
    for scale in [f32::MIN_POSITIVE, 1e-39, 1e-44, f32::from_bits(1)] {
        let noise = GrayImage::from_fn(90, 70, |_, _| scale * r.unit() as f32).unwrap();
        everywhere(&noise);
    }
}
