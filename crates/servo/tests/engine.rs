//! Another feature engine and another localizer, a few lines each, in a file of their own.

mod common;

use common::{Listener, PLACE_UM, bench, one_objective, options};
use scopeservo_features::{
    Descriptors, Engine, EngineInfo, FeatureEngine, FeatureError, Features, GrayImage, SiftEngine,
};
use scopeservo_registration::{NotFound, Prior, Rival, ScalePrior};
use scopeservo_servo::{
    Calibrate, CalibrateOptions, Event, Expected, FeatureLocalizer, FixedPlaces, Localizer,
    Measurement, NoSink, Reason, Reposition, RepositionOptions, SaveOptions, SaveTarget, Servo,
    ServoEnd, ServoError, ServoOptions, ServoTask, Target, Verdict, VisionOptions, run,
};
use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The places of SIFT, described by which of their neighbours is the greater.
#[derive(Debug, Default)]
struct Comparisons(SiftEngine);

impl FeatureEngine for Comparisons {
    fn name(&self) -> &str {
        "comparisons"
    }

    fn info(&self) -> EngineInfo {
        self.0.info()
    }

    fn features(&self, image: &GrayImage, most: usize) -> Result<Features, FeatureError> {
        let found = self.0.features(image, most)?;
        let Descriptors::Bytes { data, .. } = &found.descriptors else {
            return Ok(found);
        };
        let bit = |d: &[u8], i: usize| u8::from(d[i % 128] > d[(i + 1 + 8 * (i / 128)) % 128]);
        let byte = |d: &[u8], at: usize| (0..8).fold(0, |b, i| b | bit(d, 8 * at + i) << i);
        let all = data.chunks_exact(128);
        let bits = all.flat_map(|d| (0..64).map(move |at| byte(d, at)));
        Ok(Features {
            engine: "comparisons".into(),
            descriptors: Descriptors::Bits {
                length: 64,
                data: bits.collect(),
            },
            ..found
        })
    }
}

fn with_comparisons() -> RepositionOptions {
    let mut options = options();
    options.vision.engine = Engine::new(Comparisons::default());
    options
}

#[test]
fn a_feature_engine_is_one_file() {
    let bench = bench(one_objective());
    let (target, truth) = bench.save();
    // The target has features of SIFT: they are made again from its image.
    bench.twin.remount(PLACE_UM, [38.0, -24.0], 1.0, false);
    let mut engines = Vec::new();
    let mut sink = Listener(|event: &Event| {
        if let Event::Started { engine, .. } = event {
            engines.push(engine.clone());
        }
    });
    let mut reposition = Reposition::new(target, with_comparisons());
    let outcome = run(&mut reposition, &bench.scope, &mut sink).unwrap();
    assert_eq!(outcome.verdict, Verdict::Arrived, "{}", outcome.message);
    let (um, deg) = bench.error_from(&truth);
    assert!(um <= 1.0 && deg <= 0.02, "{um} um, {deg} deg");
    assert_eq!(engines.len(), 1);
}

#[test]
fn features_made_again_count_only_where_the_specimen_was_seen_to_move() {
    let bench = bench(one_objective());
    bench.save();
    let mut save = SaveTarget::new(SaveOptions::default());
    let target = run(&mut save, &bench.scope, &mut NoSink).unwrap();
    let mask = target.mask.clone().expect("a step aside was made");
    let vision = with_comparisons().vision;
    let localizer = FeatureLocalizer { vision: &vision };
    let ready = localizer.prepare(&target).unwrap();
    assert_eq!(ready.features.engine, "comparisons");
    assert_eq!(ready.moved, Some(ready.features.len()));
    // Every feature that counted lies under the mask, and those made again do, too.
    for features in [&target.features, &ready.features] {
        let under = |k: &scopeservo_features::Keypoint| mask.holds([k.x, k.y].map(f64::from));
        assert!(features.keypoints.iter().all(under));
    }
    // Where nothing was seen to move, nothing is left to look for.
    let (width, height) = (target.features.width, target.features.height);
    let blind = Target {
        mask: Some(scopeservo_features::Mask::of_cells(
            width,
            height,
            8,
            |_| false,
        )),
        ..target.clone()
    };
    assert!(matches!(
        localizer.prepare(&blind),
        Err(ServoError::PoorTarget { features: 0, .. })
    ));
    let outcome = run(
        &mut Reposition::new(blind, with_comparisons()),
        &bench.scope,
        &mut NoSink,
    )
    .unwrap();
    assert_eq!(
        (outcome.verdict, outcome.reason),
        (Verdict::Refused, Reason::BlankTarget)
    );
}

/// Forgets to describe its last keypoint.
#[derive(Debug, Default)]
struct Careless(SiftEngine);

impl FeatureEngine for Careless {
    fn name(&self) -> &str {
        "careless"
    }

    fn info(&self) -> EngineInfo {
        self.0.info()
    }

    fn features(&self, image: &GrayImage, most: usize) -> Result<Features, FeatureError> {
        let mut found = self.0.features(image, most)?;
        if let Descriptors::Bytes { data, .. } = &mut found.descriptors {
            data.truncate(data.len().saturating_sub(128));
        }
        Ok(found)
    }
}

#[test]
fn an_engine_with_a_mistake_is_told_and_nothing_is_kept_of_it() {
    let bench = bench(one_objective());
    let vision = VisionOptions {
        engine: Engine::new(Careless::default()),
        ..VisionOptions::default()
    };
    let saved = Target::save(&bench.scope, &vision, &mut NoSink);
    assert!(
        matches!(&saved, Err(ServoError::Features(e)) if e.to_string().contains("descriptors")),
        "{saved:?}"
    );
}

/// Misses some frames, and keeps the features to itself.
#[derive(Debug)]
struct Forgetful<'a> {
    inner: FeatureLocalizer<'a>,
    asked: AtomicUsize,
}

impl Localizer for Forgetful<'_> {
    fn prepare<'t>(&self, target: &'t Target) -> Result<Cow<'t, Target>, ServoError> {
        self.inner.prepare(target)
    }

    fn locate(
        &self,
        target: &Target,
        view: &GrayImage,
        expected: &Expected<'_>,
    ) -> Result<Result<Measurement, NotFound>, ServoError> {
        if self.asked.fetch_add(1, Ordering::Relaxed) == 1 {
            return Ok(Err(NotFound::NoAgreement { matches: 0 }));
        }
        let seen = self.inner.locate(target, view, expected)?;
        Ok(seen.map(|measured| Measurement {
            features: None,
            ..measured
        }))
    }

    fn rivals(
        &self,
        _: &Target,
        _: &Measurement,
        _: &Expected<'_>,
        _without_identity: bool,
    ) -> Vec<Rival> {
        Vec::new()
    }
}

#[test]
fn a_localizer_is_one_file() {
    let bench = bench(one_objective());
    let (vision, options) = (VisionOptions::default(), ServoOptions::default());
    let (target, truth) = bench.save();
    let objective = bench.scope.gate().objectives()[0].clone();
    let mut calibrate = Calibrate::new(objective, CalibrateOptions::default(), vision.clone());
    let calibration = run(&mut calibrate, &bench.scope, &mut NoSink).unwrap();
    let localizer = Forgetful {
        inner: FeatureLocalizer { vision: &vision },
        asked: AtomicUsize::new(0),
    };
    // At the goal nothing is proved but by a step aside, which needs features that this localizer does not tell.
    for displaced in [[38.0, -24.0], [0.0, 0.0]] {
        bench.twin.remount(PLACE_UM, displaced, 0.0, false);
        let mut lost = 0;
        let mut sink = Listener(|event: &Event| {
            lost += usize::from(matches!(event, Event::Lost { .. }));
        });
        localizer.asked.store(0, Ordering::Relaxed);
        let task = ServoTask {
            target: &target,
            view_calibration: &calibration,
            target_calibration: &calibration,
            vision: &vision,
            options: &options,
            law: None,
            hand_overs: &[],
            localizer: Some(&localizer),
        };
        let end = run(&mut Servo::default().on(&task), &bench.scope, &mut sink).unwrap();
        assert!(matches!(end, ServoEnd::Converged(_)), "{end:?}");
        let (um, _) = bench.error_from(&truth);
        assert!(um <= 1.0, "{um} um");
        assert_eq!(lost, 1);
    }
}

/// SIFT that has a quick way for any image, which keeps so many features.
#[derive(Debug)]
struct Quick {
    all: SiftEngine,
    keeps: usize,
    asked: Arc<AtomicUsize>,
}

impl FeatureEngine for Quick {
    fn name(&self) -> &str {
        self.all.name()
    }

    fn info(&self) -> EngineInfo {
        self.all.info()
    }

    fn features(&self, image: &GrayImage, most: usize) -> Result<Features, FeatureError> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        self.all.features(image, most)
    }

    fn quick_features(
        &self,
        image: &GrayImage,
        most: usize,
    ) -> Option<Result<Features, FeatureError>> {
        Some(self.all.features(image, most.min(self.keeps)))
    }
}

#[test]
fn quick_features_are_asked_at_one_magnification_and_are_enough_or_all_are_looked_for() {
    let bench = bench(one_objective());
    let (target, _) = bench.save();
    let frame = bench.scope.grab().unwrap();
    let view = GrayImage::new(frame.width, frame.height, frame.luminance()).unwrap();
    let fixed = FixedPlaces::default();
    // The ratio, what the quick way keeps, and how often all features are looked for.
    for (ratio, keeps, all) in [(1.0, 1000, 0), (1.0, 40, 1), (1.0, 1, 1), (2.0, 1000, 1)] {
        let asked = Arc::new(AtomicUsize::new(0));
        let vision = VisionOptions {
            engine: Engine::new(Quick {
                all: SiftEngine::default(),
                keeps,
                asked: asked.clone(),
            }),
            ..VisionOptions::default()
        };
        let localizer = FeatureLocalizer { vision: &vision };
        let expected = Expected {
            prior: Prior {
                scale: Some(ScalePrior {
                    ratio,
                    tolerance: 0.03,
                }),
                ..Prior::default()
            },
            fixed: &fixed,
        };
        let seen = localizer.locate(&target, &view, &expected).unwrap();
        assert_eq!(asked.load(Ordering::Relaxed), all, "{ratio} {keeps}");
        assert_eq!(seen.is_ok(), ratio == 1.0, "{ratio} {keeps}: {seen:?}");
        if let Ok(seen) = seen {
            let off = seen.estimate.target_from_view.apply([320.0, 240.0]);
            assert!((off[0] - 320.0).abs() < 0.1 && (off[1] - 240.0).abs() < 0.1);
            let all_agree = seen.registration.inliers;
            assert!(all_agree >= 100, "{all_agree} of {keeps}");
        }
    }
}
