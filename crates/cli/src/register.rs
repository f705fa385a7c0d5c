//! `scopeservo register`: one image found in another.

use crate::answer::Answer;
use crate::args::RegisterArgs;
use crate::colour::{self, Hope};
use crate::error::CliError;
use crate::images::{load_both, reduced_from_full};
use crate::output::RegisterJson;
use crate::threads::with_threads;
use scopeservo_features::{Engine, FeatureError, Features};
use scopeservo_geometry::{Affine2, Mat2};
use scopeservo_registration::{
    Allow, Estimate, NotFound, Options, PictureVerdict, Prior, Rival, register, register_pictures,
};
use serde_json::json;
use std::time::Instant;

/// Of fewer features nobody can say how fine they are.
const ENOUGH_TO_JUDGE: usize = 8;
/// How many times wider the finest details of a blurred image are, at least.
const MUCH_SOFTER: f32 = 2.5;
/// Repetitions beyond this tell nothing more.
const MAX_REPETITIONS: usize = 10_000;

pub(crate) fn run(args: &RegisterArgs, answer: &Answer) -> Result<bool, CliError> {
    if args.features == 0 {
        return Err(CliError::Usage(
            "--features must be at least 1; 2000 suits most images".into(),
        ));
    }
    if args
        .time
        .is_some_and(|n| !(1..=MAX_REPETITIONS).contains(&n))
    {
        return Err(CliError::Usage(format!(
            "--time must be from 1 to {MAX_REPETITIONS} repetitions; 50 suits most images"
        )));
    }
    with_threads(args.threads, || look(args, answer))
}

fn look(args: &RegisterArgs, answer: &Answer) -> Result<bool, CliError> {
    let [loaded_view, loaded_target] = load_both(args)?;
    let (view, target) = (&loaded_view.image, &loaded_target.image);
    let (engine, most) = (Engine::default(), args.features);
    let target_features = engine.features(target, most)?;
    let (prior, options) = (Prior::default(), Options::default());
    // First the times, which warm the caches for nobody else.
    let once = |_| {
        let start = Instant::now();
        let features = engine.features(view, most)?;
        register(&*engine, &features, &target_features, &prior, &options);
        Ok(start.elapsed().as_secs_f64() * 1e3)
    };
    let times = args.time.map(|n| (0..n).map(once).collect());
    let times: Option<Vec<f64>> = times.transpose().map_err(|e: FeatureError| e)?;
    let ms = times.map(|times| median(times.into_iter()));
    let features = engine.features(view, most)?;
    let allow = Allow {
        same_place: args.same_place,
        mirror: args.mirror,
    };
    let (seen, verdict) = register_pictures(
        (&*engine, most),
        (view, &features),
        (target, &target_features),
        &prior,
        &options,
        allow,
    )?;

    let info = engine.info();
    let mut json = RegisterJson {
        verdict: "not_found",
        reason: String::new(),
        message: String::new(),
        target_from_view: None,
        other_target_from_view: None,
        mirrored: false,
        inliers: seen.inliers,
        sigma_px: None,
        scale: None,
        rotation_deg: None,
        matches: seen.matches,
        keypoints: [features.len(), target_features.len()],
        log10_false_alarms: seen.log10_nfa,
        reduced: [loaded_view.factor, loaded_target.factor],
        level: [loaded_view.level, loaded_target.level],
        um_per_px: [loaded_view.um_per_px, loaded_target.um_per_px],
        choices: [loaded_view.choices, loaded_target.choices],
        ms,
        engine: info.name,
        cpu_level: info.cpu_level,
    };
    let full = Full {
        view_factor: loaded_view.factor,
        target_factor: loaded_target.factor,
    };
    tell(&mut json, &verdict, seen.inliers, &full)?;
    if let (PictureVerdict::NotFound(_), Some(why)) =
        (&verdict, blurred([&features, &target_features]))
    {
        json.message = format!("{}. {why}", json.message);
    }
    let found = json.verdict == "found";
    answer.put(json!(json));
    show(answer, &json);
    Ok(found)
}

/// From the images as they were looked at to the images as they are.
struct Full {
    view_factor: usize,
    target_factor: usize,
}

impl Full {
    fn transform(&self, reduced: &Affine2) -> Result<Affine2, CliError> {
        Ok(reduced_from_full(self.target_factor)
            .inverse()
            .ok_or_else(|| CliError::Internal("a reduction has no inverse".into()))?
            .after(reduced)
            .after(&reduced_from_full(self.view_factor)))
    }
}

/// Scale, and rotation in degrees: of a mirror image that of the view turned over from left to right.
fn pose(transform: &Affine2) -> (f64, f64) {
    let linear = transform.linear;
    let upright = match linear.det() < 0.0 {
        true => linear * Mat2::diagonal(-1.0, 1.0),
        false => linear,
    };
    let angle = upright.rotation_angle().unwrap_or(0.0);
    (linear.det().abs().sqrt(), angle.to_degrees())
}

/// Puts the verdict into the answer.
fn tell(
    json: &mut RegisterJson,
    verdict: &PictureVerdict,
    inliers: usize,
    full: &Full,
) -> Result<(), CliError> {
    let mut see = |estimate: &Estimate| -> Result<(Affine2, String), CliError> {
        let transform = full.transform(&estimate.target_from_view)?;
        let (scale, angle) = pose(&transform);
        let sigma = estimate.sigma_px * full.target_factor as f64;
        json.target_from_view = Some(transform);
        json.sigma_px = Some(sigma);
        json.scale = Some(scale);
        json.rotation_deg = Some(angle);
        let words = format!(
            "{inliers} places agree: scale {scale:.5}, rotation {angle:.3} deg, the view's centre known to {sigma:.3} px"
        );
        Ok((transform, words))
    };
    match verdict {
        PictureVerdict::Found { estimate, mirrored } => {
            let (_, words) = see(estimate)?;
            json.verdict = "found";
            json.reason = "agreement".into();
            json.mirrored = *mirrored;
            json.message = match mirrored {
                true => format!("as a mirror image, {words}"),
                false => words,
            };
        }
        PictureVerdict::Suspect {
            estimate,
            share,
            contradicted,
        } => {
            see(estimate)?;
            json.verdict = "suspect";
            json.reason = "suspect".into();
            json.message = format!(
                "{inliers} places agree where they are in the image, but only {:.0} % of the image is alike, and {:.0} % of what either image \
                 shows is not in the other: dust on the camera, a reticle or burnt-in text do that. If both show the same place, say so \
                 with --same-place",
                100.0 * share,
                100.0 * contradicted
            );
        }
        PictureVerdict::Ambiguous { estimate, rival } => {
            let (here, _) = see(estimate)?;
            let there = full.transform(&rival.target_from_view)?;
            json.verdict = "ambiguous";
            json.reason = "ambiguous".into();
            json.other_target_from_view = Some(there);
            json.message = two_places(rival, &here, &there);
        }
        PictureVerdict::Mirrored { estimate } => {
            let (scale, angle) = pose(&full.transform(&estimate.target_from_view)?);
            json.reason = "mirrored".into();
            json.mirrored = true;
            json.message = format!(
                "the view is there as a mirror image only: {inliers} places agree, scale {scale:.5}, rotation {angle:.3} deg. Turn it over, or \
                 accept it with --mirror"
            );
        }
        PictureVerdict::NotFound(reason) => {
            json.reason = code(reason).into();
            json.message =
                format!("{reason}. If both show the same place, give sharper or larger images");
        }
    }
    Ok(())
}

/// Where the view's corner lies in the target, twice, and how far that is.
fn two_places(rival: &Rival, here: &Affine2, there: &Affine2) -> String {
    let at = |t: &Affine2| format!("{:.0}, {:.0} px", t.offset[0], t.offset[1]);
    let turned = match rival.turn_rad.to_degrees() {
        deg if deg.abs() >= 0.5 => format!(", turned by {deg:.0} deg"),
        _ => String::new(),
    };
    format!(
        "the view's first pixel may lie at {} or at {}{turned}, and nothing tells which: give images with something that is there only once",
        at(here),
        at(there)
    )
}

fn show(answer: &Answer, json: &RegisterJson) {
    for (name, factor) in [("view", json.reduced[0]), ("target", json.reduced[1])] {
        if factor > 1 {
            say!(
                answer,
                "{name} reduced {factor} times to look; coordinates are full-resolution"
            );
        }
    }
    for (k, name) in ["view", "target"].into_iter().enumerate() {
        if let Some(choices) = &json.choices[k] {
            say!(answer, "{name} has {choices} (--page, --channel)");
        }
        if let Some(um) = json.um_per_px[k] {
            say!(
                answer,
                "{name}: {um:.4} um per pixel at level {}",
                json.level[k]
            );
        }
    }
    let hope = match json.verdict {
        "found" => Hope::Held,
        "not_found" => Hope::Failed,
        _ => Hope::Partly,
    };
    let verdict = colour::verdict(&json.verdict.replace('_', " "), hope);
    say!(answer, "{verdict}: {}", json.message);
    for t in json
        .target_from_view
        .iter()
        .chain(&json.other_target_from_view)
    {
        for row in <[[f64; 3]; 2]>::from(*t) {
            say!(
                answer,
                "  [{:12.7} {:12.7} {:12.3}]",
                row[0],
                row[1],
                row[2]
            );
        }
    }
    if let Some(ms) = json.ms {
        let ([view, target], threads) = (json.keypoints, rayon::current_num_threads());
        say!(
            answer,
            "{ms:.2} ms for {view} features of the view, match with {target} of the target, and fit ({}, threads: {threads})",
            json.cpu_level
        );
    }
}

fn code(reason: &NotFound) -> &'static str {
    match reason {
        NotFound::TooFewFeatures { .. } => "too_few_features",
        NotFound::NotComparable { .. } => "not_comparable",
        NotFound::TooFewMatches { .. } => "too_few_matches",
        NotFound::NoAgreement { .. } => "no_agreement",
        NotFound::ByChance { .. } => "by_chance",
        NotFound::PixelsDisagree { .. } => "pixels_disagree",
        NotFound::Mirrored { .. } => "mirrored",
        NotFound::Uncertain { .. } => "uncertain",
    }
}

/// The middle one, or the mean of the middle two.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    (sorted[(n - 1) / 2] + sorted[n / 2]) / 2.0
}

/// Where the finest details of one image are much wider than those of the other, px: that is a reason not to find it.
fn blurred([view, target]: [&Features; 2]) -> Option<String> {
    let finest = |features: &Features| {
        let mut sigmas: Vec<f32> = features.keypoints.iter().map(|k| k.sigma).collect();
        let rank = sigmas.len() / 10;
        (sigmas.len() >= ENOUGH_TO_JUDGE)
            .then(|| 2.0 * *sigmas.select_nth_unstable_by(rank, f32::total_cmp).1)
    };
    let (v, t) = (finest(view)?, finest(target)?);
    let (name, soft, other, sharp) = match v > t {
        true => ("view", v, "target", t),
        false => ("target", t, "view", v),
    };
    (soft > MUCH_SOFTER * sharp).then(|| {
        format!(
            "The {name} is blurred beside the {other}: its finest details are {soft:.0} px across, those of the {other} {sharp:.0} px. Focus it, or \
             give the {other} from the same focus"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_lies_in_the_middle() {
        assert_eq!(median([3.0, 1.0, 9.0].into_iter()), 3.0);
        assert_eq!(median([3.0, 1.0, 9.0, 5.0].into_iter()), 4.0);
        assert_eq!(median([2.0].into_iter()), 2.0);
    }
}
