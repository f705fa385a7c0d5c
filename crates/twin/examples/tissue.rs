//! Draws a field of the procedural tissue, or of an image file, as a PNG.
//!
//! `cargo run --release --example tissue -- 328 242 0.25 out.png [x_um y_um] [seed | file.png um_per_px]`
#![allow(clippy::print_stdout, reason = "a program for people")]

use std::time::Instant;

use scopeservo_twin::specimen::{FileSpecimen, Specimen, Tissue, texture_share};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let number = |k: usize, default: f64| args.get(k).map_or(Ok(default), |a| a.parse::<f64>());
    let (w, h, spacing) = (number(0, 328.0)?, number(1, 242.0)?, number(2, 0.25)?);
    let out = args.get(3).map_or("tissue.png", String::as_str);
    let (x, y) = (number(4, 0.0)?, number(5, 0.0)?);
    let specimen: Box<dyn Specimen> = match args.get(6) {
        Some(file) if file.parse::<u64>().is_err() => Box::new(FileSpecimen::open(
            file.as_ref(),
            args.get(7).map(|a| a.parse()).transpose()?,
        )?),
        seed => Box::new(Tissue::new(seed.map_or(Ok(1), |s| s.parse())?)),
    };
    let level = (spacing / specimen.finest_um()).log2().round().max(0.0) as usize;
    let start = Instant::now();
    let patch = specimen.patch(
        level,
        [x - w / 2.0, x + w / 2.0],
        [y - h / 2.0, y + h / 2.0],
        0,
    )?;
    let first = start.elapsed();
    let start = Instant::now();
    let again = specimen.patch(
        level,
        [x - w / 2.0, x + w / 2.0],
        [y - h / 2.0, y + h / 2.0],
        0,
    )?;
    assert_eq!(patch, again);
    println!("{}", specimen.describe());
    println!(
        "{} x {} samples of {} um: {first:.1?}, again {:.1?}",
        patch.width,
        patch.height,
        patch.spacing_um,
        start.elapsed()
    );
    println!(
        "textured {:.3}",
        texture_share(specimen.as_ref(), [x, y], [w.min(330.0), h.min(245.0)])?
    );
    let (width, height) = (patch.width as u32, patch.height as u32);
    image::save_buffer(out, &patch.rgb, width, height, image::ColorType::Rgb8)?;
    Ok(())
}
