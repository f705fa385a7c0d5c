//! Corner error of the registration on known warps.
//!
//! `cargo run --release -p scopeservo-studies --example warps -- [PAIRS_PER_CELL] [IMAGE:PITCH ...]`
//!
//! Without images, the three large specimens of `SCOPESERVO_SPECIMENS` are used.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

use scopeservo_registration::{Options, register};
use scopeservo_sift::detect_and_describe;
use scopeservo_slide::Slide;
use scopeservo_studies::warp::{Source, random_pair};
use scopeservo_studies::{quantile, specimens};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let pairs: u64 = std::env::args().nth(1).map_or(Ok(20), |a| a.parse())?;
    let images: Vec<String> = std::env::args().skip(2).collect();
    let paths: Vec<std::path::PathBuf> = if images.is_empty() {
        let folder = specimens()
            .ok_or("set SCOPESERVO_SPECIMENS to the folder of slides, or name images")?;
        [
            "carcinoma_he.png",
            "embryo_section.png",
            "cytology_scanner_a.tif",
        ]
        .map(|f| folder.join(f))
        .to_vec()
    } else {
        images.iter().map(Into::into).collect()
    };
    println!("image zoom pairs found median_px p90_px worst_px median_inliers sigma_ratio");
    for path in &paths {
        let gray = Slide::open(path)?.read_gray(0)?;
        let source = Source {
            width: gray.width,
            height: gray.height,
            data: gray.data,
        };
        for (zoom, pitch) in [(1.0, 2.0), (2.0, 1.5), (4.0, 1.0)] {
            let (mut errors, mut inliers, mut pulls, mut made) = (vec![], vec![], vec![], 0);
            for seed in 0..pairs {
                // A place without texture says nothing of accuracy: draw again.
                let Some(pair) = (0..20).find_map(|k| {
                    random_pair(&source, zoom, pitch, 0.008, seed * 1000 + k).filter(textured)
                }) else {
                    continue;
                };
                made += 1;
                let view = detect_and_describe(
                    &pair.view,
                    &scopeservo_sift::Options {
                        max_features: 4000,
                        ..Default::default()
                    },
                )?;
                let target = detect_and_describe(
                    &pair.target,
                    &scopeservo_sift::Options {
                        max_features: 8000,
                        ..Default::default()
                    },
                )?;
                let answer = register(&view, &target, &pair.prior(), &Options::default());
                inliers.push(answer.inliers as f64);
                if let Some(found) = answer.found() {
                    errors.push(pair.corner_error(&found.target_from_view));
                    let c = [(639.0) / 2.0, 479.0 / 2.0];
                    let (p, q) = (
                        found.target_from_view.apply(c),
                        pair.target_from_view.apply(c),
                    );
                    pulls.push(
                        (((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)) / 2.0).sqrt()
                            / found.sigma_px,
                    );
                }
            }
            let rms = (pulls.iter().map(|p| p * p).sum::<f64>() / pulls.len().max(1) as f64).sqrt();
            println!(
                "{} {zoom}:1 {made} {} {:.4} {:.4} {:.4} {} {rms:.2}",
                path.file_name().unwrap_or_default().to_string_lossy(),
                errors.len(),
                quantile(&errors, 0.5),
                quantile(&errors, 0.9),
                quantile(&errors, 1.0),
                quantile(&inliers, 0.5),
            );
        }
    }
    Ok(())
}

/// Whether at least a third of the target's blocks show structure.
fn textured(pair: &scopeservo_studies::warp::Pair) -> bool {
    let (w, h, block) = (pair.target.width(), pair.target.height(), 40);
    let mut busy = 0;
    for by in 0..h / block {
        for bx in 0..w / block {
            let values: Vec<f64> = (0..block * block)
                .map(|i| {
                    f64::from(
                        pair.target
                            .get(bx * block + i % block, by * block + i / block),
                    )
                })
                .collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let variance =
                values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
            busy += usize::from(variance.sqrt() > 0.03);
        }
    }
    busy * 3 > (w / block) * (h / block)
}
