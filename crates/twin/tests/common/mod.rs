//! Specimens made for measuring, and a microscope over them.
#![allow(
    dead_code,
    unreachable_pub,
    reason = "each test file uses its own part"
)]

use scopeservo_scope::{
    Camera, CancelToken, Clock, Frame, Instrument, ObjectiveId, Stage, StagePose, VirtualClock,
};
use scopeservo_twin::{Config, Patch, Specimen, SpecimenError, StageConfig, Twin};
use std::sync::Arc;

/// A specimen given by a formula, sampled at 0.05 um and coarser.
pub struct Formula<F>(pub F);

impl<F: Fn([f64; 2]) -> [f64; 3] + Send + Sync> Specimen for Formula<F> {
    fn finest_um(&self) -> f64 {
        0.05
    }
    fn levels(&self) -> usize {
        12
    }
    fn patch(
        &self,
        level: usize,
        x_um: [f64; 2],
        y_um: [f64; 2],
        margin: usize,
    ) -> Result<Patch, SpecimenError> {
        let spacing_um = self.finest_um() * f64::from(1u32 << level);
        let m = margin as f64;
        let x0_um = ((x_um[0] / spacing_um).floor() - m) * spacing_um;
        let y0_um = ((y_um[1] / spacing_um).ceil() + m) * spacing_um;
        let width = ((x_um[1] - x0_um) / spacing_um).ceil() as usize + margin + 1;
        let height = ((y0_um - y_um[0]) / spacing_um).ceil() as usize + margin + 1;
        let mut rgb = Vec::with_capacity(3 * width * height);
        for j in 0..height {
            for i in 0..width {
                let at = [x0_um + i as f64 * spacing_um, y0_um - j as f64 * spacing_um];
                rgb.extend((self.0)(at).map(|v| (v * 255.0).round().clamp(0.0, 255.0) as u8));
            }
        }
        Ok(Patch {
            x0_um,
            y0_um,
            spacing_um,
            width,
            height,
            rgb,
        })
    }
    fn extent_um(&self) -> Option<[f64; 4]> {
        None
    }
    fn describe(&self) -> String {
        "a formula".into()
    }
}

/// A dark round spot on white.
pub fn dot(centre: [f64; 2], sigma_um: f64) -> Arc<dyn Specimen> {
    Arc::new(Formula(move |s: [f64; 2]| {
        let d_sq = (s[0] - centre[0]).powi(2) + (s[1] - centre[1]).powi(2);
        [1.0 - 0.9 * (-0.5 * d_sq / (sigma_um * sigma_um)).exp(); 3]
    }))
}

/// Waves in two directions: structure everywhere.
pub fn waves() -> Arc<dyn Specimen> {
    Arc::new(Formula(|s: [f64; 2]| {
        let a = (s[0] * 0.21 + (s[1] * 0.013).sin() * 4.0).sin() * (s[1] * 0.17).cos();
        let b = (s[0] * 0.037 - s[1] * 0.045).sin();
        [
            0.5 + 0.2 * a + 0.15 * b,
            0.45 + 0.3 * a,
            0.55 + 0.2 * b - 0.1 * a,
        ]
    }))
}

/// Black to the left of x = 0, white to the right.
pub fn edge() -> Arc<dyn Specimen> {
    Arc::new(Formula(|s: [f64; 2]| {
        [if s[0] < 0.0 { 0.1 } else { 0.9 }; 3]
    }))
}

/// The same grey everywhere.
pub fn grey(value: f64) -> Arc<dyn Specimen> {
    Arc::new(Formula(move |_: [f64; 2]| [value; 3]))
}

/// No randomness and no shading: what is left is geometry.
pub fn clean(stage: StageConfig) -> Config {
    let mut config = Config::noiseless().with_stage(stage.exact());
    for o in &mut config.optics {
        o.vignetting = 0.0;
        o.gradient = [0.0; 2];
    }
    config.slide.tilt_mrad = [0.0; 2];
    config
}

/// A microscope on a virtual clock.
pub struct Bench {
    pub twin: Twin,
    pub clock: Arc<VirtualClock>,
    pub stage: Box<dyn Stage>,
    pub camera: Box<dyn Camera>,
}

impl Bench {
    pub fn new(config: Config, specimen: Arc<dyn Specimen>) -> Self {
        let clock = Arc::new(VirtualClock::new());
        let twin = Twin::new(config, specimen, 11, clock.clone()).unwrap();
        Self {
            stage: twin.stage(),
            camera: twin.camera(),
            clock,
            twin,
        }
    }
    pub fn sleep(&self, s: f64) {
        self.clock.sleep(std::time::Duration::from_secs_f64(s));
    }
    pub fn move_to(&self, to: StagePose) {
        self.stage.start_move(&to).unwrap();
        while self.stage.poll().unwrap() == scopeservo_scope::Motion::Moving {
            self.sleep(0.005);
        }
    }
    pub fn select(&self, id: &str) {
        self.twin
            .nosepiece()
            .start_change(&ObjectiveId(id.into()))
            .unwrap();
        self.sleep(2.5);
    }
    pub fn grab(&self) -> Frame {
        self.camera.grab().unwrap()
    }
    /// Goes to where the defocus is `um`.
    pub fn focus(&self, um: f64) {
        let z = self.stage.position().unwrap().z.unwrap().um();
        let now = self.twin.truth_now().defocus_um;
        let z = (z + um - now) * 1e-6;
        self.move_to(StagePose::default().with_si(scopeservo_scope::Axis::Z, z));
    }
    pub fn instrument(&self) -> Instrument {
        Instrument::new(self.twin.devices(), self.twin.rules(), CancelToken::new()).unwrap()
    }
}

/// Centre of gravity of what is darker than the border, px.
pub fn centroid(frame: &Frame) -> [f64; 2] {
    let grey = frame.luminance();
    let white = f64::from(grey[0]);
    let (mut sum, mut at) = (0.0, [0.0; 2]);
    for (i, &v) in grey.iter().enumerate() {
        let dark = white - f64::from(v);
        sum += dark;
        at[0] += dark * (i % frame.width) as f64;
        at[1] += dark * (i / frame.width) as f64;
    }
    at.map(|v| v / sum)
}

pub fn mean(frame: &Frame) -> f64 {
    let grey = frame.luminance();
    grey.iter().map(|&v| f64::from(v)).sum::<f64>() / grey.len() as f64
}

/// Mean absolute difference, in parts of full scale.
pub fn difference(a: &Frame, b: &Frame) -> f64 {
    let (a, b) = (a.luminance(), b.luminance());
    let sum: f64 = a
        .iter()
        .zip(&b)
        .map(|(x, y)| f64::from((x - y).abs()))
        .sum();
    sum / a.len() as f64
}

/// Mean squared step from pixel to pixel: high when sharp.
pub fn sharpness(frame: &Frame) -> f64 {
    let grey = frame.luminance();
    grey.windows(2)
        .map(|p| f64::from(p[1] - p[0]).powi(2))
        .sum::<f64>()
        / grey.len() as f64
}

/// Pixel of a specimen point, from a truth's affine map.
pub fn pixel(m: [[f64; 3]; 2], s: [f64; 2]) -> [f64; 2] {
    let det = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    let d = [s[0] - m[0][2], s[1] - m[1][2]];
    [
        (m[1][1] * d[0] - m[0][1] * d[1]) / det,
        (m[0][0] * d[1] - m[1][0] * d[0]) / det,
    ]
}
