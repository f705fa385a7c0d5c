//! A second engine in one file, and the suite that both pass.

use scopeservo_features::conformance::{Check, check_engine};
use scopeservo_features::{
    Descriptors, EngineInfo, FeatureEngine, FeatureError, Features, GrayImage, SiftEngine,
};
use scopeservo_sift::Options;

/// The places of SIFT, described by which of neighbouring means is the greater: bits instead of bytes.
#[derive(Debug, Default)]
struct Steps(SiftEngine);

impl FeatureEngine for Steps {
    fn name(&self) -> &str {
        "steps"
    }

    fn info(&self) -> EngineInfo {
        EngineInfo {
            name: "steps 1".into(),
            cpu_level: "scalar".into(),
        }
    }

    fn features(&self, image: &GrayImage, most: usize) -> Result<Features, FeatureError> {
        let found = self.0.features(image, most)?;
        let Descriptors::Bytes { length, data } = &found.descriptors else {
            unreachable!("SIFT has bytes");
        };
        let bits = data.chunks_exact((*length).max(1)).flat_map(|d| {
            (0..*length / 4).map(move |byte| {
                (0..8).fold(0, |bits, bit| {
                    let at = |i: usize| d[(4 * byte + i) % length];
                    bits | u8::from(at(bit) > at(bit + 8 * (bit % 2) + 1)) << bit
                })
            })
        });
        Ok(Features {
            engine: "steps".into(),
            descriptors: Descriptors::Bits {
                length: 32,
                data: bits.collect(),
            },
            ..found
        })
    }
}

fn all_hold(checks: &[Check]) {
    let broken: Vec<&Check> = checks.iter().filter(|c| c.outcome.is_err()).collect();
    assert!(broken.is_empty(), "{broken:#?}");
}

#[test]
fn sift_conforms() {
    all_hold(&check_engine(&SiftEngine::default()));
}

#[test]
fn an_engine_is_one_file_and_one_function() {
    all_hold(&check_engine(&Steps::default()));
}

#[test]
fn a_large_image_has_quick_features_without_the_finest() {
    // Spots of a sigma of 3 pixels, each of its own brightness.
    let spots = |width: usize, height: usize| {
        let value = |x: usize, y: usize| {
            let cell = (x / 24 + 31 * (y / 24)) % 17;
            let off = [x % 24, y % 24].map(|v| v as f32 - 11.5);
            let sq = off[0] * off[0] + off[1] * off[1];
            0.3 + 0.04 * cell as f32 * (-sq / 18.0).exp()
        };
        let data = (0..width * height).map(|i| value(i % width, i / width));
        GrayImage::new(width, height, data.collect()).unwrap()
    };
    let engine = SiftEngine::default();
    assert_eq!(engine.quick_features(&spots(640, 480), 500), None);
    let large = spots(1500, 1000);
    let quick = engine.quick_features(&large, 500).unwrap().unwrap();
    let from_itself = SiftEngine::new(Options {
        first_octave: 0,
        ..Options::default()
    });
    assert_eq!(quick, from_itself.features(&large, 500).unwrap());
    assert_eq!(quick.engine, engine.name());
    assert!(quick.len() >= 400, "{}", quick.len());
    // There is nothing to leave out.
    assert_eq!(from_itself.quick_features(&large, 500), None);
}

/// Breaks one rule at a time.
#[derive(Debug)]
struct Broken(&'static str, SiftEngine);

impl FeatureEngine for Broken {
    fn name(&self) -> &str {
        "sift"
    }

    fn info(&self) -> EngineInfo {
        self.1.info()
    }

    fn features(&self, image: &GrayImage, most: usize) -> Result<Features, FeatureError> {
        let most = if self.0 == "too many" { 2 * most } else { most };
        let mut found = self.1.features(image, most)?;
        match self.0 {
            "half a pixel grid" => found.keypoints.iter_mut().for_each(|k| {
                k.x *= 0.93;
            }),
            "no angles" => found.keypoints.iter_mut().for_each(|k| k.angle = 0.0),
            "no sizes" => found.keypoints.iter_mut().for_each(|k| k.sigma = 2.0),
            "a name for each size" => found.engine = format!("sift {}", image.width()),
            "counts on 8 bits" if image.data().iter().any(|v| *v > 1.0) => {
                found = found.subset(&[]);
            }
            "lost a descriptor" if !found.is_empty() => {
                found.keypoints.pop();
            }
            _ => {}
        }
        Ok(found)
    }
}

#[test]
fn a_broken_engine_is_told_by_what_it_breaks() {
    for (rule, check) in [
        ("too many", "gives_the_strongest_and_no_more"),
        ("half a pixel grid", "finds_known_warps_again"),
        ("no angles", "finds_known_warps_again"),
        ("no sizes", "finds_known_warps_again"),
        ("a name for each size", "takes_tiny_pictures"),
        ("counts on 8 bits", "sees_the_same_in_16_bits"),
        ("lost a descriptor", "finds_known_warps_again"),
    ] {
        let checks = check_engine(&Broken(rule, SiftEngine::default()));
        let failed: Vec<&str> = checks
            .iter()
            .filter(|c| c.outcome.is_err())
            .map(|c| c.name)
            .collect();
        assert!(failed.contains(&check), "{rule}: {failed:?}");
    }
}
