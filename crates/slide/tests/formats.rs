//! What each format gives back: pixels, grey precision, levels, pixel size.

mod common;

use common::{PageSpec, picture, rgb_at, save, write_tiff};
use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, LumaA, Rgb, Rgba};
use scopeservo_slide::Slide;

const OUTSIDE: [u8; 3] = [9, 8, 7];

#[test]
fn png_of_every_kind_and_the_extension_does_not_matter() {
    let dir = tempfile::tempdir().unwrap();
    let one = |image: DynamicImage| {
        let path = save(dir.path(), "picture.jpg", &image, ImageFormat::Png);
        let slide = Slide::open(&path).unwrap();
        let rgb = slide.read_rgb8(0, 0, 0, 1, 1, OUTSIDE).unwrap().data;
        (rgb, slide.read_gray(0).unwrap().data[0])
    };
    let luma = |r: f32, g: f32, b: f32| 0.299 * r + 0.587 * g + 0.114 * b;
    let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-6, "{a} {b}");

    let (rgb, gray) = one(ImageBuffer::from_pixel(3, 2, Luma([51_u8])).into());
    assert_eq!(rgb, [51; 3]);
    near(gray, 0.2);
    let (rgb, gray) = one(ImageBuffer::from_pixel(3, 2, LumaA([0_u8, 51])).into());
    assert_eq!(rgb, [204; 3]);
    near(gray, 0.8);
    let (rgb, gray) = one(ImageBuffer::from_pixel(3, 2, Rgba([255_u8, 0, 0, 51])).into());
    assert_eq!(rgb, [255, 204, 204]);
    near(gray, luma(1.0, 0.8, 0.8));
    let (rgb, gray) = one(ImageBuffer::from_pixel(3, 2, Luma([13108_u16])).into());
    assert_eq!(rgb, [51; 3]);
    near(gray, 13108.0 / 65535.0);
    let (_, gray) = one(ImageBuffer::from_pixel(3, 2, LumaA([1000_u16, 65535])).into());
    near(gray, 1000.0 / 65535.0);
    let (rgb, gray) = one(ImageBuffer::from_pixel(3, 2, Rgb([65535_u16, 256, 0])).into());
    assert_eq!(rgb, [255, 1, 0]);
    near(gray, luma(1.0, 256.0 / 65535.0, 0.0));
    let (rgb, _) = one(ImageBuffer::from_pixel(3, 2, Rgba([0_u16, 0, 0, 0])).into());
    assert_eq!(rgb, [255; 3]);
}

#[test]
fn regions_outside_are_filled() {
    let dir = tempfile::tempdir().unwrap();
    let path = save(
        dir.path(),
        "a.png",
        &picture(20, 10).into(),
        ImageFormat::Png,
    );
    let slide = Slide::open(&path).unwrap();
    assert_eq!(slide.um_per_px(), None);
    check_region(&slide, (20, 10), -3, -2, 30, 20);
    check_region(&slide, (20, 10), 5, 4, 3, 2);
    check_region(&slide, (20, 10), i64::MIN, i64::MAX, 3, 2);
    assert!(
        slide
            .read_rgb8(0, 0, 0, 0, 5, OUTSIDE)
            .unwrap()
            .data
            .is_empty()
    );
}

#[test]
fn one_pixel_opens() {
    let dir = tempfile::tempdir().unwrap();
    let path = save(dir.path(), "a.png", &picture(1, 1).into(), ImageFormat::Png);
    let slide = Slide::open(&path).unwrap();
    assert_eq!((slide.levels()[0].width, slide.levels()[0].height), (1, 1));
}

#[test]
fn jpeg_is_close() {
    let dir = tempfile::tempdir().unwrap();
    let smooth = image::RgbImage::from_fn(64, 48, |x, y| Rgb([100 + x as u8, 90 + y as u8, 120]));
    let path = save(
        dir.path(),
        "a.png",
        &smooth.clone().into(),
        ImageFormat::Jpeg,
    );
    let got = Slide::open(&path)
        .unwrap()
        .read_rgb8(0, 0, 0, 64, 48, OUTSIDE)
        .unwrap();
    let diff: i32 = got
        .data
        .iter()
        .zip(smooth.as_raw())
        .map(|(&a, &b)| i32::from(a.abs_diff(b)))
        .sum();
    assert!(diff / (3 * 64 * 48) < 4, "{diff}");
}

#[test]
fn stripped_tiff_in_8_and_16_bits() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("strips.tif");
    let encode = |path: &std::path::Path| {
        tiff::encoder::TiffEncoder::new(std::fs::File::create(path).unwrap()).unwrap()
    };

    let gray: Vec<u16> = (0..40 * 30).map(|i| i * 50).collect();
    encode(&path)
        .write_image::<tiff::encoder::colortype::Gray16>(40, 30, &gray)
        .unwrap();
    let slide = Slide::open(&path).unwrap();
    let read = slide.read_gray(0).unwrap();
    assert_eq!((read.width, read.height), (40, 30));
    for (got, &want) in read.data.iter().zip(&gray) {
        assert!((got - f32::from(want) / 65535.0).abs() < 1e-7);
    }
    assert_eq!(
        slide.read_rgb8(0, 39, 29, 1, 1, OUTSIDE).unwrap().data,
        [(59950_u32 / 257) as u8; 3]
    );

    let mut raw = picture(37, 23).into_raw();
    encode(&path)
        .write_image::<tiff::encoder::colortype::RGB8>(37, 23, &raw)
        .unwrap();
    check_region(&Slide::open(&path).unwrap(), (37, 23), -5, 3, 50, 40);

    raw.truncate(4 * 100);
    encode(&path)
        .write_image::<tiff::encoder::colortype::RGBA8>(10, 10, &raw)
        .unwrap();
    assert_eq!(
        Slide::open(&path)
            .unwrap()
            .read_rgb8(0, 0, 0, 10, 10, OUTSIDE)
            .unwrap()
            .data
            .len(),
        300
    );
}

#[test]
fn a_tiled_pyramid_is_read_by_regions_at_every_level() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("pyramid.dat");
    let pages = [
        PageSpec::new(100, 70, 16, rgb_at),
        PageSpec::new(30, 20, 0, |_, _| [1; 3]),
        PageSpec::new(25, 17, 16, |x, y| rgb_at(4 * x, 4 * y)),
        PageSpec::new(50, 35, 16, |x, y| rgb_at(2 * x, 2 * y)),
        PageSpec::new(60, 20, 16, |_, _| [2; 3]),
    ];
    write_tiff(&path, &pages);
    let slide = Slide::open(&path).unwrap();
    let sizes: Vec<_> = slide.levels().iter().map(|l| (l.width, l.height)).collect();
    assert_eq!(
        sizes,
        [(100, 70), (50, 35), (25, 17)],
        "thumbnail and stranger left out, finest first"
    );
    assert_eq!(slide.levels()[1].downsample, 2.0);
    assert!((slide.levels()[2].downsample - 4.06).abs() < 0.01);
    check_region(&slide, (100, 70), -4, -9, 120, 90);
    check_region(&slide, (100, 70), 15, 15, 18, 2);
    let got = slide.read_rgb8(2, 20, 10, 1, 1, OUTSIDE).unwrap();
    assert_eq!(got.data, rgb_at(80, 40));
    let gray = slide.read_gray(1).unwrap();
    let [r, g, b] = rgb_at(2 * 49, 2 * 34).map(f32::from);
    assert!((gray.data[35 * 50 - 1] - (0.299 * r + 0.587 * g + 0.114 * b) / 255.0).abs() < 1e-6);
}

#[test]
fn pixel_size_only_where_it_can_be_a_microscope() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.tif");
    let stated = |description, resolution| {
        let mut page = PageSpec::new(20, 20, 16, rgb_at);
        (page.description, page.resolution) = (description, resolution);
        write_tiff(&path, &[page]);
        Slide::open(&path).unwrap().um_per_px()
    };
    assert_eq!(
        stated("Aperio x|AppMag = 20|MPP = 0.4990", None),
        Some(0.499)
    );
    assert_eq!(stated("", Some((20_000, 3))), Some(0.5));
    assert_eq!(stated("", Some((25_400, 2))), Some(1.0));
    assert_eq!(stated("", Some((300, 2))), None, "a print resolution");
    assert_eq!(stated("", Some((20_000, 1))), None, "no unit");
    assert_eq!(stated("", None), None);
}

/// Every pixel of a region against the image it was cut from.
fn check_region(slide: &Slide, (width, height): (i64, i64), x: i64, y: i64, w: u32, h: u32) {
    let got = slide.read_rgb8(0, x, y, w, h, OUTSIDE).unwrap();
    for j in 0..h {
        for i in 0..w {
            let (sx, sy) = (x.saturating_add(i.into()), y.saturating_add(j.into()));
            let inside = (0..width).contains(&sx) && (0..height).contains(&sy);
            let want = if inside {
                rgb_at(sx as u32, sy as u32)
            } else {
                OUTSIDE
            };
            let at = 3 * (j * w + i) as usize;
            assert_eq!(got.data[at..at + 3], want, "column {i}, row {j}");
        }
    }
}
