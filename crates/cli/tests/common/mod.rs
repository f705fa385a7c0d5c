//! Running the program as a user does.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::allow_attributes_without_reason,
    reason = "each test file uses its own part of this module"
)]

pub mod page;
pub mod served;

use image::{GrayImage, ImageBuffer, Luma, Rgba, RgbaImage};
use scopeservo_twin::specimen::{Specimen, Tissue};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Runs `scopeservo` in `folder`.
pub fn scopeservo(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_scopeservo"))
        .current_dir(folder)
        .args(args)
        .output()
        .expect("the program starts")
}

pub fn code(output: &Output) -> i32 {
    output.status.code().expect("the program was not killed")
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

pub fn json(output: &Output) -> serde_json::Value {
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&output.stdout)))
}

/// The answer of a command that does what is hoped for.
pub fn ok(folder: &Path, args: &[&str]) -> serde_json::Value {
    let output = scopeservo(folder, args);
    let told = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(code(&output), 0, "{args:?}: {} {told}", stderr(&output));
    json(&output)
}

/// Exit code 2, one sentence on stderr that names no panic, nothing on stdout, no report.
pub fn assert_bad_input(folder: &Path, args: &[&str]) {
    let output = scopeservo(folder, args);
    let said = stderr(&output);
    assert_eq!(code(&output), 2, "{args:?}: {said}");
    assert!(!said.contains("panicked"), "{args:?}: {said}");
    assert!(said.trim().len() > 20, "{args:?} says too little: {said}");
    assert!(output.stdout.is_empty(), "{args:?} printed on stdout");
    assert!(
        !folder.join("scopeservo-demo/report.html").exists(),
        "{args:?} left a report"
    );
}

/// Grey samples of tissue, 0..=255, `width` x `height` at 0.5 um, centred at a place.
pub fn tissue_gray(seed: u64, centre_um: [f64; 2], width: usize, height: usize) -> Vec<u8> {
    let (w, h) = (width as f64 * 0.5, height as f64 * 0.5);
    let [x, y] = centre_um;
    let patch = Tissue::new(seed)
        .patch(1, [x - w / 2.0, x + w / 2.0], [y - h / 2.0, y + h / 2.0], 2)
        .expect("tissue is everywhere");
    let mut gray = Vec::with_capacity(width * height);
    for row in 0..height {
        for column in 0..width {
            let at = 3 * ((row + 1) * patch.width + column + 1);
            let rgb = &patch.rgb[at..at + 3];
            let luma =
                0.299 * f64::from(rgb[0]) + 0.587 * f64::from(rgb[1]) + 0.114 * f64::from(rgb[2]);
            gray.push(luma.round() as u8);
        }
    }
    gray
}

pub fn save_gray8(path: &Path, width: usize, height: usize, gray: Vec<u8>) -> PathBuf {
    GrayImage::from_raw(width as u32, height as u32, gray)
        .expect("sizes agree")
        .save(path)
        .expect("the folder can be written");
    path.into()
}

/// 16-bit grey with detail below the 8-bit step.
pub fn save_gray16(path: &Path, width: usize, height: usize, gray: &[u8]) {
    let wide: Vec<u16> = gray.iter().map(|&v| u16::from(v) * 257).collect();
    ImageBuffer::<Luma<u16>, _>::from_raw(width as u32, height as u32, wide)
        .expect("sizes agree")
        .save(path)
        .expect("the folder can be written");
}

pub fn save_rgba(path: &Path, width: usize, height: usize, gray: &[u8]) {
    RgbaImage::from_fn(width as u32, height as u32, |x, y| {
        let v = gray[y as usize * width + x as usize];
        Rgba([v, v, v, 255])
    })
    .save(path)
    .expect("the folder can be written");
}

/// A description with the twin's settings changed.
pub fn describe(folder: &Path, twin: &str) {
    let head = "name = \"test bench\"\n[drivers.twin.twin]\nseed = 4\n";
    let devices = "[devices]\nstage = \"twin\"\ncamera = \"twin\"\nnosepiece = \"twin\"\n";
    let change = match twin.contains("\"xy\"") {
        true => "[objective_change]\nanywhere = true\n",
        false => "[objective_change]\nretract_z_um = -2000\nmargin_um = 0\n",
    };
    let text = format!("{head}{twin}\n{devices}{change}");
    std::fs::write(folder.join("scopeservo.toml"), text).expect("the folder can be written");
}
