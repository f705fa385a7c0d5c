//! Our side of the comparison of tracking, correlation and a step by features with OpenCV: a worker that reads one JSON request per line and
//! answers with one line.
//!
//! `python3 crates/studies/peers/alignment.py` starts it and its peer; it is of little use alone.

#![expect(clippy::print_stdout, reason = "a study prints its answers")]

use scopeservo_features::{Engine, GrayImage};
use scopeservo_geometry::{Affine2, Mat2};
use scopeservo_registration::correlation::{Picture, correlate};
use scopeservo_registration::tracking::Tracker;
use scopeservo_registration::{Options, Prior, RotationPrior, ScalePrior, periods, register};
use scopeservo_slide::Slide;
use scopeservo_studies::warp::Source;
use scopeservo_studies::worker::{repeat, text};
use serde_json::{Value, json};
use std::error::Error;
use std::fs;
use std::path::Path;

type Failure = Box<dyn Error + Send + Sync>;
type Answer = Result<Value, Failure>;

fn main() -> Result<(), Failure> {
    let mut source = None;
    for line in std::io::stdin().lines() {
        let answer = answer(&serde_json::from_str(&line?)?, &mut source);
        println!(
            "{}",
            answer.unwrap_or_else(|e| json!({ "error": e.to_string() }))
        );
    }
    Ok(())
}

fn answer(request: &Value, source: &mut Option<(String, Source)>) -> Answer {
    let piece = text(request, "piece")?;
    if piece == "hello" {
        return Ok(json!({ "name": "scopeservo", "version": env!("CARGO_PKG_VERSION") }));
    }
    if piece == "pair" {
        return pair(request, source);
    }
    let threads = request["threads"].as_u64().unwrap_or(1) as usize;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()?;
    let [view, target] = ["view", "target"].map(|key| read_pgm(text(request, key)?));
    let (view, target) = (view?, target?);
    pool.install(|| match piece {
        "track" => track(request, &view, &target),
        "correlate" => Ok(by_correlation(request, &view, &target)),
        "step" => by_features(request, &view, &target),
        other => Err(format!("no piece is called {other}").into()),
    })
}

/// Draws a view and a target, each from the slide: the target turned by `turn_deg`, and the view's centre `off` target pixels from the target's.
fn pair(request: &Value, kept: &mut Option<(String, Source)>) -> Answer {
    let slide = text(request, "slide")?;
    if kept.as_ref().is_none_or(|(name, _)| name != slide) {
        let gray = Slide::open(Path::new(slide))?.read_gray(0)?;
        let source = Source {
            width: gray.width,
            height: gray.height,
            data: gray.data,
        };
        *kept = Some((slide.to_owned(), source.landscape()));
    }
    let (_, source) = kept.as_ref().ok_or("no slide was read")?;
    let size: [usize; 2] = serde_json::from_value(request["size"].clone())?;
    let off: [f64; 2] = serde_json::from_value(request["off"].clone())?;
    let [ratio, turn, pitch] = ["ratio", "turn_deg", "pitch"].map(|k| request[k].as_f64());
    let (ratio, turn, pitch) = (
        ratio.ok_or("no ratio")?,
        turn.ok_or("no angle")?,
        pitch.ok_or("no pitch")?,
    );
    // A little turned, so that no view lies on the source's own grid.
    let middle = [source.width, source.height].map(|n| n as f64 / 2.0);
    let about = |centre: [f64; 2], angle: f64, pitch: f64| {
        let linear = Mat2::rotation(angle) * pitch;
        let moved = linear * size.map(|n| (n as f64 - 1.0) / 2.0);
        Affine2 {
            linear,
            offset: [centre[0] - moved[0], centre[1] - moved[1]],
        }
    };
    let of_view = about(
        [0, 1].map(|k| middle[k] + pitch * off[k]),
        0.2,
        pitch * ratio,
    );
    let of_target = about(middle, 0.2 - turn.to_radians(), pitch);
    let view = source.render_sized(size, &of_view, 0.008, 1);
    let target = source.render_sized(size, &of_target, 0.008, 2);
    write_pgm(text(request, "view")?, &view)?;
    write_pgm(text(request, "target")?, &target)?;
    let target_from_source = of_target.inverse().ok_or("a singular warp")?;
    Ok(json!({ "answer": target_from_source.after(&of_view) }))
}

fn track(request: &Value, view: &GrayImage, target: &GrayImage) -> Answer {
    let mut tracker = Tracker::new(target).ok_or("nothing to follow")?;
    let (ms, found) = repeat(request, || tracker.follow(view));
    Ok(json!({ "ms": ms, "answer": found.ok().map(|e| e.target_from_view) }))
}

fn scale(request: &Value) -> ScalePrior {
    ScalePrior {
        ratio: request["ratio"].as_f64().unwrap_or(1.0),
        tolerance: 0.04,
    }
}

fn by_correlation(request: &Value, view: &GrayImage, target: &GrayImage) -> Value {
    let rotation = request["within_deg"].as_f64().map(|deg| RotationPrior {
        angle_rad: request["around_deg"].as_f64().unwrap_or(0.0).to_radians(),
        tolerance_rad: deg.to_radians(),
    });
    let picture = |image| Picture {
        image,
        counts: None,
    };
    // Those are known of a saved target.
    let periods_px = periods(target);
    let (ms, found) = repeat(request, || {
        correlate(
            &picture(view),
            (&picture(target), &periods_px),
            scale(request),
            rotation,
            &Options::default(),
        )
    });
    let found = found.registration.found().map(|e| e.target_from_view);
    json!({ "ms": ms, "answer": found })
}

/// Features of the view, matches and transform, as the servo's localizer asks for them; those of the target are there.
fn by_features(request: &Value, view: &GrayImage, target: &GrayImage) -> Answer {
    let engine = Engine::default();
    let target = engine.features(target, 8000)?;
    let prior = Prior {
        scale: Some(scale(request)),
        ..Prior::default()
    };
    let (ms, found) = repeat(request, || {
        let quick = scale(request).ratio < 1.5;
        let quick = quick.then(|| engine.quick_features(view, 3000)).flatten();
        let view = quick.unwrap_or_else(|| engine.features(view, 3000))?;
        Ok::<_, Failure>(register(
            &*engine,
            &view,
            &target,
            &prior,
            &Options::default(),
        ))
    });
    Ok(json!({ "ms": ms, "answer": found?.found().map(|e| e.target_from_view) }))
}

/// Binary PGM with 8 bits, without comments: what [`write_pgm`] writes.
fn read_pgm(path: &str) -> Result<GrayImage, Failure> {
    let bytes = fs::read(path)?;
    let mut lines = bytes.splitn(3, |b| *b == b'\n');
    let (Some(b"P5"), Some(size), Some(rest)) = (lines.next(), lines.next(), lines.next()) else {
        return Err(format!("{path} is not a plain 8-bit PGM").into());
    };
    let size: Vec<usize> = str::from_utf8(size)?
        .split(' ')
        .map(str::parse)
        .collect::<Result<_, _>>()?;
    let pixels = rest.strip_prefix(b"255\n").ok_or("no 8-bit PGM")?;
    let data = pixels.iter().map(|&v| f32::from(v) / 255.0).collect();
    Ok(GrayImage::new(size[0], size[1], data)?)
}

fn write_pgm(path: &str, image: &GrayImage) -> std::io::Result<()> {
    let mut bytes = format!("P5\n{} {}\n255\n", image.width(), image.height()).into_bytes();
    bytes.extend(image.data().iter().map(|v| (v * 255.0).round() as u8));
    fs::write(path, bytes)
}
