//! How often a target is found by correlation, without features: hard pairs of one place, and pairs that show different things.
//!
//! `cargo run --release -p scopeservo-studies --example correlation -- [--count N] [--family NAME] [--out FILE]`
//!
//! A line for each family: right (the target's corners within 12 target pixels of the truth), rough (40), false, ambiguous, not found; the same for
//! features with the same prior, judged as `register` judges two images. Exit code 1 when anything is false.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

mod camera;
mod scenes;

use clap::Parser;
use rayon::prelude::*;
use scenes::{Family, Scene, Specimen, draw};
use scopeservo_features::{Engine, FeatureError};
use scopeservo_geometry::Affine2;
use scopeservo_registration::correlation::{Picture, correlate};
use scopeservo_registration::{
    Allow, Options, PictureVerdict, Prior, ScalePrior, periods, register_pictures,
};
use scopeservo_studies::warp::SIZE;
use scopeservo_studies::{quantile, specimens};
use std::error::Error;
use std::io::Write;
use std::time::Instant;

#[derive(Parser)]
struct Arguments {
    /// Pairs of each family.
    #[arg(long, default_value_t = 60)]
    count: u64,
    /// Only this family.
    #[arg(long)]
    family: Option<String>,
    /// Leave out the features.
    #[arg(long)]
    alone: bool,
    /// A line of CSV for each pair.
    #[arg(long)]
    out: Option<std::path::PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Answer {
    Right,
    Rough,
    False,
    /// Everything agrees where it is on the sensor, as dust does: a run takes that for the specimen only after it has moved.
    Stays,
    Ambiguous,
    NotFound,
}

const ANSWERS: [Answer; 6] = [
    Answer::Right,
    Answer::Rough,
    Answer::False,
    Answer::Stays,
    Answer::Ambiguous,
    Answer::NotFound,
];

/// Corners that lie within this of where they were, pixels, are where they were.
const STAYS_PX: f64 = 1.0;

struct Record {
    family: Family,
    number: u64,
    slide: String,
    spoilt: &'static str,
    zoom: f64,
    busy: f64,
    answer: Answer,
    by_features: Option<Answer>,
    features: usize,
    off_px: Option<f64>,
    centre_px: Option<f64>,
    sigma_px: Option<f64>,
    log10_nfa: Option<f64>,
    inliers: usize,
    blocks: usize,
    peaks: [f32; 2],
    ms: f64,
}

/// Mean distance of the target's corners from where an answer puts what is truly there, and that of the view's centre.
fn off_px(answer: &Affine2, truth: &Affine2) -> Option<[f64; 2]> {
    let back = truth.inverse()?;
    let [w, h] = SIZE.map(|n| n as f64 - 1.0);
    let off = |p: [f64; 2]| {
        let q = answer.apply(back.apply(p));
        f64::hypot(q[0] - p[0], q[1] - p[1])
    };
    let corners = [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]];
    Some([
        corners.into_iter().map(off).sum::<f64>() / 4.0,
        off([w / 2.0, h / 2.0]),
    ])
}

fn judge(scene: &Scene, found: Option<&Affine2>) -> (Answer, Option<[f64; 2]>) {
    let Some(found) = found else {
        return (Answer::NotFound, None);
    };
    let off = scene
        .target_from_view
        .and_then(|truth| off_px(found, &truth));
    let answer = match off {
        Some([off, _]) if off <= 12.0 => Answer::Right,
        Some([off, _]) if off <= 40.0 => Answer::Rough,
        None if off_px(found, &Affine2::IDENTITY).is_some_and(|[off, _]| off <= STAYS_PX) => {
            Answer::Stays
        }
        _ => Answer::False,
    };
    (answer, off)
}

fn record(family: Family, number: u64, scene: &Scene, alone: bool) -> Result<Record, FeatureError> {
    let scale = ScalePrior {
        ratio: scene.zoom,
        tolerance: 0.04,
    };
    let prior = Prior {
        scale: Some(scale),
        ..Prior::default()
    };
    let options = Options::default();
    let picture = |image| Picture {
        image,
        counts: None,
    };
    // Those are known of a saved target.
    let periods_px = periods(&scene.target);
    let start = Instant::now();
    let seen = correlate(
        &picture(&scene.view),
        (&picture(&scene.target), &periods_px),
        scale,
        None,
        &options,
    );
    let ms = start.elapsed().as_secs_f64() * 1e3;
    let found = seen.registration.found();
    let (mut answer, off) = judge(scene, found.map(|e| &e.target_from_view));
    if answer != Answer::NotFound && !seen.rivals.is_empty() {
        answer = Answer::Ambiguous;
    }
    let (mut by_features, mut features) = (None, 0);
    if !alone {
        let engine = Engine::default();
        let most = 3000;
        let (view, target) = (
            engine.features(&scene.view, most)?,
            engine.features(&scene.target, 8000)?,
        );
        let (_, verdict) = register_pictures(
            (&*engine, most),
            (&scene.view, &view),
            (&scene.target, &target),
            &prior,
            &options,
            Allow::default(),
        )?;
        by_features = Some(match &verdict {
            PictureVerdict::Found { estimate, .. } => {
                judge(scene, Some(&estimate.target_from_view)).0
            }
            PictureVerdict::Ambiguous { .. } => Answer::Ambiguous,
            PictureVerdict::Suspect { .. } => Answer::Stays,
            PictureVerdict::Mirrored { .. } | PictureVerdict::NotFound(_) => Answer::NotFound,
        });
        features = target.len();
    }
    Ok(Record {
        family,
        number,
        slide: scene.slide.clone(),
        spoilt: scene.spoilt,
        zoom: scene.zoom,
        busy: scenes::busy(&scene.target),
        answer,
        by_features,
        features,
        off_px: off.map(|o| o[0]),
        centre_px: off.map(|o| o[1]),
        sigma_px: found.map(|e| e.sigma_px),
        log10_nfa: seen.registration.log10_nfa,
        inliers: seen.registration.inliers,
        blocks: seen.registration.matches,
        peaks: seen.peaks,
        ms,
    })
}

fn line(r: &Record) -> String {
    let number = |v: Option<f64>| v.map_or(String::new(), |v| format!("{v:.3}"));
    format!(
        "{:?},{},{},{},{},{:.2},{:?},{},{},{},{},{},{},{},{},{:.3},{:.3},{:.1}",
        r.family,
        r.number,
        r.slide,
        r.spoilt,
        r.zoom,
        r.busy,
        r.answer,
        r.by_features.map_or(String::new(), |a| format!("{a:?}")),
        r.features,
        number(r.off_px),
        number(r.centre_px),
        number(r.sigma_px),
        number(r.log10_nfa),
        r.inliers,
        r.blocks,
        r.peaks[0],
        r.peaks[1],
        r.ms
    )
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    let folder = specimens().ok_or("set SCOPESERVO_SPECIMENS to the folder of slides")?;
    let slides = Specimen::all(&folder)?;
    let mut out = arguments.out.map(std::fs::File::create).transpose()?;
    if let Some(out) = &mut out {
        writeln!(
            out,
            "family,number,slide,spoilt,zoom,busy,answer,by_features,features,off_px,centre_px,sigma_px,log10_nfa,inliers,blocks,peak,second,ms"
        )?;
    }
    println!(
        "family pairs right rough false stays ambiguous not_found | by features | least and greatest log10 of chance"
    );
    let mut wrong = 0;
    for family in Family::EACH {
        if arguments
            .family
            .as_ref()
            .is_some_and(|f| *f != format!("{family:?}"))
        {
            continue;
        }
        let records: Vec<Record> = (0..arguments.count)
            .into_par_iter()
            .filter_map(|n| Some((n, draw(family, &slides, n)?)))
            .map(|(n, scene)| record(family, n, &scene, arguments.alone))
            .collect::<Result<_, _>>()?;
        if let Some(out) = &mut out {
            for r in &records {
                writeln!(out, "{}", line(r))?;
            }
        }
        let counts = |of: &dyn Fn(&Record) -> Option<Answer>| {
            ANSWERS
                .map(|a| records.iter().filter(|r| of(r) == Some(a)).count())
                .map(|n| n.to_string())
                .join(" ")
        };
        let nfa: Vec<f64> = records.iter().filter_map(|r| r.log10_nfa).collect();
        println!(
            "{family:?} {} {} | {} | {:.1} {:.1}",
            records.len(),
            counts(&|r| Some(r.answer)),
            counts(&|r| r.by_features),
            quantile(&nfa, 0.0),
            quantile(&nfa, 1.0)
        );
        // On a lattice every answer is one of many; what matters is that it is not told as the only one.
        let is_wrong =
            |a: Answer| a == Answer::False || family == Family::Lattice && a == Answer::Right;
        let both = records.iter().flat_map(|r| [Some(r.answer), r.by_features]);
        wrong += both.flatten().filter(|&a| is_wrong(a)).count();
    }
    if wrong > 0 {
        std::process::exit(1);
    }
    Ok(())
}
