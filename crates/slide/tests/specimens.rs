//! Real files, when SCOPESERVO_SPECIMENS points to the folder that holds them.

use std::path::PathBuf;

use scopeservo_slide::Slide;

fn specimens() -> PathBuf {
    std::env::var_os("SCOPESERVO_SPECIMENS")
        .expect("SCOPESERVO_SPECIMENS names the folder of real slides")
        .into()
}

/// Mean colour of a region as Pillow and libjpeg give it.
fn assert_mean(slide: &Slide, level: usize, [x, y, w, h]: [u32; 4], want: [f64; 3]) {
    let got = slide
        .read_rgb8(level, x.into(), y.into(), w, h, [0; 3])
        .unwrap();
    for (c, want) in want.into_iter().enumerate() {
        let sum: f64 = got
            .data
            .iter()
            .skip(c)
            .step_by(3)
            .map(|&v| f64::from(v))
            .sum();
        let mean = sum / f64::from(w * h);
        assert!(
            (mean - want).abs() < 1.0,
            "channel {c}: {mean}, expected {want}"
        );
    }
}

#[test]
#[ignore = "needs real slides: SCOPESERVO_SPECIMENS"]
fn an_aperio_slide() {
    let folder = specimens();
    let slide = Slide::open(&folder.join("skin_he.svs")).unwrap();
    let sizes: Vec<_> = slide.levels().iter().map(|l| (l.width, l.height)).collect();
    assert_eq!(
        sizes,
        [(2220, 2967)],
        "thumbnail, label and macro are no levels"
    );
    assert_eq!(slide.um_per_px(), Some(0.499));
    assert_mean(&slide, 0, [1000, 1000, 400, 300], MEAN_SVS);
}

#[test]
#[ignore = "needs real slides: SCOPESERVO_SPECIMENS"]
fn tiled_pyramids_of_two_scanners() {
    let folder = specimens();
    for (name, height, mean) in [("a", 4693, MEAN_A), ("b", 4779, MEAN_B)] {
        let slide = Slide::open(&folder.join(format!("cytology_scanner_{name}.tif"))).unwrap();
        assert_eq!(slide.levels().len(), 6);
        assert_eq!(
            (slide.levels()[0].width, slide.levels()[0].height),
            (5120, height)
        );
        assert!((slide.levels()[5].downsample - 32.0).abs() < 0.1);
        assert_eq!(slide.um_per_px(), None, "1 mm pixels are not believed");
        assert_mean(&slide, 0, [2000, 2000, 400, 300], mean);
    }
}

#[test]
#[ignore = "needs real slides: SCOPESERVO_SPECIMENS"]
fn a_png_of_sixteen_megapixels() {
    let folder = specimens();
    let slide = Slide::open(&folder.join("carcinoma_he.png")).unwrap();
    assert_eq!(
        (slide.levels()[0].width, slide.levels()[0].height),
        (4443, 3567)
    );
}

const MEAN_SVS: [f64; 3] = [139.28, 93.34, 133.52];
const MEAN_A: [f64; 3] = [227.10, 219.31, 227.66];
const MEAN_B: [f64; 3] = [230.94, 219.53, 224.03];
