//! Corner error of the registration on known warps.
//!
//! `cargo run --release -p scopeservo-studies --example warps -- [PAIRS_PER_CELL] [IMAGE:PITCH ...]`
//!
//! Without images, the three large specimens of `SCOPESERVO_SPECIMENS` are used.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

use scopeservo_features::{Engine, Features};
use scopeservo_registration::{Options, Prior, register};
use scopeservo_slide::Slide;
use scopeservo_studies::warp::{Pair, SIZE, Source, random_pair};
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
    println!(
        "image zoom settings pairs found median_px p90_px worst_px median_inliers error_over_sigma"
    );
    for path in &paths {
        let gray = Slide::open(path)?.read_gray(0)?;
        let source = Source {
            width: gray.width,
            height: gray.height,
            data: gray.data,
        }
        .landscape();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        for (zoom, pitch) in [(1.0, 2.0), (2.0, 1.5), (4.0, 1.0)] {
            let engine = Engine::default();
            let mut tallies = [Tally::default(), Tally::default()];
            for seed in 0..pairs {
                // A place without texture says nothing of accuracy: draw again.
                let Some(pair) = (0..20).find_map(|k| {
                    random_pair(&source, zoom, pitch, 0.008, seed * 1000 + k).filter(textured)
                }) else {
                    continue;
                };
                let [few, many] = [2000, 8000];
                let view = engine.features(&pair.view, few)?;
                // As the program's `register` does it, and as the servo does.
                tallies[0].add(
                    &pair,
                    &view,
                    &engine.features(&pair.target, few)?,
                    &Prior::default(),
                );
                tallies[1].add(
                    &pair,
                    &view,
                    &engine.features(&pair.target, many)?,
                    &pair.prior(),
                );
            }
            for (settings, tally) in ["register", "servo"].into_iter().zip(&tallies) {
                println!("{name} {zoom}:1 {settings} {tally}");
            }
        }
    }
    Ok(())
}

/// What one row of the table says.
#[derive(Default)]
struct Tally {
    made: usize,
    errors: Vec<f64>,
    inliers: Vec<f64>,
    pulls: Vec<f64>,
}

impl Tally {
    fn add(&mut self, pair: &Pair, view: &Features, target: &Features, prior: &Prior) {
        self.made += 1;
        let answer = register(
            &*Engine::default(),
            view,
            target,
            prior,
            &Options::default(),
        );
        self.inliers.push(answer.inliers as f64);
        let Some(found) = answer.found() else { return };
        self.errors.push(pair.corner_error(&found.target_from_view));
        let centre = SIZE.map(|n| (n as f64 - 1.0) / 2.0);
        let (p, q) = (
            found.target_from_view.apply(centre),
            pair.target_from_view.apply(centre),
        );
        let off = f64::hypot(p[0] - q[0], p[1] - q[1]) / std::f64::consts::SQRT_2;
        self.pulls.push(off / found.sigma_px);
    }
}

impl std::fmt::Display for Tally {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let n = self.pulls.len().max(1) as f64;
        let pull = (self.pulls.iter().map(|p| p * p).sum::<f64>() / n).sqrt();
        let [median, p90, worst] = [0.5, 0.9, 1.0].map(|q| quantile(&self.errors, q));
        let inliers = quantile(&self.inliers, 0.5);
        let (made, found) = (self.made, self.errors.len());
        write!(
            f,
            "{made} {found} {median:.4} {p90:.4} {worst:.4} {inliers} {pull:.2}"
        )
    }
}

/// Whether at least a third of the target's blocks show structure.
fn textured(pair: &Pair) -> bool {
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
