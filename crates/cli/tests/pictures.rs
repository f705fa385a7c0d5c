//! `register` on files of several pictures, on mirrored and blurred ones, and files that are none.

mod common;

use common::{assert_bad_input, code, json, ok, save_gray8, scopeservo, tissue_gray};
use std::path::Path;

/// The view is seen in the target from this pixel on.
const AT: [usize; 2] = [30, 20];

fn cut(gray: &[u8], width: usize, [x, y]: [usize; 2], [w, h]: [usize; 2]) -> Vec<u8> {
    (y..y + h)
        .flat_map(|row| gray[row * width + x..][..w].to_vec())
        .collect()
}

/// Pages of 8 bit grey, uncompressed, one after the other; the first has this text.
fn tiff(pages: &[Vec<u8>], [w, h]: [usize; 2], text: &str) -> Vec<u8> {
    let mut out = b"II\x2a\0\x08\0\0\0".to_vec();
    let size = 2 + 9 * 12 + 4;
    let mut data = 8 + pages.len() * size;
    let text_at = data;
    data += text.len() + 1;
    let first_image = data;
    for (k, page) in pages.iter().enumerate() {
        out.extend(9_u16.to_le_bytes());
        let next = if k + 1 == pages.len() {
            0
        } else {
            8 + (k + 1) * size
        };
        let described = if k == 0 { text.len() + 1 } else { 1 };
        let at = if k == 0 { text_at } else { 0 };
        for (tag, kind, count, value) in [
            (256_u16, 4_u16, 1, w),
            (257, 4, 1, h),
            (258, 3, 1, 8),
            (259, 3, 1, 1),
            (262, 3, 1, 1),
            (270, 2, described, at),
            (273, 4, 1, first_image + k * w * h),
            (278, 4, 1, h),
            (279, 4, 1, page.len()),
        ] {
            out.extend(tag.to_le_bytes());
            out.extend(kind.to_le_bytes());
            out.extend((count as u32).to_le_bytes());
            out.extend((value as u32).to_le_bytes());
        }
        out.extend((next as u32).to_le_bytes());
    }
    out.extend(text.bytes().chain([0]));
    pages.iter().for_each(|page| out.extend(page));
    out
}

fn found_at(answer: &serde_json::Value) {
    assert_eq!(answer["verdict"], "found", "{answer}");
    let t = &answer["target_from_view"];
    let row = |k: usize| {
        t[k][2]
            .as_f64()
            .or_else(|| t["offset"][k].as_f64())
            .unwrap()
    };
    assert!(
        (row(0) - AT[0] as f64).abs() < 0.1 && (row(1) - AT[1] as f64).abs() < 0.1,
        "{t}"
    );
}

fn make(folder: &Path) -> [Vec<u8>; 2] {
    let target = tissue_gray(3, [0.0, 0.0], 320, 260);
    let view = cut(&target, 320, AT, [240, 200]);
    save_gray8(&folder.join("view.png"), 240, 200, view.clone());
    save_gray8(&folder.join("target.png"), 320, 260, target.clone());
    [view, target]
}

#[test]
fn pages_and_channels_are_chosen_for_each_file_and_told() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let [_, target] = make(here);
    let empty = vec![7; target.len()];
    let ome = "<OME><Image><Pixels SizeC=\"2\" DimensionOrder=\"XYCZT\" PhysicalSizeX=\"0.5\" PhysicalSizeY=\"0.5\"><TiffData/></Pixels></Image></OME>";
    for (name, text, told) in [
        ("a.tif", "", "2 pages; looking at page 0"),
        (
            "b.ome.tif",
            ome,
            "2 channels (0, 1); looking at channel 0, page 0",
        ),
        (
            "c.tif",
            "ImageJ=1.53\nchannels=2\n",
            "2 channels (0, 1); looking at channel 0, page 0",
        ),
    ] {
        std::fs::write(
            here.join(name),
            tiff(&[empty.clone(), target.clone()], [320, 260], text),
        )
        .unwrap();
        let first = scopeservo(here, &["register", "view.png", name, "--json"]);
        assert_eq!(code(&first), 3);
        assert_eq!(json(&first)["choices"], serde_json::json!([null, told]));
        let second = ok(
            here,
            &["register", "view.png", name, "--page", "0,1", "--json"],
        );
        found_at(&second);
        if name != "a.tif" {
            found_at(&ok(
                here,
                &["register", "view.png", name, "--channel", "0,1", "--json"],
            ));
        }
        if name == "b.ome.tif" {
            assert_eq!(second["um_per_px"], serde_json::json!([null, 0.5]));
        }
        assert_bad_input(here, &["register", "view.png", name, "--page", "0,2"]);
        assert_bad_input(here, &["register", "view.png", name, "--channel", "0,5"]);
        assert_bad_input(here, &["register", "view.png", name, "--page", "0,1,1"]);
        assert_bad_input(here, &["register", "view.png", name, "--level", "0,1"]);
    }
}

#[test]
fn an_image_that_is_much_more_blurred_than_the_other_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let [view, _] = make(here);
    let elsewhere = tissue_gray(8, [4000.0, -3000.0], 320, 260);
    save_gray8(&here.join("elsewhere.png"), 320, 260, elsewhere);
    let sharp = image::GrayImage::from_raw(240, 200, view).unwrap();
    for sigma in [6.0, 8.0, 10.0] {
        image::imageops::blur(&sharp, sigma)
            .save(here.join("soft.png"))
            .unwrap();
        for (a, b, name) in [
            ("soft.png", "elsewhere.png", "The view"),
            ("elsewhere.png", "soft.png", "The target"),
        ] {
            let output = scopeservo(here, &["register", a, b, "--json"]);
            let answer = json(&output);
            let message = answer["message"].as_str().unwrap();
            assert_eq!(code(&output), 3, "{answer}");
            // Of an image with hardly a feature nobody can say how fine they are.
            let few = answer["keypoints"]
                .as_array()
                .unwrap()
                .iter()
                .any(|n| n.as_u64().unwrap() < 8);
            assert!(
                few || message.contains(&format!("{name} is blurred beside")),
                "{sigma}: {answer}"
            );
        }
    }
    // Two that are as sharp as each other are not.
    let output = scopeservo(here, &["register", "view.png", "elsewhere.png"]);
    assert!(!String::from_utf8_lossy(&output.stdout).contains("blurred"));
}

#[cfg(unix)]
#[test]
fn pipes_devices_and_long_configurations_are_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    make(here);
    let made = std::process::Command::new("mkfifo")
        .arg(here.join("pipe"))
        .status();
    if made.is_ok_and(|s| s.success()) {
        assert_bad_input(here, &["register", "pipe", "view.png"]);
        assert_bad_input(here, &["register", "view.png", "pipe"]);
        assert_bad_input(here, &["doctor", "--config", "pipe"]);
    }
    assert_bad_input(here, &["register", "/dev/zero", "view.png"]);
    assert_bad_input(here, &["doctor", "--config", "/dev/zero"]);
    std::fs::write(here.join("long.toml"), vec![b'#'; (1 << 20) + 1]).unwrap();
    assert_bad_input(here, &["doctor", "--config", "long.toml"]);
}
