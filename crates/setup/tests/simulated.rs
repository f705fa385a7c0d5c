//! The simulated microscope is as the file describes it.

use scopeservo_scope::{CancelToken, Frame};
use scopeservo_setup::{Config, Consent, SetupError, TWIN_TEMPLATE, open};
use std::path::Path;

/// What the camera of the template sees, with more said of the twin.
fn seen(more: &str) -> Result<Frame, SetupError> {
    let text = TWIN_TEMPLATE.replace("turned_deg = 0", &format!("turned_deg = 0\n{more}"));
    let config = Config::parse(&text, Path::new("scopeservo.toml"))?;
    let consent = Consent {
        home: false,
        ask: std::sync::Arc::new(|_, _| false),
        ask_immersion: std::sync::Arc::new(|_, _| false),
    };
    let opened = open(&config, &consent, CancelToken::new())?;
    Ok(opened.instrument.grab()?)
}

/// Share of the pixels darker than half of the brightest.
fn dark(frame: &Frame) -> f64 {
    let grey = frame.luminance();
    let top = grey.iter().copied().fold(0.0, f32::max);
    grey.iter().filter(|&&v| v < 0.5 * top).count() as f64 / grey.len() as f64
}

#[test]
fn specimen_dust_marks_and_pattern_are_those_of_the_file() {
    let blank = "made.blank = {}\n";
    assert!(dark(&seen(blank).unwrap()) < 1e-4);
    let dust = "camera.dust = [{ specks = 30, radius_px = [10, 20], attenuation = [0.9, 0.9], steepness = [20, 60] }]";
    assert!(dark(&seen(&format!("{blank}{dust}")).unwrap()) > 0.02);
    let marks = r#"camera.marks = [
  { kind = "text", text = "sample 7", at_px = [20, 20], dot_px = 3, level = 0 },
  { kind = "stage_place", at_px = [20, 440], dot_px = 2, level = 0 },
  { kind = "reticle", centre_px = [320, 240], arm_px = 200, line_px = 2, tick_px = 20, attenuation = 0.9 },
]"#;
    assert!(dark(&seen(&format!("{blank}{marks}")).unwrap()) > 0.004);
    let noisy = |more: &str| {
        let grey = seen(&format!("{blank}{more}")).unwrap().luminance();
        let steps = grey.windows(2).map(|p| f64::from(p[1] - p[0]).powi(2));
        steps.sum::<f64>() / grey.len() as f64
    };
    assert!(noisy("camera.pattern.gain = 0.05") > 4.0 * noisy(""));
    let lattice = "made.lattice = { kind = \"dies\", pitch_um = 400, fill = 0.9, contrast = 0.9 }";
    assert!(dark(&seen(lattice).unwrap()) > 0.05);
    assert_eq!(seen("camera.width = 320").unwrap().width, 320);
}

#[test]
fn a_twin_that_cannot_be_is_refused_with_the_file_and_the_setting() {
    for (more, word) in [
        ("made.lattice.pitch_um = 0", "pitch_um"),
        ("made.lattice.pich_um = 3", "did you mean 'pitch_um'"),
        ("made.blank = {}\nspecimen = \"a.png\"", "not both"),
        ("camera.dust = [{ rings = 3 }]", "rings"),
        ("objectives = [\"60x\"]", "60x"),
    ] {
        let said = seen(more).unwrap_err().to_string();
        assert!(
            said.contains(word) && said.contains("scopeservo.toml"),
            "{said}"
        );
    }
}
