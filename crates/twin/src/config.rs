//! What the simulated microscope is made of. Every default is the paper's instrument, never a clean one.

use crate::TwinError;
use crate::camera_config::CameraConfig;
use crate::numbers::{finite, fraction, not_negative, positive, require};
use crate::stage_config::StageConfig;
use scopeservo_scope::{Immersion, Kinematics, ObjectiveId};
use serde::{Deserialize, Serialize};

/// A whole simulated microscope.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// The objectives, in the order of the nosepiece. The first is active at the start.
    pub optics: Vec<ObjectiveConfig>,
    /// How the camera is mounted.
    pub mount: MountConfig,
    /// The camera.
    pub camera: CameraConfig,
    /// The stage.
    pub stage: StageConfig,
    /// The nosepiece.
    pub nosepiece: NosepieceConfig,
    /// How the slide lies.
    pub slide: SlideConfig,
}

/// One objective.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectiveConfig {
    /// Its name.
    pub id: ObjectiveId,
    /// Total magnification.
    pub magnification: f64,
    /// Numerical aperture.
    pub numerical_aperture: f64,
    /// What the data sheet says of one pixel on the specimen, um.
    pub nominal_um_per_px: f64,
    /// True horizontal scale, px per metre; negative inverts the image.
    pub kx_px_per_m: f64,
    /// True vertical scale, px per metre.
    pub ky_px_per_m: f64,
    /// Brightness at nominal exposure, relative to the others.
    #[serde(default = "one")]
    pub brightness: f64,
    /// Light lost in the corners to vignetting, 0..1, growing with the square of the distance from the middle.
    #[serde(default)]
    pub vignetting: f64,
    /// Relative change of the illumination from the middle to the right edge and to the bottom edge.
    #[serde(default)]
    pub gradient: [f64; 2],
    /// Where red, green and blue focus, in depths of field from the common focus.
    #[serde(default)]
    pub chromatic_dof: [f64; 3],
    /// Share of the light that spherical aberration spreads into a halo when the objective is too close, 0..1.
    #[serde(default)]
    pub spherical: f64,
    /// Radial distortion: a point that would lie at r from the middle is seen at `r (1 + distortion (r / r_corner)^2)`. 0.002 moves the
    /// corner out by 0.2 % (pincushion), negative values in (barrel). Scales are those of the middle.
    #[serde(default)]
    pub distortion: f64,
    /// What it works in. The image does not depend on it.
    #[serde(default)]
    pub immersion: Immersion,
}

fn one() -> f64 {
    1.0
}

/// How the camera sits on the end-effector: the paper's phi and eta, and what the paper's model leaves out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MountConfig {
    /// Rotation phi of the camera, degrees.
    pub phi_deg: f64,
    /// Place eta of the camera in the end-effector frame, mm.
    pub eta_mm: [f64; 2],
    /// A mirror active: columns run the other way. Does not fit the paper's model.
    pub mirrored: bool,
    /// Shear of the columns along the rows, px per px. Does not fit the paper's model either.
    pub skew: f64,
}

/// The nosepiece. Offsets are drawn from the seed, one per objective.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NosepieceConfig {
    /// Duration of a change, s.
    pub change_s: f64,
    /// Largest parcentric offset of an objective, um.
    pub parcentric_um: f64,
    /// Largest distance of an objective's focus from the stage's start height, um. Zero on stages without z: somebody
    /// focused by hand.
    pub parfocal_um: f64,
    /// Half-width of the view's scatter after each change, um.
    pub repeatability_um: f64,
    /// Half-width of the focus' scatter after each change, um.
    pub focus_repeatability_um: f64,
}

/// How the slide lies in its holder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SlideConfig {
    /// Slope of the slide along world x and y, mrad (um of height per mm).
    pub tilt_mrad: [f64; 2],
    /// Half-width of the height scatter each time the slide is put back, um.
    pub seat_um: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self::realistic()
    }
}

impl Config {
    /// The paper's instrument with its noise, scatter and offsets.
    pub fn realistic() -> Self {
        Self {
            optics: paper_objectives(),
            mount: MountConfig::default(),
            camera: CameraConfig::default(),
            stage: StageConfig::default(),
            nosepiece: NosepieceConfig::default(),
            slide: SlideConfig::default(),
        }
    }

    /// The same instrument without anything random in time: no shot or read noise, no scatter of stage and nosepiece,
    /// no vibration, no drift, no dust. Blur, vignetting, parfocal and parcentric offsets and quantisation stay.
    pub fn noiseless() -> Self {
        let mut config = Self::realistic();
        config.camera.shot_noise = false;
        config.camera.read_noise_e = 0.0;
        config.camera.dust.clear();
        config.camera.dead_pixels = 0;
        config.nosepiece.repeatability_um = 0.0;
        config.nosepiece.focus_repeatability_um = 0.0;
        config.slide.seat_um = 0.0;
        config.stage = config.stage.exact();
        config
    }

    /// The same instrument on another stage. A stage that carries the specimen turns it near the view, so eta becomes a
    /// few millimetres there.
    #[must_use]
    pub fn with_stage(mut self, stage: StageConfig) -> Self {
        if stage.kinematics != Kinematics::MovesMicroscope {
            self.mount.eta_mm = [3.2, -1.7];
        }
        self.stage = stage;
        self
    }

    /// Whether such a microscope can be built.
    ///
    /// # Errors
    /// [`TwinError::BadConfig`] with the field and what it must be.
    pub fn check(&self) -> Result<(), TwinError> {
        require(
            !self.optics.is_empty(),
            "optics: at least one objective is needed",
        )?;
        for (i, o) in self.optics.iter().enumerate() {
            o.check()?;
            require(
                self.optics[..i].iter().all(|p| p.id != o.id),
                &format!("optics: two objectives are called {}", o.id),
            )?;
        }
        let m = &self.mount;
        require(
            finite(&[m.phi_deg, m.eta_mm[0], m.eta_mm[1], m.skew]) && m.skew.abs() < 0.5,
            "mount: numbers must be finite and skew below 0.5",
        )?;
        self.camera.check()?;
        let n = &self.nosepiece;
        require(
            not_negative(&[
                n.change_s,
                n.parcentric_um,
                n.parfocal_um,
                n.repeatability_um,
                n.focus_repeatability_um,
                self.slide.seat_um,
            ]) && finite(&self.slide.tilt_mrad),
            "nosepiece and slide: times and offsets must be finite and not negative",
        )?;
        self.stage.check()
    }
}

impl ObjectiveConfig {
    fn check(&self) -> Result<(), TwinError> {
        let id = &self.id;
        require(
            positive(&[
                self.magnification,
                self.nominal_um_per_px,
                self.brightness,
                self.kx_px_per_m.abs(),
                self.ky_px_per_m.abs(),
            ]),
            &format!("optics {id}: magnification, scales and brightness must be above 0"),
        )?;
        require(
            self.numerical_aperture >= 0.01 && self.numerical_aperture <= 0.95,
            &format!("optics {id}: numerical_aperture must be 0.01 to 0.95 (dry)"),
        )?;
        require(
            fraction(self.vignetting)
                && fraction(self.spherical)
                && self.gradient.iter().all(|g| g.abs() < 0.5)
                && finite(&self.chromatic_dof),
            &format!("optics {id}: vignetting and spherical are 0..1, gradients below 0.5"),
        )?;
        require(
            self.distortion.abs() <= 0.05,
            &format!("optics {id}: distortion is -0.05 to 0.05 at the corner"),
        )
    }
}

fn paper_objectives() -> Vec<ObjectiveConfig> {
    // Table II of the paper; the aperture is that of a common plan achromat.
    let objective =
        |id: &str, magnification, na, nominal, kx, ky, brightness, vignetting| ObjectiveConfig {
            id: ObjectiveId(id.into()),
            magnification,
            numerical_aperture: na,
            nominal_um_per_px: nominal,
            kx_px_per_m: kx,
            ky_px_per_m: ky,
            brightness,
            vignetting,
            gradient: [0.03, -0.02],
            chromatic_dof: [0.3, 0.0, -0.35],
            spherical: 0.35,
            distortion: 0.0,
            immersion: Immersion::Air,
        };
    vec![
        objective("10x", 100.0, 0.25, 2.2, -448672.0, -451767.0, 1.0, 0.12),
        objective("20x", 200.0, 0.45, 1.07, -938325.0, -942616.0, 0.96, 0.09),
        objective("40x", 400.0, 0.65, 0.51, -1953155.0, -1981235.0, 0.9, 0.06),
    ]
}

impl Default for MountConfig {
    fn default() -> Self {
        Self {
            // The mean of the paper's three; its scatter between objectives is estimation error.
            phi_deg: 0.4752,
            eta_mm: [125.4031, 0.0663],
            mirrored: false,
            skew: 0.0,
        }
    }
}

impl Default for NosepieceConfig {
    fn default() -> Self {
        Self {
            change_s: 2.0,
            parcentric_um: 15.0,
            parfocal_um: 15.0,
            repeatability_um: 2.0,
            focus_repeatability_um: 0.3,
        }
    }
}

impl Default for SlideConfig {
    fn default() -> Self {
        Self {
            tilt_mrad: [0.3, -0.2],
            seat_um: 3.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_presets_can_be_built() {
        for config in [Config::realistic(), Config::noiseless()] {
            config.check().unwrap();
        }
        for stage in [
            StageConfig::hexapod(),
            StageConfig::xyz_theta(),
            StageConfig::xyz(),
            StageConfig::xy(),
        ] {
            Config::noiseless().with_stage(stage).check().unwrap();
        }
    }

    #[test]
    fn nonsense_is_refused_with_the_field() {
        type Breakage = fn(&mut Config);
        let break_it: [(&str, Breakage); 10] = [
            ("optics", |c| c.optics.clear()),
            ("called 10x", |c| c.optics.push(c.optics[0].clone())),
            ("numerical_aperture", |c| {
                c.optics[0].numerical_aperture = 1.4
            }),
            ("optics 20x", |c| c.optics[1].kx_px_per_m = f64::NAN),
            ("optics 40x: distortion", |c| c.optics[2].distortion = 0.06),
            ("distortion", |c| c.optics[0].distortion = f64::NAN),
            ("bit_depth", |c| c.camera.bit_depth = 17),
            ("exposure_range_ms", |c| c.camera.exposure_ms = 2000.0),
            ("mount", |c| c.mount.eta_mm[0] = f64::INFINITY),
            ("stage", |c| c.stage.axes[0].travel = [1.0, -1.0]),
        ];
        for (field, f) in break_it {
            let mut config = Config::realistic();
            f(&mut config);
            let said = config.check().unwrap_err().to_string();
            assert!(said.contains(field), "{field}: {said}");
        }
    }
}
