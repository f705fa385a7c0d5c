use super::*;
use crate::camera_config::{DustConfig, Mark, PatternConfig};
use crate::config::Config;
use scopeservo_scope::Axis;

fn flat(config: &CameraConfig, value: f32) -> Planes {
    std::array::from_fn(|_| vec![value; config.width * config.height])
}

fn plain_optics() -> ObjectiveConfig {
    let mut optics = Config::realistic().optics[0].clone();
    optics.vignetting = 0.0;
    optics.gradient = [0.0; 2];
    optics
}

/// An image of even light, the stage at `x_um`.
fn shown(sensor: &Sensor, value: f32, ms: f64, lit: bool, sequence: u64, x_um: f64) -> Samples {
    let exposure = Exposure {
        ms,
        lit,
        sequence,
        window: &sensor.window(),
        place: &StagePose::default().with_si(Axis::X, x_um * 1e-6),
    };
    sensor.develop(&flat(&sensor.config, value), &plain_optics(), &exposure)
}

fn values(samples: Samples) -> Vec<f64> {
    match samples {
        Samples::U8(v) => v.into_iter().map(f64::from).collect(),
        Samples::U16(v) => v.into_iter().map(f64::from).collect(),
    }
}

fn mean_sd(v: &[f64]) -> (f64, f64) {
    let mean = v.iter().sum::<f64>() / v.len() as f64;
    let var = v.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / v.len() as f64;
    (mean, var.sqrt())
}

fn small() -> CameraConfig {
    CameraConfig {
        width: 160,
        height: 120,
        dust: Vec::new(),
        dead_pixels: 0,
        ..CameraConfig::default()
    }
}

#[test]
fn shot_noise_is_one_to_two_levels_at_mid_grey_and_grows_as_the_root() {
    let config = small();
    let sensor = Sensor::new(&config, 1);
    let noise = |value: f32| {
        let s = shown(&sensor, value, 10.0, true, 1, 0.0);
        mean_sd(&values(s))
    };
    let ((dark, dark_sd), (_, mid_sd), (_, bright_sd)) = (noise(0.02), noise(0.54), noise(0.98));
    assert!((1.0..2.0).contains(&mid_sd), "{mid_sd}");
    assert!(
        dark_sd < 0.7 * mid_sd && mid_sd < 0.85 * bright_sd,
        "{dark_sd} {mid_sd} {bright_sd}"
    );
    assert!((dark - 0.02 * 0.92 * 255.0).abs() < 0.2);
}

#[test]
fn exposure_scales_the_signal_until_it_saturates() {
    let mut config = small();
    config.shot_noise = false;
    config.read_noise_e = 0.0;
    let sensor = Sensor::new(&config, 1);
    let level = |ms: f64| values(shown(&sensor, 0.5, ms, true, 1, 0.0))[777];
    assert_eq!(level(10.0), (0.5f64 * 0.92 * 255.0).round());
    assert_eq!(level(5.0), (0.25f64 * 0.92 * 255.0).round());
    assert_eq!(level(100.0), 255.0);
}

#[test]
fn gain_keeps_the_level_and_raises_the_noise() {
    let noise = |gain: f64| {
        let config = CameraConfig { gain, ..small() };
        let s = shown(&Sensor::new(&config, 1), 0.5, 10.0, true, 1, 0.0);
        mean_sd(&values(s))
    };
    let ((a, a_sd), (b, b_sd)) = (noise(1.0), noise(4.0));
    assert!(
        (a - b).abs() < 0.5 && b_sd > 1.8 * a_sd,
        "{a} {b} {a_sd} {b_sd}"
    );
}

#[test]
fn corners_are_darker_and_one_side_brighter() {
    let config = CameraConfig {
        shot_noise: false,
        read_noise_e: 0.0,
        ..small()
    };
    let mut optics = plain_optics();
    let sensor = Sensor::new(&config, 1);
    let mut at = |vignetting: f64, gradient: [f64; 2], x: usize, y: usize| {
        optics.vignetting = vignetting;
        optics.gradient = gradient;
        let exposure = Exposure {
            ms: 10.0,
            lit: true,
            sequence: 1,
            window: &sensor.window(),
            place: &StagePose::default(),
        };
        values(sensor.develop(&flat(&config, 1.0), &optics, &exposure))[3 * (y * 160 + x)]
    };
    let ratio = at(0.2, [0.0; 2], 0, 0) / at(0.2, [0.0; 2], 80, 60);
    assert!((ratio - 0.8).abs() < 0.02, "{ratio}");
    assert!(at(0.0, [0.06, 0.0], 159, 60) > at(0.0, [0.06, 0.0], 0, 60) + 20.0);
    assert!(at(0.0, [0.0, -0.06], 80, 119) < at(0.0, [0.0, -0.06], 80, 0) - 20.0);
}

#[test]
fn dust_and_dead_pixels_belong_to_the_sensor() {
    let config = CameraConfig {
        dust: vec![DustConfig::default()],
        dead_pixels: 12,
        shot_noise: false,
        read_noise_e: 0.0,
        ..small()
    };
    let develop = |seed: u64, sequence: u64| {
        values(shown(
            &Sensor::new(&config, seed),
            0.8,
            10.0,
            true,
            sequence,
            0.0,
        ))
    };
    let a = develop(3, 1);
    assert_eq!(a, develop(3, 2), "fixed to the sensor");
    assert_ne!(a, develop(4, 1), "each sensor has its own");
    let clean = (0.8f64 * 0.92 * 255.0).round();
    let spoilt = a.iter().filter(|&&v| v == 0.0 || v == 255.0).count();
    assert!((8..=12).contains(&spoilt), "{spoilt}");
    let dusty = a.iter().filter(|&&v| v > 0.0 && v < 0.93 * clean).count() / 3;
    assert!((60..1500).contains(&dusty), "{dusty}");
}

#[test]
fn grey_and_deep_cameras_use_their_range() {
    let config = CameraConfig {
        channels: Channels::Gray,
        bit_depth: 12,
        shot_noise: false,
        read_noise_e: 0.0,
        ..small()
    };
    let s = shown(&Sensor::new(&config, 1), 0.5, 10.0, true, 0, 0.0);
    assert!(matches!(&s, Samples::U16(v) if v.len() == 160 * 120));
    assert_eq!(values(s)[5], (0.5f64 * 0.92 * 4095.0).round());
}

#[test]
fn without_light_only_read_noise_remains() {
    let config = small();
    let s = shown(&Sensor::new(&config, 1), 0.9, 10.0, false, 0, 0.0);
    assert!(mean_sd(&values(s)).0 < 0.5);
}

#[test]
fn the_table_is_normal() {
    let table: Vec<f64> = normal_table().into_iter().map(f64::from).collect();
    let (mean, sd) = mean_sd(&table);
    assert!(mean.abs() < 1e-3 && (sd - 1.0).abs() < 2e-3, "{mean} {sd}");
    // Percentiles of the standard normal distribution.
    for (share, z) in [(0.5, 0.0), (0.8413, 1.0), (0.9772, 2.0), (0.99865, 3.0)] {
        assert!(
            (table[(share * 4096.0) as usize] - z).abs() < 0.01,
            "{share}"
        );
    }
}

/// A camera without noise, as bright as its light.
fn silent() -> CameraConfig {
    CameraConfig {
        channels: Channels::Gray,
        bit_depth: 16,
        white_level: 1.0,
        shot_noise: false,
        read_noise_e: 0.0,
        ..small()
    }
}

/// Shares of full scale.
fn shares(sensor: &Sensor, x_um: f64) -> Vec<f64> {
    let all = values(shown(sensor, 1.0, 10.0, true, 1, x_um));
    all.into_iter().map(|v| v / 65535.0).collect()
}

fn speck(radius_px: f64, steepness: i32) -> DustConfig {
    DustConfig {
        specks: 1,
        radius_px: [radius_px; 2],
        attenuation: [0.5; 2],
        steepness: [steepness; 2],
        ..DustConfig::default()
    }
}

#[test]
fn dust_has_the_size_depth_and_edge_that_are_asked() {
    let clean = shares(&Sensor::new(&silent(), 1), 0.0);
    for (radius_px, steepness) in [(2.0, 60), (12.0, 60), (12.0, 3), (20.0, 1)] {
        // Seeds whose speck lies whole in the image.
        let picture = (1..)
            .map(|seed| {
                let config = CameraConfig {
                    dust: vec![speck(radius_px, steepness)],
                    ..silent()
                };
                let dusty = shares(&Sensor::new(&config, seed), 0.0);
                let taken = dusty.iter().zip(&clean).map(|(d, c)| 1.0 - d / c);
                taken.collect::<Vec<f64>>()
            })
            .find(|taken| {
                let border = (0..160).chain(160 * 119..160 * 120);
                let sides = (0..120).flat_map(|y| [160 * y, 160 * y + 159]);
                border.chain(sides).all(|i| taken[i] < 0.25)
            })
            .unwrap();
        let deepest = picture.iter().copied().fold(0.0, f64::max);
        assert!((deepest - 0.5).abs() < 0.03, "{deepest}");
        let within = picture.iter().filter(|&&t| t > 0.25).count() as f64;
        let area = std::f64::consts::PI * radius_px * radius_px;
        assert!((within / area - 1.0).abs() < 0.15, "{within} of {area}");
        // From a tenth to nine tenths of the depth: a band that is thinner, the steeper the edge.
        let edge = picture.iter().filter(|&&t| t > 0.05 && t < 0.45).count() as f64;
        let n = f64::from(steepness);
        let band = area * (9f64.powf(1.0 / n) - 9f64.powf(-1.0 / n));
        let pixels = 2.0 * std::f64::consts::PI * radius_px;
        if steepness > 1 {
            assert!((edge - band).abs() < 0.6 * pixels, "{edge} and not {band}");
        } else {
            assert!(edge > 2.0 * area, "{edge}");
        }
    }
}

#[test]
fn fibres_are_long_and_rings_surround_a_speck() {
    let taken = |kind: DustConfig, seed: u64| {
        let config = CameraConfig {
            dust: vec![kind],
            ..silent()
        };
        shares(&Sensor::new(&config, seed), 0.0)
    };
    let fibre = DustConfig {
        stretch: [12.0; 2],
        ..speck(1.5, 20)
    };
    let dark = |v: &[f64]| v.iter().filter(|&&v| v < 0.75).count();
    assert!(dark(&taken(fibre, 4)) > 4 * dark(&taken(speck(1.5, 20), 4)));
    let rings = DustConfig {
        rings: 0.5,
        ..speck(6.0, 3)
    };
    let camera = CameraConfig {
        white_level: 0.8,
        dust: vec![rings],
        ..silent()
    };
    let brightest = shares(&Sensor::new(&camera, 4), 0.0)
        .into_iter()
        .fold(0.0, f64::max);
    assert!(
        brightest > 0.8 * 1.01,
        "a ring is brighter than the ground: {brightest}"
    );
}

#[test]
fn dust_settles_on_what_is_there_and_is_cleaned_away() {
    let dusty = CameraConfig {
        dust: vec![speck(5.0, 3)],
        ..silent()
    };
    let sensor = Sensor::new(&dusty, 2);
    assert_eq!(
        sensor.clean_window(),
        Sensor::new(&silent(), 2).window(),
        "without a reticle all light passes"
    );
    let more = sensor.settle(&sensor.window(), &[speck(4.0, 3)], 9);
    assert!(more.iter().zip(sensor.window().iter()).all(|(m, w)| m <= w));
    assert_ne!(more, sensor.window());
    assert_eq!(more, sensor.settle(&sensor.window(), &[speck(4.0, 3)], 9));
}

#[test]
fn burnt_in_text_stays_and_digits_follow_the_stage() {
    let config = CameraConfig {
        marks: vec![
            Mark::Text {
                text: "20X".into(),
                at_px: [4, 4],
                dot_px: 2,
                level: 0.0,
                box_level: None,
            },
            Mark::StagePlace {
                at_px: [4, 100],
                dot_px: 1,
                level: 0.0,
                box_level: Some(1.0),
                packed: false,
            },
        ],
        white_level: 0.5,
        ..silent()
    };
    let sensor = Sensor::new(&config, 1);
    let (here, there) = (shares(&sensor, 123.4), shares(&sensor, 129.4));
    let upper = 160 * 60;
    assert_eq!(here[..upper], there[..upper], "text is where it was");
    assert!(here[..upper].iter().filter(|&&v| v == 0.0).count() > 60);
    let changed: Vec<usize> = (upper..160 * 120)
        .filter(|&i| here[i] != there[i])
        .map(|i| i % 160)
        .collect();
    // "X:   123.4" becomes "X:   129.4": the seventh letter from the left and no other.
    assert!(!changed.is_empty());
    let letter = 4 + 7 * 6;
    assert!(
        changed.iter().all(|x| (letter..letter + 5).contains(x)),
        "{changed:?}"
    );
    let place = StagePose::default().with_si(Axis::X, -12.34e-6);
    assert_eq!(overlay::digits(&place, false), "X:   -12.3");
    assert_eq!(overlay::digits(&place, true), "X:-12.3");
}

#[test]
fn a_reticle_takes_light_along_its_arms_ticks_and_circles() {
    let config = CameraConfig {
        marks: vec![Mark::Reticle {
            centre_px: [80.0, 60.0],
            arm_px: 50.0,
            line_px: 1.0,
            tick_px: 10.0,
            circles_px: vec![30.0],
            attenuation: 0.8,
        }],
        ..silent()
    };
    let light = shares(&Sensor::new(&config, 1), 0.0);
    let at = |x: usize, y: usize| light[160 * y + x];
    for (x, y) in [
        (80, 60),
        (110, 60),
        (125, 60),
        (80, 12),
        (90, 64),
        (101, 39),
        (76, 30),
    ] {
        assert!(at(x, y) < 0.7, "line at {x}, {y}: {}", at(x, y));
    }
    for (x, y) in [(5, 60), (135, 60), (85, 64), (60, 20), (104, 24)] {
        assert!(at(x, y) > 0.99, "glass at {x}, {y}: {}", at(x, y));
    }
}

#[test]
fn the_fixed_pattern_is_as_strong_as_asked_and_the_same_in_every_frame() {
    let camera = |pattern: PatternConfig| CameraConfig {
        white_level: 0.5,
        pattern,
        ..silent()
    };
    let of = |pattern: PatternConfig| Sensor::new(&camera(pattern), 5);
    let pixels = of(PatternConfig {
        gain: 0.02,
        ..PatternConfig::default()
    });
    let (mean, sd) = mean_sd(&shares(&pixels, 0.0));
    assert!(
        (mean - 0.5).abs() < 1e-3 && (sd / mean - 0.02).abs() < 1e-3,
        "{mean} {sd}"
    );
    let again = values(shown(&pixels, 1.0, 10.0, true, 77, 0.0));
    assert_eq!(again, values(shown(&pixels, 1.0, 10.0, true, 1, 0.0)));
    let columns = shares(
        &of(PatternConfig {
            column_offset_e: 120.0,
            ..PatternConfig::default()
        }),
        0.0,
    );
    assert!((1..120).all(|y| columns[160 * y..160 * (y + 1)] == columns[..160]));
    let (_, sd) = mean_sd(&columns[..160]);
    // 120 of 12000 electrons.
    assert!((sd - 0.01).abs() < 0.002, "{sd}");
    let light = |ms: f64| mean_sd(&values(shown(&pixels, 1.0, ms, true, 1, 0.0)));
    assert!(
        (light(5.0).1 / light(10.0).1 - 0.5).abs() < 0.01,
        "gain scales with light"
    );
}
