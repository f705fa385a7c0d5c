//! Corner error of the registration on known warps.
//!
//! `cargo run --release -p scopeservo-studies --example warps -- [PAIRS_PER_CELL] [IMAGE:PITCH ...]`
//!
//! Without images, the three large specimens of `SCOPESERVO_SPECIMENS` are used. Errors over claimed sigmas are root mean squares:
//! 1 where the sigmas are true.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

use scopeservo_features::{Engine, Features};
use scopeservo_geometry::AffineFit;
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
        "image zoom settings pairs found median_px p90_px worst_px median_inliers centre_over_sigma corners_over_sigma angle_over_sigma"
    );
    let zooms = [(1.0, 2.0), (2.0, 1.5), (4.0, 1.0)];
    let mut all: [[Tally; 2]; 3] = Default::default();
    for path in &paths {
        let gray = Slide::open(path)?.read_gray(0)?;
        let source = Source {
            width: gray.width,
            height: gray.height,
            data: gray.data,
        }
        .landscape();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        for ((zoom, pitch), all) in zooms.into_iter().zip(&mut all) {
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
            for ((settings, tally), all) in SETTINGS.into_iter().zip(tallies).zip(all) {
                println!("{name} {zoom}:1 {settings} {tally}");
                all.append(tally);
            }
        }
    }
    for ((zoom, _), tallies) in zooms.into_iter().zip(&all) {
        for (settings, tally) in SETTINGS.into_iter().zip(tallies) {
            println!("all {zoom}:1 {settings} {tally}");
        }
    }
    Ok(())
}

/// As the program's `register` does it, and as the servo does.
const SETTINGS: [&str; 2] = ["register", "servo"];

/// What one row of the table says.
#[derive(Default)]
struct Tally {
    made: usize,
    errors: Vec<f64>,
    inliers: Vec<f64>,
    /// Errors over sigma, squared: of the view's centre, of its corners, of the angle.
    pulls_sq: Vec<[f64; 3]>,
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
        let fit = AffineFit {
            b_from_a: found.target_from_view,
            covariance: found.covariance,
        };
        let off_sq = |at: [f64; 2]| {
            let (p, q) = (fit.b_from_a.apply(at), pair.target_from_view.apply(at));
            let off = f64::hypot(p[0] - q[0], p[1] - q[1]) / fit.sigma_at(at);
            off * off / 2.0
        };
        let [w, h] = SIZE.map(|n| n as f64 - 1.0);
        let corners = [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]];
        let turned = pair.target_from_view.inverse().and_then(|back| {
            let left = fit.b_from_a.after(&back).linear;
            left.rotation_angle()
        });
        let turned = turned.unwrap_or(f64::NAN) / found.sigma_angle_rad;
        self.pulls_sq.push([
            off_sq([w / 2.0, h / 2.0]),
            corners.map(off_sq).iter().sum::<f64>() / 4.0,
            turned * turned,
        ]);
    }

    fn append(&mut self, mut other: Self) {
        self.made += other.made;
        self.errors.append(&mut other.errors);
        self.inliers.append(&mut other.inliers);
        self.pulls_sq.append(&mut other.pulls_sq);
    }
}

impl std::fmt::Display for Tally {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let n = self.pulls_sq.len().max(1) as f64;
        let [centre, corners, angle] =
            [0, 1, 2].map(|k| (self.pulls_sq.iter().map(|p| p[k]).sum::<f64>() / n).sqrt());
        let [median, p90, worst] = [0.5, 0.9, 1.0].map(|q| quantile(&self.errors, q));
        let inliers = quantile(&self.inliers, 0.5);
        let (made, found) = (self.made, self.errors.len());
        write!(
            f,
            "{made} {found} {median:.4} {p90:.4} {worst:.4} {inliers} {centre:.2} {corners:.2} {angle:.2}"
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
