//! How often unrelated images are taken for each other: other places of one slide, other slides, mirrored copies.
//!
//! `cargo run --release -p scopeservo-studies --example unrelated -- [PAIRS] [CROPS_PER_SLIDE]`
//!
//! Every pair is registered twice: knowing nothing, and knowing the scale as the servo does. Exit code 1 when any pair is
//! found.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

use rayon::prelude::*;
use scopeservo_features::Engine;
use scopeservo_geometry::SplitMix64;
use scopeservo_registration::{Options, Prior, Registration, ScalePrior, register};
use scopeservo_slide::Slide;
use scopeservo_studies::crops::Crop;
use scopeservo_studies::specimens;
use scopeservo_studies::warp::Source;

struct Answer {
    kind: &'static str,
    registered: [Registration; 2],
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let pairs: usize = args.next().map_or(Ok(2000), |a| a.parse())?;
    let per_slide: u64 = args.next().map_or(Ok(8), |a| a.parse())?;
    let folder = specimens().ok_or("set SCOPESERVO_SPECIMENS to the folder of slides")?;
    let mut files: Vec<_> = std::fs::read_dir(folder)?
        .filter_map(|e| Some(e.ok()?.path()))
        .filter(|p| p.extension().is_some_and(|x| x != "md"))
        .collect();
    files.sort();
    let mut crops = Vec::new();
    for (slide, path) in files.iter().enumerate() {
        // The two scans of one slide count as one: they show the same tissue.
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        if name == "cytology_scanner_b.tif" {
            continue;
        }
        let gray = Slide::open(path)?.read_gray(0)?;
        let source = Source {
            width: gray.width,
            height: gray.height,
            data: gray.data,
        };
        for k in 0..per_slide {
            let pitch = [1.0, 1.5, 2.0, 3.0][k as usize % 4];
            crops.extend(Crop::draw(
                slide,
                &source,
                pitch,
                3000,
                k * 7919 + slide as u64,
            )?);
        }
    }
    println!("{} windows of {} slides", crops.len(), files.len() - 1);
    let mut rng = SplitMix64::new(1);
    let mut chosen = Vec::new();
    while chosen.len() < pairs {
        let (a, b) = (rng.below(crops.len()), rng.below(crops.len()));
        let (ca, cb) = (&crops[a], &crops[b]);
        // In turn: same slide elsewhere, another slide, a mirrored copy (of itself or of any other).
        let (kind, ok) = match chosen.len() % 3 {
            0 => (
                "same slide elsewhere",
                a != b && ca.slide == cb.slide && !ca.overlaps(cb),
            ),
            1 => ("another slide", ca.slide != cb.slide),
            _ => ("mirrored copy", ca.slide == cb.slide && ca.overlaps(cb)),
        };
        if ok {
            chosen.push((kind, a, b));
        }
    }
    let engine = Engine::default();
    let answers: Vec<Answer> = chosen
        .par_iter()
        .map(|&(kind, a, b)| {
            let (view, other) = (&crops[a], &crops[b]);
            let target = match kind {
                "mirrored copy" => &other.mirrored,
                _ => &other.features,
            };
            let known = Prior {
                scale: Some(ScalePrior {
                    ratio: view.pitch / other.pitch,
                    tolerance: 0.04,
                }),
                rotation: None,
                ..Prior::default()
            };
            let registered = [Prior::default(), known].map(|prior| {
                register(
                    &*engine,
                    &view.features,
                    target,
                    &prior,
                    &Options::default(),
                )
            });
            Answer { kind, registered }
        })
        .collect();
    println!("kind pairs found_knowing_nothing found_knowing_the_scale most_inliers most_matches");
    let mut any = 0;
    for kind in ["same slide elsewhere", "another slide", "mirrored copy"] {
        let of = || answers.iter().filter(|a| a.kind == kind);
        let found = [0, 1].map(|k| of().filter(|a| a.registered[k].found().is_some()).count());
        let most = |f: &dyn Fn(&Registration) -> usize| {
            of().flat_map(|a| a.registered.iter().map(f))
                .max()
                .unwrap_or(0)
        };
        any += found[0] + found[1];
        println!(
            "{kind}: {} {} {} {} {}",
            of().count(),
            found[0],
            found[1],
            most(&|r| r.inliers),
            most(&|r| r.matches)
        );
    }
    if any > 0 {
        std::process::exit(1);
    }
    Ok(())
}
