//! `register` and `target save` are sure only where the images are: what is fixed to the camera, what repeats itself and what is mirrored
//! is told as such.

mod common;

use common::{code, describe, json, save_gray8, scopeservo, stderr, tissue_gray};
use std::path::{Path, PathBuf};

const SIZE: [usize; 2] = [400, 300];

/// Numbers that look random, the same every time.
struct Numbers(u64);

impl Numbers {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % n
    }
}

/// Glass with the noise of `seed`.
fn glass(seed: u64) -> Vec<u8> {
    let mut numbers = Numbers(seed);
    (0..SIZE[0] * SIZE[1])
        .map(|_| 222 + numbers.below(7) as u8)
        .collect()
}

fn disc(gray: &mut [u8], [x, y]: [i64; 2], radius: i64, less: u8) {
    for row in y - radius..=y + radius {
        for column in x - radius..=x + radius {
            let inside = (row - y).pow(2) + (column - x).pow(2) <= radius * radius;
            let there = (0..SIZE[0] as i64).contains(&column) && (0..SIZE[1] as i64).contains(&row);
            if inside && there {
                let at = row as usize * SIZE[0] + column as usize;
                gray[at] = gray[at].saturating_sub(less);
            }
        }
    }
}

/// Rings and spots where dust lies on the camera.
fn with_dust(mut gray: Vec<u8>) -> Vec<u8> {
    let mut numbers = Numbers(77);
    for _ in 0..30 {
        let at = [numbers.below(SIZE[0]) as i64, numbers.below(SIZE[1]) as i64];
        let (radius, less) = (4 + numbers.below(9) as i64, 30 + numbers.below(60) as u8);
        disc(&mut gray, at, radius, less);
        disc(&mut gray, at, radius / 2, less / 2);
    }
    gray
}

/// A lattice of spots, `first` from the corner, with one missing where asked.
fn lattice(seed: u64, pitch: i64, first: [i64; 2], missing: Option<[i64; 2]>) -> Vec<u8> {
    let mut gray = glass(seed);
    for j in -1..=SIZE[1] as i64 / pitch + 1 {
        for i in -1..=SIZE[0] as i64 / pitch + 1 {
            let at = [first[0] + i * pitch, first[1] + j * pitch];
            if missing != Some(at) {
                disc(&mut gray, at, pitch / 4, 120);
            }
        }
    }
    gray
}

fn save(folder: &Path, name: &str, gray: Vec<u8>) -> PathBuf {
    save_gray8(&folder.join(name), SIZE[0], SIZE[1], gray)
}

fn register(folder: &Path, more: &[&str]) -> (i32, serde_json::Value) {
    let mut args = vec!["register", "view.png", "target.png", "--json"];
    args.extend(more);
    let output = scopeservo(folder, &args);
    (code(&output), json(&output))
}

#[test]
fn two_blank_places_with_the_same_dust_are_suspect_and_one_picture_is_found_in_itself() {
    let dir = tempfile::tempdir().unwrap();
    save(dir.path(), "view.png", with_dust(glass(1)));
    save(dir.path(), "target.png", with_dust(glass(2)));
    let (exit, answer) = register(dir.path(), &[]);
    assert_eq!(
        (exit, answer["verdict"].as_str()),
        (3, Some("suspect")),
        "{answer}"
    );
    assert!(
        answer["message"].as_str().unwrap().contains("--same-place"),
        "{answer}"
    );
    let (exit, answer) = register(dir.path(), &["--same-place"]);
    assert_eq!(
        (exit, answer["verdict"].as_str()),
        (0, Some("found")),
        "{answer}"
    );
    save(dir.path(), "target.png", with_dust(glass(1)));
    let (exit, answer) = register(dir.path(), &[]);
    assert_eq!(
        (exit, answer["verdict"].as_str()),
        (0, Some("found")),
        "equal to the last bit: {answer}"
    );
}

#[test]
fn tissue_that_rested_is_found_though_it_is_where_it_was() {
    let dir = tempfile::tempdir().unwrap();
    for (name, seed) in [("view.png", 1), ("target.png", 2)] {
        let mut noise = Numbers(seed);
        let tissue = tissue_gray(3, [0.0, 0.0], SIZE[0], SIZE[1]);
        save(
            dir.path(),
            name,
            tissue
                .into_iter()
                .map(|v| v.saturating_add(noise.below(7) as u8))
                .collect(),
        );
    }
    let (exit, answer) = register(dir.path(), &[]);
    assert_eq!(
        (exit, answer["verdict"].as_str()),
        (0, Some("found")),
        "{answer}"
    );
}

#[test]
fn a_lattice_is_never_found_and_what_is_ambiguous_is_a_period_apart() {
    let dir = tempfile::tempdir().unwrap();
    let mut ambiguous = 0;
    for (pitch, turns) in [(23, 0), (37, 1), (50, 2), (62, 3)] {
        for seed in 0..3 {
            let noise = 10 * turns + 2 * seed;
            save(
                dir.path(),
                "view.png",
                lattice(noise, pitch, [10, 20], None),
            );
            let there = [10 + pitch / 3 + seed as i64, 20 - pitch / 4];
            save(
                dir.path(),
                "target.png",
                lattice(noise + 1, pitch, there, None),
            );
            let (exit, answer) = register(dir.path(), &[]);
            assert_eq!(exit, 3, "{pitch}: {answer}");
            if answer["verdict"] != "ambiguous"
                || answer["message"].as_str().unwrap().contains("turned")
            {
                continue;
            }
            ambiguous += 1;
            let offset = |key: &str| [0, 1].map(|k| answer[key][k][2].as_f64().unwrap());
            let (here, other) = (offset("target_from_view"), offset("other_target_from_view"));
            for k in 0..2 {
                let periods = (here[k] - other[k]) / pitch as f64;
                assert!(
                    (periods - periods.round()).abs() < 0.1,
                    "{pitch}: {periods} {answer}"
                );
            }
        }
    }
    assert!(
        ambiguous > 0,
        "some of them agree well enough to be told what they are"
    );
}

#[test]
fn what_is_there_twice_is_ambiguous_and_both_places_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let mut target = tissue_gray(3, [0.0, 0.0], SIZE[0], SIZE[1]);
    let piece = tissue_gray(9, [0.0, 0.0], 120, 100);
    for [x, y] in [[20, 30], [250, 180]] {
        for row in 0..100 {
            for column in 0..120 {
                target[(y + row) * SIZE[0] + x + column] = piece[row * 120 + column];
            }
        }
    }
    save(dir.path(), "target.png", target);
    save_gray8(&dir.path().join("view.png"), 120, 100, piece);
    let (exit, answer) = register(dir.path(), &[]);
    assert_eq!(
        (exit, answer["verdict"].as_str()),
        (3, Some("ambiguous")),
        "{answer}"
    );
    let mut places = ["target_from_view", "other_target_from_view"]
        .map(|key| [0, 1].map(|k| answer[key][k][2].as_f64().unwrap().round() as i64));
    places.sort_unstable();
    assert_eq!(places, [[20, 30], [250, 180]]);
}

#[test]
fn a_mirrored_view_is_named_and_accepted_when_asked() {
    let dir = tempfile::tempdir().unwrap();
    let tissue = tissue_gray(3, [0.0, 0.0], SIZE[0], SIZE[1]);
    let flipped = tissue
        .chunks(SIZE[0])
        .flat_map(|row| row.iter().rev().copied())
        .collect();
    save(dir.path(), "view.png", flipped);
    save(dir.path(), "target.png", tissue);
    let (exit, answer) = register(dir.path(), &[]);
    assert_eq!(
        (exit, answer["verdict"].as_str(), answer["reason"].as_str()),
        (3, Some("not_found"), Some("mirrored")),
        "{answer}"
    );
    let (exit, answer) = register(dir.path(), &["--mirror"]);
    assert_eq!(
        (exit, answer["verdict"].as_str()),
        (0, Some("found")),
        "{answer}"
    );
    assert_eq!(answer["mirrored"], true);
    let turned_over = answer["target_from_view"][0][0].as_f64().unwrap();
    let shifted = answer["target_from_view"][0][2].as_f64().unwrap();
    assert!(
        (turned_over + 1.0).abs() < 1e-3 && (shifted - 399.0).abs() < 0.1,
        "{answer}"
    );
}

const BY_HAND: &str = "stage = \"xy\"\nobjectives = [\"40x\"]\n";

#[test]
fn dust_alone_and_a_lattice_are_not_saved_and_a_target_saved_still_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let dust = "camera.dust = [{ specks = 40, radius_px = [4, 12], attenuation = [0.3, 0.8], steepness = [15, 40] }]\n";
    for (specimen, word) in [
        ("made.blank = {}\n", &["nothing_moves", "poor_target"][..]),
        (
            "made.lattice = { kind = \"square\", pitch_um = 20 }\n",
            &["ambiguous"][..],
        ),
    ] {
        describe(dir.path(), &format!("{BY_HAND}{specimen}{dust}"));
        let output = scopeservo(dir.path(), &["target", "save", "t", "--json"]);
        let answer = json(&output);
        let told = answer["error"]["code"].as_str().unwrap_or("none");
        assert_eq!(code(&output), 3, "{}", stderr(&output));
        assert!(word.contains(&told), "{answer}");
        let list = scopeservo(dir.path(), &["target", "list", "--json"]);
        assert_eq!(json(&list)["targets"].as_array().map(Vec::len), Some(0));
    }
    describe(dir.path(), BY_HAND);
    let moved = scopeservo(dir.path(), &["target", "save", "moved", "--json"]);
    assert!(
        json(&moved)["moved_features"].as_u64().unwrap() > 300,
        "{}",
        stderr(&moved)
    );
    let text = std::fs::read_to_string(dir.path().join("scopeservo.toml")).unwrap();
    std::fs::write(
        dir.path().join("scopeservo.toml"),
        format!("{text}[target]\nstill = true\n"),
    )
    .unwrap();
    let still = scopeservo(dir.path(), &["target", "save", "still", "--json"]);
    assert_eq!(code(&still), 0, "{}", stderr(&still));
    assert!(json(&still)["moved_features"].is_null());
}

/// Soft shadows close together, the camera's noise, and a few cells.
fn behind_soft_dust(noise: u64, cells: u64) -> Vec<u8> {
    let mut gray = glass(noise);
    let mut at = Numbers(9);
    let shadows: Vec<[f64; 3]> = (0..400)
        .map(|_| {
            [
                at.below(SIZE[0]) as f64,
                at.below(SIZE[1]) as f64,
                3.0 + at.below(7) as f64,
            ]
        })
        .collect();
    for (k, value) in gray.iter_mut().enumerate() {
        let p = [(k % SIZE[0]) as f64, (k / SIZE[0]) as f64];
        let light: f64 = shadows
            .iter()
            .map(|[x, y, r]| {
                1.0 - 0.3 * (-((p[0] - x).powi(2) + (p[1] - y).powi(2)) / (2.0 * r * r)).exp()
            })
            .product();
        *value = (f64::from(*value) * light) as u8;
    }
    let mut at = Numbers(cells);
    for _ in 0..25 {
        let place = [0, 1].map(|k| at.below(SIZE[k]) as i64);
        disc(&mut gray, place, 7, 60);
    }
    gray
}

#[test]
fn two_nearly_empty_places_behind_soft_dust_all_over_are_suspect_and_one_of_them_is_found() {
    let dir = tempfile::tempdir().unwrap();
    save(dir.path(), "view.png", behind_soft_dust(1, 3));
    save(dir.path(), "target.png", behind_soft_dust(2, 4));
    let (exit, answer) = register(dir.path(), &[]);
    assert_eq!(
        (exit, answer["verdict"].as_str()),
        (3, Some("suspect")),
        "{answer}"
    );
    save(dir.path(), "target.png", behind_soft_dust(2, 3));
    let (exit, answer) = register(dir.path(), &[]);
    assert_eq!(
        (exit, answer["verdict"].as_str()),
        (0, Some("found")),
        "{answer}"
    );
}
