use super::*;
use crate::config::Config;

fn flat(config: &CameraConfig, value: f32) -> Planes {
    std::array::from_fn(|_| vec![value; config.width * config.height])
}

fn plain_optics() -> ObjectiveConfig {
    let mut optics = Config::realistic().optics[0].clone();
    optics.vignetting = 0.0;
    optics.gradient = [0.0; 2];
    optics
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
        dust_specks: 0,
        dead_pixels: 0,
        ..CameraConfig::default()
    }
}

#[test]
fn shot_noise_is_one_to_two_levels_at_mid_grey_and_grows_as_the_root() {
    let config = small();
    let sensor = Sensor::new(&config, 1);
    let noise = |value: f32| {
        let s = sensor.develop(&flat(&config, value), &plain_optics(), 10.0, true, 1);
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
    let level =
        |ms: f64| values(sensor.develop(&flat(&config, 0.5), &plain_optics(), ms, true, 1))[777];
    assert_eq!(level(10.0), (0.5f64 * 0.92 * 255.0).round());
    assert_eq!(level(5.0), (0.25f64 * 0.92 * 255.0).round());
    assert_eq!(level(100.0), 255.0);
}

#[test]
fn gain_keeps_the_level_and_raises_the_noise() {
    let noise = |gain: f64| {
        let config = CameraConfig { gain, ..small() };
        let s =
            Sensor::new(&config, 1).develop(&flat(&config, 0.5), &plain_optics(), 10.0, true, 1);
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
        values(sensor.develop(&flat(&config, 1.0), &optics, 10.0, true, 1))[3 * (y * 160 + x)]
    };
    let ratio = at(0.2, [0.0; 2], 0, 0) / at(0.2, [0.0; 2], 80, 60);
    assert!((ratio - 0.8).abs() < 0.02, "{ratio}");
    assert!(at(0.0, [0.06, 0.0], 159, 60) > at(0.0, [0.06, 0.0], 0, 60) + 20.0);
    assert!(at(0.0, [0.0, -0.06], 80, 119) < at(0.0, [0.0, -0.06], 80, 0) - 20.0);
}

#[test]
fn dust_and_dead_pixels_belong_to_the_sensor() {
    let config = CameraConfig {
        dust_specks: 6,
        dead_pixels: 12,
        shot_noise: false,
        read_noise_e: 0.0,
        ..small()
    };
    let develop = |seed: u64, sequence: u64| {
        values(Sensor::new(&config, seed).develop(
            &flat(&config, 0.8),
            &plain_optics(),
            10.0,
            true,
            sequence,
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
    let s = Sensor::new(&config, 1).develop(&flat(&config, 0.5), &plain_optics(), 10.0, true, 0);
    assert!(matches!(&s, Samples::U16(v) if v.len() == 160 * 120));
    assert_eq!(values(s)[5], (0.5f64 * 0.92 * 4095.0).round());
}

#[test]
fn without_light_only_read_noise_remains() {
    let config = small();
    let s = Sensor::new(&config, 1).develop(&flat(&config, 0.9), &plain_optics(), 10.0, false, 0);
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
