//! The whole engine on an image so small that Miri gets through it: `checks/check.sh miri`.

use scopeservo_sift::{
    Gate, GrayImage, Level, MatchOptions, Options, Sift, Simd, match_features_at,
};

#[test]
fn a_small_image_at_every_level() {
    // No threads: Miri does not know the casts of rayon's queues.
    let here = rayon::ThreadPoolBuilder::new().num_threads(1);
    let _here = here.use_current_thread().build_global();
    let blob = |x: f32, y: f32| (-((x - 9.3).powi(2) + (y - 10.4).powi(2)) / 12.0).exp();
    let image = GrayImage::from_fn(24, 20, |x, y| {
        let (x, y) = (x as f32, y as f32);
        blob(x, y) + 0.7 * blob(0.8 * x - 4.0, y) + 0.01 * x
    });
    let image = image.unwrap();
    for first_octave in if cfg!(miri) { 0..1 } else { -1..1 } {
        let options = Options {
            first_octave,
            intervals: 2,
            ..Options::default()
        };
        let mut counts = Vec::new();
        // `SIFT_LEVEL` picks one: at this pace each is a matter of minutes.
        let wanted = std::env::var("SIFT_LEVEL").ok();
        for simd in Simd::available() {
            if wanted
                .as_ref()
                .is_some_and(|w| *w != simd.level().to_string())
            {
                continue;
            }
            let features = Sift::with(options.clone(), simd)
                .unwrap()
                .detect_and_describe(&image);
            features.check().unwrap();
            let (all, open) = (MatchOptions::default(), Gate::default());
            let matches = match_features_at(simd, &features, &features, &all, &open);
            assert!(
                matches
                    .iter()
                    .all(|m| m.query == m.train && m.distance_sq == 0)
            );
            counts.push(features.len());
        }
        assert!(
            !counts.is_empty(),
            "no level {wanted:?} here; there are {:?}",
            Level::ALL
        );
        assert!(
            counts.iter().all(|n| *n > 0 && *n == counts[0]),
            "{counts:?}"
        );
    }
}
