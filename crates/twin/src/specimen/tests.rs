//! What every specimen promises: frames, levels, blank surroundings, errors; and that tissue is worth looking at.

use std::path::{Path, PathBuf};

use super::*;

/// A grey file with one red pixel, in a folder of its own.
fn red_pixel(folder: &Path, [w, h]: [u32; 2], [x, y]: [u32; 2]) -> PathBuf {
    let path = folder.join("red.png");
    let mut image = image::RgbImage::from_pixel(w, h, image::Rgb([100, 100, 100]));
    image.put_pixel(x, y, image::Rgb([200, 0, 0]));
    image.save(&path).unwrap();
    path
}

pub(super) fn sample(p: &Patch, i: usize, j: usize) -> [u8; 3] {
    let at = 3 * (j * p.width + i);
    [p.rgb[at], p.rgb[at + 1], p.rgb[at + 2]]
}

/// World place of the reddest sample.
fn reddest(p: &Patch) -> [f64; 2] {
    let red = |k: usize| i32::from(p.rgb[3 * k]) - i32::from(p.rgb[3 * k + 1]);
    let k = (0..p.width * p.height).max_by_key(|&k| red(k)).unwrap();
    let (i, j) = ((k % p.width) as f64, (k / p.width) as f64);
    [p.x0_um + i * p.spacing_um, p.y0_um - j * p.spacing_um]
}

#[test]
fn a_file_lies_centred_with_its_rows_along_minus_y() {
    let dir = tempfile::tempdir().unwrap();
    // Pixel (70, 10) of 100 x 60 at 2 um: its centre is 20.5 px right of and 19.5 px above the file's centre.
    let path = red_pixel(dir.path(), [100, 60], [70, 10]);
    let s = FileSpecimen::open(&path, Some(2.0)).unwrap();
    assert_eq!(s.extent_um(), Some([-100.0, 100.0, -60.0, 60.0]));
    let [x0, x1, y0, y1] = s.extent_um().unwrap();
    let fine = s.patch(0, [x0, x1], [y0, y1], 3).unwrap();
    assert_eq!(reddest(&fine), [41.0, 39.0]);
    // Level 1 means pixels 70 and 71, rows 10 and 11: the sample lies half a fine sample right and below.
    let coarse = s.patch(1, [x0, x1], [y0, y1], 3).unwrap();
    assert_eq!(coarse.spacing_um, 4.0);
    assert_eq!(reddest(&coarse), [42.0, 38.0]);
    let [r, g, _] = [(3 * 100 + 200 + 2) / 4, (3 * 100 + 2) / 4, 0];
    let (i, j) = (
        ((42.0 - coarse.x0_um) / 4.0) as usize,
        ((coarse.y0_um - 38.0) / 4.0) as usize,
    );
    assert_eq!(sample(&coarse, i, j)[..2], [r as u8, g as u8]);
}

#[test]
fn a_patch_surrounds_its_rectangle() {
    let s = Blank;
    for (level, x, y, margin) in [
        (0, [0.0, 10.0], [-3.0, 4.0], 0),
        (1, [0.125, 0.125], [7.3, 7.31], 2),
        (3, [-1e4, -1e4 + 33.0], [5.0, 99.0], 1),
    ] {
        let p = s.patch(level, x, y, margin).unwrap();
        let m = margin as f64 * p.spacing_um;
        let x_end = p.x0_um + (p.width - 1) as f64 * p.spacing_um;
        let y_end = p.y0_um - (p.height - 1) as f64 * p.spacing_um;
        assert!(
            p.x0_um <= x[0] - m && x_end > x[1] + m,
            "{x:?} in {} .. {x_end}",
            p.x0_um
        );
        assert!(
            p.y0_um > y[1] + m - 1e-9 && y_end <= y[0] - m,
            "{y:?} in {y_end} .. {}",
            p.y0_um
        );
        let spare = 2.0 * p.spacing_um + 1e-9;
        assert!(
            p.x0_um > x[0] - m - spare && x_end < x[1] + m + spare,
            "not larger than needed"
        );
        assert_eq!(p.rgb.len(), 3 * p.width * p.height);
    }
}

#[test]
fn beyond_a_file_is_glass() {
    let dir = tempfile::tempdir().unwrap();
    let s = FileSpecimen::open(&red_pixel(dir.path(), [90, 70], [1, 1]), Some(1.0)).unwrap();
    for level in 0..s.levels() {
        let p = s.patch(level, [1000.0, 1100.0], [-20.0, 20.0], 0).unwrap();
        assert_eq!(p.rgb, GLASS.repeat(p.width * p.height));
    }
    let p = s.patch(0, [44.0, 46.0], [0.0, 0.0], 0).unwrap();
    assert_eq!(sample(&p, 0, 0), [100; 3]);
    assert_eq!(sample(&p, p.width - 1, 0), GLASS);
}

/// Each sample of level L + 1 is the rounded mean of the four of level L around its centre.
pub(super) fn assert_box_means(s: &dyn Specimen, level: usize, x: [f64; 2], y: [f64; 2]) {
    let coarse = s.patch(level + 1, x, y, 0).unwrap();
    let reach = 0.25 * coarse.spacing_um;
    let x_end = coarse.x0_um + (coarse.width - 1) as f64 * coarse.spacing_um;
    let y_end = coarse.y0_um - (coarse.height - 1) as f64 * coarse.spacing_um;
    let fine = s
        .patch(
            level,
            [coarse.x0_um - reach, x_end + reach],
            [y_end - reach, coarse.y0_um + reach],
            1,
        )
        .unwrap();
    for j in 0..coarse.height {
        for i in 0..coarse.width {
            let first = |from: f64| (from / fine.spacing_um).round() as usize;
            let fi = first(coarse.x0_um + i as f64 * coarse.spacing_um - reach - fine.x0_um);
            let fj = first(fine.y0_um - (coarse.y0_um - j as f64 * coarse.spacing_um + reach));
            for c in 0..3 {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)]
                    .map(|(di, dj)| u32::from(sample(&fine, fi + di, fj + dj)[c]));
                let mean = (four.iter().sum::<u32>() + 2) / 4;
                assert_eq!(
                    u32::from(sample(&coarse, i, j)[c]),
                    mean,
                    "column {i}, row {j}"
                );
            }
        }
    }
}

#[test]
fn levels_are_box_means() {
    let tissue = Tissue::new(3);
    for level in 0..3 {
        assert_box_means(&tissue, level, [40.0, 90.0], [-20.0, 30.0]);
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("busy.png");
    image::RgbImage::from_fn(611, 433, |x, y| {
        image::Rgb([(x * y) as u8, (x ^ y) as u8, (3 * x + y) as u8])
    })
    .save(&path)
    .unwrap();
    let s = FileSpecimen::open(&path, Some(0.5)).unwrap();
    for level in 0..4 {
        assert_box_means(&s, level, [-160.0, 0.0], [-120.0, 5.0]);
    }
}

#[test]
fn tissue_does_not_depend_on_threads_order_or_what_was_asked_before() {
    let ask = |t: &Tissue| t.patch(1, [10.0, 200.0], [-150.0, 20.0], 2).unwrap();
    let reference = ask(&Tissue::new(5));
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let used = Tissue::new(5);
        pool.install(|| {
            used.patch(0, [100.0, 140.0], [-60.0, -20.0], 0).unwrap();
            used.patch(2, [-100.0, 100.0], [-50.0, 20.0], 0).unwrap();
            assert_eq!(ask(&used), reference, "{threads} threads");
        });
    }
    assert_ne!(ask(&Tissue::new(6)), reference);
}

/// Checksums of the samples as they were first painted. Frames, and figures that were measured on them, rest on them.
#[test]
#[cfg_attr(
    not(all(target_os = "linux", target_env = "gnu")),
    ignore = "exp, ln and sin of other systems may differ in the last bit"
)]
fn tissue_stays_what_it_was() {
    for (seed, level, x, y, side, checksum) in [
        (1, 0, 0.0, 0.0, [100.0, 70.0], 0x6ABB_D08B_4435_E8D4),
        (2, 0, -3071.3, -5500.9, [80.0, 60.0], 0xDBA0_28E5_5709_052D),
        (3, 0, 912.6, -20_444.0, [63.0, 31.0], 0x3A61_1079_DA01_7DAC),
        (7, 1, -150.2, 880.4, [120.0, 90.0], 0x2D4C_D03F_C93F_E3C2),
        (2026, 2, 4100.0, 77.0, [200.0; 2], 0xB371_DD19_DE7C_9447),
        (
            u64::MAX,
            3,
            -1e6,
            1e6,
            [120.0, 100.0],
            0xEE73_80FD_F73F_0A66,
        ),
    ] {
        let [w, h] = side;
        let tissue = Tissue::new(seed);
        let patch = tissue.patch(level, [x, x + w], [y, y + h], 1).unwrap();
        // FNV-1a.
        let found = patch
            .rgb
            .iter()
            .fold(0xCBF2_9CE4_8422_2325, |hash: u64, &byte| {
                (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3)
            });
        assert_eq!(found, checksum, "seed {seed} at {x}, {y}: {found:#018X}");
    }
}

#[test]
fn structure_is_found_on_tissue_and_not_on_glass() {
    let field = [328.0, 242.0];
    assert_eq!(texture_share(&Blank, [0.0, 0.0], field).unwrap(), 0.0);
    let tissue = Tissue::new(1);
    let places = [[0.0, 0.0], [700.0, -400.0], [-2500.0, 900.0]];
    let shares = places.map(|c| texture_share(&tissue, c, field).unwrap());
    assert!(shares.iter().sum::<f64>() / 3.0 > 0.8, "{shares:?}");
}

#[test]
fn scales_that_are_missing_or_no_lengths_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = red_pixel(dir.path(), [40, 40], [1, 1]);
    let missing = FileSpecimen::open(&path, None).unwrap_err();
    assert!(matches!(missing, SpecimenError::MissingScale { .. }));
    assert!(missing.to_string().contains("red.png"));
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let e = FileSpecimen::open(&path, Some(bad)).unwrap_err();
        assert!(matches!(e, SpecimenError::BadScale { .. }), "{bad}");
    }
    let none = FileSpecimen::open(&dir.path().join("no.png"), Some(1.0)).unwrap_err();
    assert!(matches!(none, SpecimenError::Slide(_)));
}

#[test]
fn levels_and_rectangles_that_are_not_there_are_refused() {
    let s = Blank;
    let e = s.patch(6, [0.0, 1.0], [0.0, 1.0], 0).unwrap_err();
    assert!(matches!(
        e,
        SpecimenError::Level {
            asked: 6,
            available: 6
        }
    ));
    for x in [[1.0, 0.0], [f64::NAN, 0.0], [0.0, f64::INFINITY]] {
        let e = s.patch(0, x, [0.0, 1.0], 0).unwrap_err();
        assert!(matches!(e, SpecimenError::Rectangle { .. }));
    }
    let e = s.patch(0, [0.0, 1e6], [0.0, 1e6], 0).unwrap_err();
    assert!(matches!(e, SpecimenError::PatchTooLarge { .. }));
    assert!(s.patch(0, [0.0, 1.0], [0.0, 1.0], usize::MAX).is_err());
}
