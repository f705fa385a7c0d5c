//! Our side of the speed comparison: a worker that reads one JSON request per line and answers with one line.
//!
//! `python3 crates/studies/peers/speed.py` starts it and its peers; it is of little use alone. A request names a `piece`, an
//! `image` (8-bit PGM), `threads` and `repetitions`; the answer holds `ms`, one number per repetition, and a `count`.

#![expect(clippy::print_stdout, reason = "a study prints its answers")]

use rayon::{ThreadPool, ThreadPoolBuilder};
use scopeservo_features::{FeatureEngine, FeatureError, SiftEngine};
use scopeservo_geometry::{Affine2, Mat2};
use scopeservo_registration::{Options as RegisterOptions, Prior, register};
use scopeservo_sift::{Features, GrayImage, Keypoint, MatchOptions, Options, Sift, match_features};
use scopeservo_slide::Slide;
use scopeservo_studies::warp::Source;
use scopeservo_studies::worker::{repeat, text};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::error::Error;
use std::fs;
use std::path::Path;

type Answer = Result<Value, Box<dyn Error>>;

fn main() -> Result<(), Box<dyn Error>> {
    let mut worker = Worker::default();
    for line in std::io::stdin().lines() {
        let request: Value = serde_json::from_str(&line?)?;
        let answer = worker
            .answer(&request)
            .unwrap_or_else(|e| json!({ "error": e.to_string() }));
        println!("{answer}");
    }
    Ok(())
}

/// What is kept from request to request, so that only the work is timed.
#[derive(Default)]
struct Worker {
    images: HashMap<String, GrayImage>,
    engines: HashMap<String, Sift>,
    features: HashMap<String, Features>,
    pools: HashMap<usize, ThreadPool>,
    /// The slide read last, for the next crop of it.
    source: Option<(String, Source)>,
}

impl Worker {
    fn answer(&mut self, request: &Value) -> Answer {
        match text(request, "piece")? {
            "hello" => Ok(json!({
                "name": "scopeservo-sift",
                "version": env!("CARGO_PKG_VERSION"),
                "level": Sift::new(Options::default())?.simd().level().to_string(),
            })),
            "crop" => self.crop(request),
            "scan" => {
                // Nothing is as strong as this, so that nothing is refined.
                let options = Options {
                    contrast_threshold: 1e6,
                    adapt_contrast: false,
                    ..Options::default()
                };
                self.timed(request, options, |sift, image, _| sift.detect(image).len())
            }
            "detect" => self.timed(request, options(request), |sift, image, _| {
                sift.detect(image).len()
            }),
            "describe" => self.timed(request, options(request), |sift, image, features| {
                sift.detect_and_describe_into(image, features);
                features.len()
            }),
            "compute" => self.compute(request),
            "match" => self.matches(request),
            "nearest" => self.nearest(request),
            "affine" => self.affine(request),
            other => Err(format!("no piece is called {other}").into()),
        }
    }

    fn timed(
        &mut self,
        request: &Value,
        options: Options,
        work: impl Fn(&mut Sift, &GrayImage, &mut Features) -> usize + Sync,
    ) -> Answer {
        let image = image(&mut self.images, text(request, "image")?)?;
        let sift = engine(&mut self.engines, options)?;
        let pool = pool(&mut self.pools, request)?;
        let mut features = Features::default();
        let (ms, count) = repeat(request, || {
            pool.install(|| work(sift, image, &mut features))
        });
        Ok(json!({ "ms": ms, "count": count }))
    }

    /// Milliseconds to describe every keypoint once, without the scale space: about `many` of the keypoints, each several times,
    /// less each of them once.
    fn compute(&mut self, request: &Value) -> Answer {
        let many = number(request, "many")?.max(1);
        let image = image(&mut self.images, text(request, "image")?)?;
        let sift = engine(&mut self.engines, options(request))?;
        let pool = pool(&mut self.pools, request)?;
        let all = pool.install(|| sift.detect(image));
        let step = all.len().div_ceil(many).max(1);
        let once: Vec<Keypoint> = all.into_iter().step_by(step).collect();
        let times = many.div_ceil(once.len().max(1)).max(2);
        let often = once.repeat(times);
        let mut least = |keypoints: &[Keypoint]| {
            let work = || pool.install(|| sift.describe(image, keypoints));
            let (ms, described) = repeat(request, work);
            described.map(|_| ms.into_iter().fold(f64::INFINITY, f64::min))
        };
        let ms = (least(&often)? - least(&once)?) / (times - 1) as f64;
        Ok(json!({ "ms": [ms], "count": once.len() }))
    }

    /// The `number` strongest features of view and target, both ways.
    fn matches(&mut self, request: &Value) -> Answer {
        let [view, target] = self.strongest(request)?;
        let pool = pool(&mut self.pools, request)?;
        let (ms, count) = repeat(request, || {
            pool.install(|| match_features(&view, &target, &MatchOptions::default()).len())
        });
        Ok(json!({ "ms": ms, "count": count, "features": [view.len(), target.len()] }))
    }

    /// Writes both sets of descriptors to `write`.view and `write`.target as bytes, and to `write`.nearest what we found:
    /// for each query four 32-bit numbers, it, the nearest and the squared distances to it and to the second.
    fn nearest(&mut self, request: &Value) -> Answer {
        let [view, target] = self.strongest(request)?;
        let all = MatchOptions {
            ratio: f32::INFINITY,
            mutual: false,
        };
        let found = match_features(&view, &target, &all);
        let bytes = |f: &Features| {
            f.descriptors
                .iter()
                .flat_map(|d| *d.components())
                .collect::<Vec<u8>>()
        };
        let numbers: Vec<u8> = found
            .iter()
            .flat_map(|m| [m.query as u32, m.train as u32, m.distance_sq, m.second_sq])
            .flat_map(u32::to_le_bytes)
            .collect();
        let write = text(request, "write")?;
        fs::write(format!("{write}.view"), bytes(&view))?;
        fs::write(format!("{write}.target"), bytes(&target))?;
        fs::write(format!("{write}.nearest"), numbers)?;
        Ok(json!({ "count": found.len() }))
    }

    /// Features of the view, matches and transform; those of the target are there.
    fn affine(&mut self, request: &Value) -> Answer {
        let options = options(request);
        let target = self.described(text(request, "target")?, &options)?;
        let view = image(&mut self.images, text(request, "image")?)?;
        let most = options.max_features;
        let engine = SiftEngine::new(options);
        let target = (&target).into();
        let pool = pool(&mut self.pools, request)?;
        let (ms, answer) = repeat(request, || {
            pool.install(|| {
                let (prior, settings) = (Prior::default(), RegisterOptions::default());
                let features = engine.features(view, most)?;
                Ok::<_, FeatureError>(register(&engine, &features, &target, &prior, &settings))
            })
        });
        let answer = answer?;
        let affine = answer.found().map(|e| e.target_from_view);
        Ok(json!({ "ms": ms, "count": answer.inliers, "answer": affine }))
    }

    fn described(&mut self, path: &str, options: &Options) -> Result<Features, Box<dyn Error>> {
        let key = format!("{path} {options:?}");
        if let Some(features) = self.features.get(&key) {
            return Ok(features.clone());
        }
        let image = image(&mut self.images, path)?;
        let features = engine(&mut self.engines, options.clone())?.detect_and_describe(image);
        self.features.insert(key, features.clone());
        Ok(features)
    }

    fn strongest(&mut self, request: &Value) -> Result<[Features; 2], Box<dyn Error>> {
        let number = number(request, "number")?;
        let everything = Options {
            max_features: usize::MAX,
            ..Options::default()
        };
        let mut of = |key| -> Result<Features, Box<dyn Error>> {
            let all = self.described(text(request, key)?, &everything)?;
            Ok(all.subset(&(0..all.len().min(number)).collect::<Vec<_>>()))
        };
        Ok([of("image")?, of("target")?])
    }

    /// Cuts a view out of a slide as it is, and renders a target from the same slide: turned, shifted, with noise of its own.
    fn crop(&mut self, request: &Value) -> Answer {
        let path = text(request, "slide")?;
        if self.source.as_ref().is_none_or(|(p, _)| p != path) {
            let gray = Slide::open(Path::new(path))?.read_gray(0)?;
            let source = Source {
                width: gray.width,
                height: gray.height,
                data: gray.data,
            };
            self.source = Some((path.to_owned(), source));
        }
        let (_, source) = self.source.as_ref().ok_or("no slide was read")?;
        let size = match &request["size"] {
            Value::Null => [source.width, source.height],
            given => serde_json::from_value(given.clone())?,
        };
        let Some((at, busy)) = place(source, size, request["busy"].as_f64().unwrap_or(1.0)) else {
            return Err(format!("{path} is smaller than {} x {}", size[0], size[1]).into());
        };
        let source_from_view = Affine2 {
            linear: Mat2::IDENTITY,
            offset: at.map(|v| v as f64),
        };
        let middle = size.map(|n| (n as f64 - 1.0) / 2.0);
        let linear = Mat2::rotation(0.2);
        let turned = linear * middle;
        let centre = [0, 1].map(|k| at[k] as f64 + middle[k] + [0.05, -0.03][k] * size[k] as f64);
        let source_from_target = Affine2 {
            linear,
            offset: [centre[0] - turned[0], centre[1] - turned[1]],
        };
        let view: Vec<f32> = (0..size[0] * size[1])
            .map(|i| source.data[(at[1] + i / size[0]) * source.width + at[0] + i % size[0]])
            .collect();
        let target = source.render_sized(size, &source_from_target, 0.004, 1);
        write_pgm(text(request, "view")?, size, &view)?;
        write_pgm(text(request, "target")?, size, target.data())?;
        let target_from_source = source_from_target.inverse().ok_or("a singular warp")?;
        Ok(json!({
            "size": size,
            "busy": busy,
            "answer": target_from_source.after(&source_from_view),
        }))
    }
}

fn number(request: &Value, key: &str) -> Result<usize, Box<dyn Error>> {
    let number = request[key].as_u64();
    number
        .map(|n| n as usize)
        .ok_or_else(|| format!("the request has no {key}").into())
}

/// `most` features (all of them when it is missing) from `first_octave` on.
fn options(request: &Value) -> Options {
    Options {
        max_features: request["most"].as_u64().map_or(usize::MAX, |n| n as usize),
        first_octave: request["first_octave"].as_i64().unwrap_or(-1) as i32,
        ..Options::default()
    }
}

fn engine(
    engines: &mut HashMap<String, Sift>,
    options: Options,
) -> Result<&mut Sift, Box<dyn Error>> {
    let sift = Sift::new(options.clone())?;
    Ok(engines.entry(format!("{options:?}")).or_insert(sift))
}

fn pool<'a>(
    pools: &'a mut HashMap<usize, ThreadPool>,
    request: &Value,
) -> Result<&'a ThreadPool, Box<dyn Error>> {
    let threads = request["threads"].as_u64().unwrap_or(1) as usize;
    Ok(match pools.entry(threads) {
        Entry::Occupied(pool) => pool.into_mut(),
        Entry::Vacant(none) => none.insert(ThreadPoolBuilder::new().num_threads(threads).build()?),
    })
}

fn image<'a>(
    images: &'a mut HashMap<String, GrayImage>,
    path: &str,
) -> Result<&'a GrayImage, Box<dyn Error>> {
    if !images.contains_key(path) {
        images.insert(path.to_owned(), read_pgm(path)?);
    }
    Ok(&images[path])
}

/// Binary PGM with 8 bits, without comments: what [`write_pgm`] writes.
fn read_pgm(path: &str) -> Result<GrayImage, Box<dyn Error>> {
    let bytes = fs::read(path)?;
    let mut parts = bytes.splitn(4, u8::is_ascii_whitespace);
    let mut next = || parts.next().ok_or_else(|| format!("{path} is cut short"));
    let magic = next()?;
    let mut number = || -> Result<usize, Box<dyn Error>> { Ok(str::from_utf8(next()?)?.parse()?) };
    let (width, height) = (number()?, number()?);
    let body = next()?.strip_prefix(b"255\n");
    let (b"P5", Some(pixels)) = (magic, body) else {
        return Err(format!("{path} is not a plain 8-bit PGM").into());
    };
    let data = pixels.iter().map(|&v| f32::from(v) / 255.0).collect();
    Ok(GrayImage::new(width, height, data)?)
}

fn write_pgm(path: &str, [w, h]: [usize; 2], data: &[f32]) -> std::io::Result<()> {
    let mut bytes = format!("P5 {w} {h} 255\n").into_bytes();
    bytes.extend(data.iter().map(|v| (v * 255.0).round() as u8));
    fs::write(path, bytes)
}

/// The window whose share of blocks with structure comes nearest to `wanted`, and that share.
fn place(source: &Source, size: [usize; 2], wanted: f64) -> Option<([usize; 2], f64)> {
    const BLOCK: usize = 16;
    const STEP: usize = 4;
    let room = [
        source.width.checked_sub(size[0])?,
        source.height.checked_sub(size[1])?,
    ];
    let across = source.width / BLOCK;
    let busy: Vec<bool> = (0..across * (source.height / BLOCK))
        .map(|i| {
            let (bx, by) = (i % across * BLOCK, i / across * BLOCK);
            let values = (0..BLOCK * BLOCK)
                .map(|k| f64::from(source.data[(by + k / BLOCK) * source.width + bx + k % BLOCK]));
            let (sum, squares) = values.fold((0.0, 0.0), |(s, q), v| (s + v, q + v * v));
            let n = (BLOCK * BLOCK) as f64;
            squares / n - (sum / n).powi(2) > 0.03 * 0.03
        })
        .collect();
    let [w, h] = size.map(|n| (n / BLOCK).max(1));
    let share = |bx: usize, by: usize| {
        let rows = (by..by + h).map(|y| y * across + bx);
        let count: usize = rows
            .map(|i| busy.get(i..i + w).unwrap_or_default())
            .map(|row| row.iter().filter(|b| **b).count())
            .sum();
        count as f64 / (w * h) as f64
    };
    let steps = |k: usize| (0..=room[k] / BLOCK).step_by(STEP);
    steps(1)
        .flat_map(|by| steps(0).map(move |bx| (bx, by)))
        .map(|(bx, by)| ([bx * BLOCK, by * BLOCK], share(bx, by)))
        .min_by(|a, b| (a.1 - wanted).abs().total_cmp(&(b.1 - wanted).abs()))
}
