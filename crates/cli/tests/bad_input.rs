//! Every row of the bad-input list: what is refused, with which exit code, and what must work all the same.

mod common;

use common::{
    assert_bad_input, code, json, save_gray8, save_gray16, save_rgba, scopeservo, stderr,
    tissue_gray,
};
use std::fs;
use std::path::Path;

fn text(path: &Path) -> &str {
    path.to_str().expect("the temporary folder's name is UTF-8")
}

/// A tissue image of 900 x 700 um and what can be made of it.
fn picture(folder: &Path) -> (Vec<u8>, usize, usize, String) {
    let (w, h) = (1800, 1400);
    let gray = tissue_gray(3, [0.0, 0.0], w, h);
    let path = save_gray8(&folder.join("tissue.png"), w, h, gray.clone());
    (gray, w, h, text(&path).to_owned())
}

#[test]
fn files_that_are_no_images_are_exit_2() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let (_, _, _, whole) = picture(d);
    let bytes = fs::read(&whole).unwrap();
    fs::write(d.join("truncated.png"), &bytes[..bytes.len() / 2]).unwrap();
    fs::write(d.join("empty.png"), b"").unwrap();
    fs::write(d.join("text.png"), b"This is a letter, not a slide.\n").unwrap();
    save_gray8(&d.join("one.png"), 1, 1, vec![128]);
    for name in [
        "missing.png",
        "truncated.png",
        "empty.png",
        "text.png",
        "one.png",
    ] {
        assert_bad_input(d, &["demo", "--specimen", name, "--um-per-px", "0.5"]);
        assert_bad_input(d, &["register", name, &whole]);
        assert_bad_input(d, &["register", &whole, name]);
    }
}

#[test]
fn scales_that_are_none_are_exit_2() {
    let dir = tempfile::tempdir().unwrap();
    let (_, _, _, whole) = picture(dir.path());
    for scale in ["0", "-0.5", "nan", "inf", "0,5", "half", "1e308", "1e-30"] {
        assert_bad_input(
            dir.path(),
            &["demo", "--specimen", &whole, "--um-per-px", scale],
        );
    }
    // PNG states no scale, so one must be given.
    assert_bad_input(dir.path(), &["demo", "--specimen", &whole]);
}

#[test]
fn a_slide_smaller_than_the_400x_view_is_exit_2() {
    let dir = tempfile::tempdir().unwrap();
    // Large enough for the view, too small to displace it by 100 um.
    let (w, h) = (700, 520);
    let tight = save_gray8(
        &dir.path().join("tight.png"),
        w,
        h,
        tissue_gray(3, [0.0; 2], w, h),
    );
    assert_bad_input(
        dir.path(),
        &["demo", "--specimen", text(&tight), "--um-per-px", "0.5"],
    );
    let small = save_gray8(
        &dir.path().join("small.png"),
        400,
        300,
        tissue_gray(3, [0.0; 2], 400, 300),
    );
    assert_bad_input(
        dir.path(),
        &["demo", "--specimen", text(&small), "--um-per-px", "0.5"],
    );
}

#[test]
fn numbers_and_words_that_make_no_sense_are_exit_2() {
    let dir = tempfile::tempdir().unwrap();
    let (_, _, _, whole) = picture(dir.path());
    for args in [
        vec!["demo", "--lambda", "0"],
        vec!["demo", "--lambda", "nan"],
        vec!["demo", "--lambda", "-0.2"],
        vec!["demo", "--threads", "0"],
        vec!["demo", "--max-iterations", "0"],
        vec!["demo", "--start-um", "300"],
        vec!["demo", "--start-um", "1e13,0"],
        vec!["demo", "--start-deg", "inf"],
        vec!["demo", "--seed", "-1"],
        vec!["demo", "--nonsense"],
        vec!["demo", "--um-per-px", "0.5"],
        vec!["register", &whole],
        vec!["register", &whole, &whole, "--level", "9"],
        vec!["register", &whole, &whole, "--features", "0"],
        vec!["register", &whole, &whole, "--time", "0"],
        vec!["register", &whole, &whole, "--time", "10001"],
        vec!["register", &whole, &whole, "--time", "-1"],
        vec!["register", &whole, &whole, "--threads", "0"],
        vec!["register", &whole, &whole, "--threads", "257"],
        vec!["register", &whole, &whole, "--threads", "two"],
        vec!["calibrate"],
        vec!["focus"],
        vec!["target", "save"],
        vec!["reposition"],
        vec![],
    ] {
        assert_bad_input(dir.path(), &args);
    }
}

#[test]
fn a_folder_that_cannot_be_written_is_exit_2_before_anything_runs() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("file"), b"in the way").unwrap();
    assert_bad_input(dir.path(), &["demo", "--out", "file/run"]);
}

#[test]
fn a_blank_specimen_is_refused_with_exit_3() {
    let dir = tempfile::tempdir().unwrap();
    let blank = save_gray8(
        &dir.path().join("blank.png"),
        1800,
        1400,
        vec![243; 1800 * 1400],
    );
    let output = scopeservo(
        dir.path(),
        &[
            "demo",
            "--specimen",
            text(&blank),
            "--um-per-px",
            "0.5",
            "--json",
        ],
    );
    assert_eq!(code(&output), 3, "{}", stderr(&output));
    let answer = json(&output);
    assert_eq!(answer["verdict"], "refused");
    assert_eq!(answer["reason"], "no_focus");
    assert!(answer["true_error_um"].is_null());
    let page = fs::read_to_string(dir.path().join("scopeservo-demo/report.html")).unwrap();
    assert!(page.trim_end().ends_with("</html>"));
}

#[test]
fn a_blank_start_is_refused_with_exit_3() {
    let dir = tempfile::tempdir().unwrap();
    let (_, _, _, whole) = picture(dir.path());
    // 3 mm to the side there is only glass.
    let output = scopeservo(
        dir.path(),
        &[
            "demo",
            "--specimen",
            &whole,
            "--um-per-px",
            "0.5",
            "--start-um",
            "3000,0",
            "--json",
        ],
    );
    assert_eq!(code(&output), 3, "{}", stderr(&output));
    let answer = json(&output);
    assert_eq!(answer["verdict"], "refused");
    assert_eq!(answer["reason"], "no_focus");
}

#[test]
fn unrelated_images_are_not_found_with_exit_3() {
    let dir = tempfile::tempdir().unwrap();
    let (_, _, _, whole) = picture(dir.path());
    let (w, h) = (1200, 900);
    let elsewhere = save_gray8(
        &dir.path().join("b.png"),
        w,
        h,
        tissue_gray(3, [9000.0, 0.0], w, h),
    );
    let output = scopeservo(
        dir.path(),
        &["register", &whole, text(&elsewhere), "--json"],
    );
    assert_eq!(code(&output), 3, "{}", stderr(&output));
    let answer = json(&output);
    assert_eq!(answer["verdict"], "not_found");
    assert!(answer["target_from_view"].is_null() && answer["sigma_px"].is_null());
    let blank = save_gray8(&dir.path().join("blank.png"), w, h, vec![200; w * h]);
    let output = scopeservo(dir.path(), &["register", &whole, text(&blank), "--json"]);
    assert_eq!(code(&output), 3);
    assert_eq!(json(&output)["reason"], "too_few_features");
}

/// Asserts that `answer` is found and maps every corner of a `w` x `h` image to itself plus `offset`.
fn assert_shift(answer: &serde_json::Value, w: usize, h: usize, offset: [f64; 2], within: f64) {
    assert_eq!(answer["verdict"], "found", "{answer}");
    let m = &answer["target_from_view"];
    for (x, y) in [
        (0.0, 0.0),
        (w as f64, 0.0),
        (0.0, h as f64),
        (w as f64, h as f64),
    ] {
        for (k, p) in [x, y].into_iter().enumerate() {
            let q = m[k][0].as_f64().unwrap() * x
                + m[k][1].as_f64().unwrap() * y
                + m[k][2].as_f64().unwrap();
            assert!((q - p - offset[k]).abs() <= within, "{answer}");
        }
    }
}

#[test]
fn identical_images_are_found_with_the_identity() {
    let dir = tempfile::tempdir().unwrap();
    let (_, w, h, whole) = picture(dir.path());
    let output = scopeservo(dir.path(), &["register", &whole, &whole, "--json"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_shift(&json(&output), w, h, [0.0, 0.0], 1e-3);
}

#[test]
fn sixteen_bit_grey_rgba_and_forty_megapixels_register() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let (gray, w, h, whole) = picture(d);
    save_gray16(&d.join("gray16.png"), w, h, &gray);
    save_rgba(&d.join("rgba.png"), w, h, &gray);
    for name in ["gray16.png", "rgba.png"] {
        let output = scopeservo(d, &["register", name, &whole, "--json"]);
        assert_eq!(code(&output), 0, "{name}: {}", stderr(&output));
        assert_shift(&json(&output), w, h, [0.0, 0.0], 0.01);
    }
    // 40 megapixels: the tissue at four times the size, and the same displaced by 12, 8.
    let (big_w, big_h) = (4 * w, 4 * h);
    let enlarged = |dx: usize, dy: usize| {
        (0..big_w * big_h)
            .map(|i| {
                let (x, y) = ((i % big_w + dx) / 4, (i / big_w + dy) / 4);
                gray[y.min(h - 1) * w + x.min(w - 1)]
            })
            .collect::<Vec<u8>>()
    };
    assert!(big_w * big_h >= 40_000_000);
    save_gray8(&d.join("big.png"), big_w, big_h, enlarged(0, 0));
    save_gray8(&d.join("moved.png"), big_w, big_h, enlarged(12, 8));
    let output = scopeservo(d, &["register", "big.png", "moved.png", "--json"]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let answer = json(&output);
    assert_shift(&answer, big_w, big_h, [-12.0, -8.0], 0.3);
    assert!(answer["reduced"][0].as_u64().unwrap() > 1, "{answer}");
}

#[test]
fn sixteen_bit_grey_rgba_and_forty_megapixels_lie_under_the_microscope() {
    let dir = tempfile::tempdir().unwrap();
    let d = dir.path();
    let (gray, w, h, _) = picture(d);
    save_gray16(&d.join("gray16.png"), w, h, &gray);
    save_rgba(&d.join("rgba.png"), w, h, &gray);
    let (big_w, big_h) = (4 * w, 4 * h);
    let big = (0..big_w * big_h)
        .map(|i| gray[(i / big_w / 4) * w + i % big_w / 4])
        .collect();
    save_gray8(&d.join("big.png"), big_w, big_h, big);
    for (name, scale) in [
        ("gray16.png", "0.5"),
        ("rgba.png", "0.5"),
        ("big.png", "0.125"),
    ] {
        // One iteration is enough to have focused, calibrated and recognised the target on it.
        let output = scopeservo(
            d,
            &[
                "demo",
                "--specimen",
                name,
                "--um-per-px",
                scale,
                "--max-iterations",
                "1",
                "--json",
            ],
        );
        assert_eq!(code(&output), 3, "{name}: {}", stderr(&output));
        let answer = json(&output);
        assert_eq!(answer["reason"], "iteration_limit", "{name}: {answer}");
        assert!(
            answer["magnifications"][0]["inliers"].as_u64().unwrap() >= 10,
            "{name}: {answer}"
        );
    }
}
