//! How often unrelated pictures are taken for each other: other places of one slide, other slides, mirrored copies.
//!
//! `cargo run --release -p scopeservo-studies --example unrelated -- [PAIRS] [CROPS_PER_SLIDE]`
//!
//! Every pair is registered twice: knowing nothing, and knowing the scale as the servo does. Exit code 1 when any pair is
//! found.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

use rayon::prelude::*;
use scopeservo_geometry::SplitMix64;
use scopeservo_registration::{Options, Prior, ScalePrior, register};
use scopeservo_slide::Slide;
use scopeservo_studies::crops::Crop;
use scopeservo_studies::specimens;
use scopeservo_studies::warp::Source;

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
    let answers: Vec<_> = chosen
        .par_iter()
        .map(|&(kind, a, b)| {
            let target = if kind == "mirrored copy" {
                &crops[b].mirrored
            } else {
                &crops[b].features
            };
            let ratio = crops[a].pitch / crops[b].pitch;
            let known = Prior {
                scale: Some(ScalePrior {
                    ratio,
                    tolerance: 0.04,
                }),
                rotation: None,
            };
            let one = |prior: &Prior| {
                let r = register(&crops[a].features, target, prior, &Options::default());
                (r.found().is_some(), r.log10_nfa.unwrap_or(99.0), r.inliers)
            };
            (kind, one(&Prior::default()), one(&known))
        })
        .collect();
    println!(
        "kind pairs found_free found_scale_known least_log10_nfa_free least_log10_nfa_known most_inliers"
    );
    let mut any = 0;
    for kind in ["same slide elsewhere", "another slide", "mirrored copy"] {
        let of: Vec<_> = answers.iter().filter(|a| a.0 == kind).collect();
        let found = |f: &dyn Fn(&(&str, (bool, f64, usize), (bool, f64, usize))) -> bool| {
            of.iter().filter(|a| f(a)).count()
        };
        let (free, known) = (found(&|a| a.1.0), found(&|a| a.2.0));
        any += free + known;
        let least = |f: &dyn Fn(&(&str, (bool, f64, usize), (bool, f64, usize))) -> f64| {
            of.iter().map(|a| f(a)).fold(f64::INFINITY, f64::min)
        };
        println!(
            "{kind}: {} {free} {known} {:.2} {:.2} {}",
            of.len(),
            least(&|a| a.1.1),
            least(&|a| a.2.1),
            of.iter().map(|a| a.1.2.max(a.2.2)).max().unwrap_or(0)
        );
    }
    if any > 0 {
        std::process::exit(1);
    }
    Ok(())
}
