//! Files that are not slides: each a typed error that names the file, never a panic.

mod common;

use std::fs;
use std::path::Path;

use common::{PageSpec, picture, rgb_at, save, write_tiff};
use image::ImageFormat;
use scopeservo_slide::{Slide, SlideError};

/// Opens and reads all.
fn open_bytes(dir: &Path, bytes: &[u8]) -> Result<Slide, SlideError> {
    let path = dir.join("file.png");
    fs::write(&path, bytes).unwrap();
    let slide = Slide::open(&path)?;
    slide.read_gray_reduced(0, 1 << 20)?;
    Ok(slide)
}

#[test]
fn missing_empty_text_folder() {
    let dir = tempfile::tempdir().unwrap();
    let missing = Slide::open(&dir.path().join("no.png")).unwrap_err();
    assert!(matches!(missing, SlideError::NotFound { .. }));
    assert!(missing.to_string().contains("no.png"));
    for bytes in [&b""[..], b"x", b"# a text file\n", b"GIF89a......"] {
        let e = open_bytes(dir.path(), bytes).unwrap_err();
        assert!(matches!(e, SlideError::NotAnImage { .. }), "{e}");
        assert!(e.to_string().contains("file.png"));
    }
    assert!(matches!(
        Slide::open(dir.path()),
        Err(SlideError::NotAnImage { .. })
    ));
}

#[test]
fn a_file_cut_anywhere_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let noise = image::RgbImage::from_fn(90, 70, |x, y| {
        image::Rgb([(x * x * 31 + y * 97) as u8, (x * y) as u8, y as u8])
    });
    let png = fs::read(save(
        dir.path(),
        "a",
        &noise.clone().into(),
        ImageFormat::Png,
    ))
    .unwrap();
    let jpeg = fs::read(save(dir.path(), "a", &noise.into(), ImageFormat::Jpeg)).unwrap();
    let tiled = dir.path().join("tiled.tif");
    write_tiff(&tiled, &[PageSpec::new(90, 70, 16, rgb_at)]);
    let strips = dir.path().join("strips.tif");
    tiff::encoder::TiffEncoder::new(fs::File::create(&strips).unwrap())
        .unwrap()
        .write_image::<tiff::encoder::colortype::RGB8>(90, 70, picture(90, 70).as_raw())
        .unwrap();
    let (tiled, strips) = (fs::read(tiled).unwrap(), fs::read(strips).unwrap());
    for (name, file) in [
        ("png", &png),
        ("jpeg", &jpeg),
        ("tiled", &tiled),
        ("strips", &strips),
    ] {
        assert!(open_bytes(dir.path(), file).is_ok(), "{name} is whole");
        for k in 1..40 {
            // The last bytes of a PNG carry no pixels; all other cuts must be seen.
            let n = file.len() * k / 40 - usize::from(k == 39 && name != "png");
            assert!(
                open_bytes(dir.path(), &file[..n]).is_err(),
                "{name} cut at {n} of {}",
                file.len()
            );
        }
        let half = open_bytes(dir.path(), &file[..file.len() / 2]).unwrap_err();
        assert!(
            matches!(half, SlideError::Truncated { .. }),
            "{name}: {half}"
        );
    }
}

#[test]
fn flipped_bytes_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let tiled = dir.path().join("tiled.tif");
    write_tiff(
        &tiled,
        &[
            PageSpec::new(40, 30, 16, rgb_at),
            PageSpec::new(20, 15, 16, rgb_at),
        ],
    );
    let files = [
        fs::read(save(
            dir.path(),
            "a",
            &picture(40, 30).into(),
            ImageFormat::Png,
        ))
        .unwrap(),
        fs::read(save(
            dir.path(),
            "a",
            &picture(40, 30).into(),
            ImageFormat::Jpeg,
        ))
        .unwrap(),
        fs::read(tiled).unwrap(),
    ];
    let mut state = 1_u64;
    for file in files {
        for _ in 0..300 {
            let mut broken = file.clone();
            for _ in 0..3 {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                // Headers and directories sit at the two ends.
                let near = (state >> 33) as usize % 300;
                let at = if state & 1 << 62 == 0 {
                    near
                } else {
                    file.len() - 1 - near
                };
                broken[at.min(file.len() - 1)] ^= (state >> 20) as u8;
            }
            if let Ok(slide) = open_bytes(dir.path(), &broken) {
                let _ = slide.read_rgb8(0, 0, 0, 64, 64, [0; 3]);
                let _ = slide.read_gray_reduced(slide.levels().len() - 1, 1 << 20);
            }
        }
    }
}

#[test]
fn levels_sizes_and_kinds_that_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = save(dir.path(), "a.png", &picture(5, 5).into(), ImageFormat::Png);
    let slide = Slide::open(&path).unwrap();
    assert!(matches!(
        slide.read_gray(1),
        Err(SlideError::Level {
            asked: 1,
            available: 1,
            ..
        })
    ));
    assert!(matches!(
        slide.read_rgb8(0, 0, 0, 1 << 17, 1 << 17, [0; 3]),
        Err(SlideError::TooLarge { .. })
    ));

    // The size of a PNG stands at byte 16; its checksum at byte 29 covers bytes 12..29.
    let sized = |w: u32, h: u32| {
        let mut png = fs::read(&path).unwrap();
        png[16..20].copy_from_slice(&w.to_be_bytes());
        png[20..24].copy_from_slice(&h.to_be_bytes());
        let crc = crc32(&png[12..29]).to_be_bytes();
        png[29..33].copy_from_slice(&crc);
        open_bytes(dir.path(), &png)
    };
    assert!(matches!(
        sized(100_000, 100_000),
        Err(SlideError::TooLarge { .. })
    ));
    for more in [sized(5, 50), sized(5, 6), sized(50, 5)] {
        assert!(matches!(
            more,
            Err(SlideError::Truncated { .. } | SlideError::Damaged { .. })
        ));
    }
    assert!(sized(0, 5).is_err());

    let tif = dir.path().join("a.tif");
    let mut page = PageSpec::new(20, 20, 16, rgb_at);
    page.compression = 50001;
    write_tiff(&tif, &[page]);
    let e = Slide::open(&tif).unwrap_err();
    assert!(
        matches!(e, SlideError::Unsupported { .. }) && e.to_string().contains("WebP"),
        "{e}"
    );
    write_tiff(&tif, &[PageSpec::new(0, 20, 16, rgb_at)]);
    assert!(Slide::open(&tif).is_err());
}

fn crc32(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| {
        if crc & 1 == 1 {
            crc >> 1 ^ 0xEDB8_8320
        } else {
            crc >> 1
        }
    };
    !bytes
        .iter()
        .fold(!0, |crc, &b| (0..8).fold(crc ^ u32::from(b), step))
}
