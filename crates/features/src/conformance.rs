//! One suite for every engine: known warps, images without anything to find, tiny ones, 16 bits, threads.
//!
//! Each check returns a sentence on failure. The images are made up: soft spots of many sizes, some of them oblong, drawn at any warp
//! from the same list, so that the truth is known.

use crate::{FeatureEngine, Features, Gate, GrayImage, Match, MatchOptions};

/// The result of one check.
#[derive(Debug, Clone, PartialEq)]
pub struct Check {
    /// What was checked.
    pub name: &'static str,
    /// `Ok`, or what did not hold.
    pub outcome: Result<(), String>,
}

/// So many features are asked for.
const MOST: usize = 400;
/// Size of the images.
const SIDE: [usize; 2] = [320, 240];
/// A match agrees with the warp when it lands so near, pixels.
const NEAR_PX: f64 = 3.0;
/// Of the matches at least this share agrees,
const SHARE: f64 = 0.7;
/// and so many.
const LEAST: usize = 25;
/// Sizes and angles follow a warp within a factor and radians, in the median.
const SIZE_FACTOR: f64 = 1.25;
const ANGLE_RAD: f64 = 0.2;

/// The warps: scale, angle in degrees, offset in pixels.
const WARPS: [(f64, f64, [f64; 2]); 5] = [
    (1.0, 0.0, [7.25, -4.5]),
    (1.0, 33.0, [0.0, 0.0]),
    (1.0, 180.0, [3.0, 5.0]),
    (1.3, -12.0, [10.0, 6.0]),
    (0.8, 100.0, [-4.0, 2.0]),
];

/// Runs the whole suite.
pub fn check_engine(engine: &dyn FeatureEngine) -> Vec<Check> {
    let run = |name, outcome| Check { name, outcome };
    vec![
        run("has_a_name", has_a_name(engine)),
        run("finds_known_warps_again", known_warps(engine)),
        run("finds_nothing_where_nothing_is", nothing(engine)),
        run("takes_tiny_pictures", tiny(engine)),
        run("sees_the_same_in_16_bits", sixteen_bits(engine)),
        run("gives_the_strongest_and_no_more", the_strongest(engine)),
        run("says_the_same_in_every_thread", threads(engine)),
        run("compares_nothing_with_anything", nothing_to_compare(engine)),
        run("refuses_features_of_others", of_others(engine)),
        run("comes_back_from_bytes", from_bytes(engine)),
    ]
}

fn ensure(holds: bool, sentence: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(sentence()) }
}

/// Spots at fixed places: x, y, sigma across and along, angle, brightness.
fn spots() -> impl Iterator<Item = [f64; 6]> {
    let mut state = 1u64;
    let mut next = move || {
        // Knuth's MMIX constants; the upper bits are the good ones.
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 40) as f64 / (1u64 << 24) as f64
    };
    (0..220).map(move |i| {
        let [x, y] = SIDE.map(|side| (1.6 * next() - 0.3) * side as f64);
        let sigma = 1.8 * (1.3 * next()).exp();
        let long = sigma * (1.0 + next());
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        [x, y, sigma, long, 6.3 * next(), sign * (0.2 + 0.3 * next())]
    })
}

/// A similarity about the image's centre.
#[derive(Clone, Copy)]
struct Warp {
    scale: f64,
    angle: f64,
    offset: [f64; 2],
}

const CENTRE: [f64; 2] = [(SIDE[0] - 1) as f64 / 2.0, (SIDE[1] - 1) as f64 / 2.0];
const NO_WARP: Warp = Warp {
    scale: 1.0,
    angle: 0.0,
    offset: [0.0; 2],
};

impl Warp {
    fn apply(&self, p: [f64; 2]) -> [f64; 2] {
        let (s, c) = self.angle.sin_cos();
        let d = [p[0] - CENTRE[0], p[1] - CENTRE[1]];
        [
            CENTRE[0] + self.offset[0] + self.scale * (c * d[0] - s * d[1]),
            CENTRE[1] + self.offset[1] + self.scale * (s * d[0] + c * d[1]),
        ]
    }
}

/// The spots, warped, times `range`.
fn picture(warp: Warp, range: f64) -> Result<GrayImage, String> {
    let mut data = vec![0.5f64; SIDE[0] * SIDE[1]];
    for [x, y, across, along, angle, bright] in spots() {
        let at = warp.apply([x, y]);
        let (s, c) = (angle + warp.angle).sin_cos();
        let (across, along) = (across * warp.scale, along * warp.scale);
        let reach = 4.0 * along;
        let span = |at: f64, side: usize| {
            let first = (at - reach).ceil().clamp(0.0, side as f64);
            first as usize..(at + reach).ceil().clamp(first, side as f64) as usize
        };
        for row in span(at[1], SIDE[1]) {
            for column in span(at[0], SIDE[0]) {
                let d = [column as f64 - at[0], row as f64 - at[1]];
                let u = (c * d[0] + s * d[1]) / along;
                let v = (c * d[1] - s * d[0]) / across;
                data[row * SIDE[0] + column] += bright * (-0.5 * (u * u + v * v)).exp();
            }
        }
    }
    let values = data.iter().map(|v| (v.clamp(0.0, 1.0) * range) as f32);
    GrayImage::new(SIDE[0], SIDE[1], values.collect()).map_err(|e| e.to_string())
}

fn see(engine: &dyn FeatureEngine, image: &GrayImage) -> Result<Features, String> {
    let features = engine.features(image, MOST).map_err(|e| e.to_string())?;
    features.check().map_err(|e| e.to_string())?;
    ensure(
        [features.width, features.height] == [image.width(), image.height()],
        || "the features are of an image of another size".into(),
    )?;
    ensure(features.engine == engine.name(), || {
        format!(
            "the features name {} as their engine, which is {}",
            features.engine,
            engine.name()
        )
    })?;
    Ok(features)
}

fn compare(
    engine: &dyn FeatureEngine,
    query: &Features,
    train: &Features,
) -> Result<Vec<Match>, String> {
    let options = MatchOptions::default();
    let found = engine.matches(query, train, &options, &Gate::default());
    let found = found.map_err(|e| e.to_string())?;
    let exist = |m: &Match| m.query < query.len() && m.train < train.len();
    ensure(found.iter().all(exist), || {
        "a match names a feature that is not there".into()
    })?;
    ensure(found.windows(2).all(|w| w[0].query < w[1].query), || {
        "the matches are not in order of the query, each feature once".into()
    })?;
    Ok(found)
}

fn has_a_name(engine: &dyn FeatureEngine) -> Result<(), String> {
    ensure(
        !engine.name().is_empty() && !engine.info().name.is_empty(),
        || "it has no name".into(),
    )
}

fn known_warps(engine: &dyn FeatureEngine) -> Result<(), String> {
    let first = see(engine, &picture(NO_WARP, 1.0)?)?;
    for (scale, degrees, offset) in WARPS {
        let warp = Warp {
            scale,
            angle: f64::to_radians(degrees),
            offset,
        };
        let second = see(engine, &picture(warp, 1.0)?)?;
        let found = compare(engine, &first, &second)?;
        let said = || format!("scaled by {scale}, turned by {degrees} deg");
        let agreeing: Vec<&Match> = found
            .iter()
            .filter(|m| {
                let (a, b) = (&first.keypoints[m.query], &second.keypoints[m.train]);
                let there = warp.apply([a.x, a.y].map(f64::from));
                f64::hypot(f64::from(b.x) - there[0], f64::from(b.y) - there[1]) <= NEAR_PX
            })
            .collect();
        let (n, all) = (agreeing.len(), found.len());
        ensure(n >= LEAST && n as f64 >= SHARE * all as f64, || {
            format!("{}: {n} of {all} matches agree with the warp", said())
        })?;
        let mut sizes: Vec<f64> = Vec::new();
        let mut turns: Vec<f64> = Vec::new();
        for m in agreeing {
            let (a, b) = (&first.keypoints[m.query], &second.keypoints[m.train]);
            sizes.push(
                (f64::from(b.sigma) / (f64::from(a.sigma) * scale))
                    .ln()
                    .abs(),
            );
            let off = f64::from(b.angle) - f64::from(a.angle) - warp.angle;
            turns.push(off.sin().atan2(off.cos()).abs());
        }
        let (size, turn) = (median(sizes), median(turns));
        ensure(size <= SIZE_FACTOR.ln() && turn <= ANGLE_RAD, || {
            format!(
                "{}: keypoints do not follow, by a factor of {:.2} and {turn:.2} rad",
                said(),
                size.exp()
            )
        })?;
    }
    Ok(())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

fn nothing(engine: &dyn FeatureEngine) -> Result<(), String> {
    for value in [0.0, 0.5, 1.0, 65535.0] {
        let image = GrayImage::from_fn(SIDE[0], SIDE[1], |_, _| value);
        let seen = see(engine, &image.map_err(|e| e.to_string())?)?;
        ensure(seen.is_empty(), || {
            format!(
                "{} features of an image that is {value} everywhere",
                seen.len()
            )
        })?;
    }
    Ok(())
}

fn tiny(engine: &dyn FeatureEngine) -> Result<(), String> {
    for (width, height) in [(1, 1), (1, 40), (40, 1), (3, 2), (8, 8), (15, 17)] {
        let image = GrayImage::from_fn(width, height, |x, y| ((7 * x + 3 * y) % 5) as f32 / 4.0);
        let seen = see(engine, &image.map_err(|e| e.to_string())?);
        seen.map_err(|why| format!("{width} x {height} pixels: {why}"))?;
    }
    Ok(())
}

/// Places of features, so that two lists can be compared.
fn shared(a: &Features, b: &Features) -> usize {
    let near = |p: &&crate::Keypoint| {
        let close = |q: &crate::Keypoint| f32::hypot(p.x - q.x, p.y - q.y) < 0.5;
        b.keypoints.iter().any(close)
    };
    a.keypoints.iter().filter(near).count()
}

fn sixteen_bits(engine: &dyn FeatureEngine) -> Result<(), String> {
    let unit = see(engine, &picture(NO_WARP, 1.0)?)?;
    let wide = see(engine, &picture(NO_WARP, 65535.0)?)?;
    let n = shared(&unit, &wide);
    ensure(n as f64 >= 0.9 * unit.len() as f64, || {
        format!(
            "of {} features of an image from 0 to 1 there are {n} in the same from 0 to 65535",
            unit.len()
        )
    })
}

fn the_strongest(engine: &dyn FeatureEngine) -> Result<(), String> {
    let image = picture(NO_WARP, 1.0)?;
    let all = see(engine, &image)?;
    for most in [1, 10, 50] {
        let some = engine.features(&image, most).map_err(|e| e.to_string())?;
        ensure(some.len() <= most, || {
            format!("{} features where {most} were asked for", some.len())
        })?;
        // Those that one place has several of may be cut off anywhere.
        let n = shared(
            &some,
            &all.subset(&(0..all.len().min(2 * most)).collect::<Vec<_>>()),
        );
        ensure(n as f64 >= 0.8 * some.len() as f64, || {
            format!("the {most} strongest are not the first of all")
        })?;
    }
    Ok(())
}

fn threads(engine: &dyn FeatureEngine) -> Result<(), String> {
    let image = picture(NO_WARP, 1.0)?;
    let alone = see(engine, &image)?;
    let all: Vec<Result<Features, String>> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..4)
            .map(|_| scope.spawn(|| see(engine, &image)))
            .collect();
        let joined = workers.into_iter().map(std::thread::ScopedJoinHandle::join);
        joined
            .map(|r| r.unwrap_or_else(|_| Err("it panicked".into())))
            .collect()
    });
    for other in all {
        ensure(other? == alone, || {
            "another thread saw other features".into()
        })?;
    }
    Ok(())
}

fn nothing_to_compare(engine: &dyn FeatureEngine) -> Result<(), String> {
    let some = see(engine, &picture(NO_WARP, 1.0)?)?;
    let none = Features::none(engine.name(), SIDE[0], SIDE[1]);
    for (query, train) in [(&some, &none), (&none, &some), (&none, &none)] {
        let found = compare(engine, query, train)?;
        ensure(found.is_empty(), || {
            "matches where one side has no features".into()
        })?;
    }
    let same = compare(engine, &some, &some)?;
    let own = same.iter().filter(|m| m.query == m.train).count();
    ensure(own as f64 >= 0.5 * some.len() as f64, || {
        format!("of {} features {own} match themselves", some.len())
    })
}

fn of_others(engine: &dyn FeatureEngine) -> Result<(), String> {
    let ours = see(engine, &picture(NO_WARP, 1.0)?)?;
    let theirs = Features {
        engine: format!("not {}", engine.name()),
        ..ours.clone()
    };
    let found = engine.matches(&ours, &theirs, &MatchOptions::default(), &Gate::default());
    ensure(found.is_err(), || {
        "it compared its features with those of another engine".into()
    })
}

fn from_bytes(engine: &dyn FeatureEngine) -> Result<(), String> {
    let seen = see(engine, &picture(NO_WARP, 1.0)?)?;
    let back = Features::from_bytes(&seen.to_bytes()).map_err(|e| e.to_string())?;
    ensure(back == seen, || {
        "its features do not come back from bytes".into()
    })
}
