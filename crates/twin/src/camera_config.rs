//! The camera, its faults, and what is fixed to it.

use crate::TwinError;
use crate::numbers::{fraction, not_negative, positive, require};
use scopeservo_scope::Channels;
use serde::{Deserialize, Serialize};

/// The camera and its faults.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraConfig {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Colour or grey.
    pub channels: Channels,
    /// Bits per sample, 8 to 16.
    pub bit_depth: u8,
    /// Frames per second, when the exposure leaves time for it.
    pub frames_per_s: f64,
    /// Exposure at the start, ms. Signal is proportional to exposure over nominal exposure.
    pub exposure_ms: f64,
    /// Exposure at which white reaches `white_level`, ms.
    pub nominal_exposure_ms: f64,
    /// Shortest and longest exposure, ms.
    pub exposure_range_ms: [f64; 2],
    /// Read-out time after the exposure, ms.
    pub readout_ms: f64,
    /// Whether rows are exposed one after the other, the last one `readout_ms` after the first, instead of all at once.
    pub rolling: bool,
    /// An exposure that the camera sets by itself and nobody can turn off; what is asked and told is another.
    pub auto_exposure: Option<AutoExposureConfig>,
    /// Share of full scale that white (255 in the specimen) reaches at nominal exposure.
    pub white_level: f64,
    /// Electrons at full scale with gain 1.
    pub full_well_e: f64,
    /// Gain after the full well; above 1 full scale is reached with fewer electrons.
    pub gain: f64,
    /// Whether photons arrive one by one.
    pub shot_noise: bool,
    /// Read noise, electrons (standard deviation).
    pub read_noise_e: f64,
    /// Dust on the sensor's window, kind by kind.
    pub dust: Vec<DustConfig>,
    /// What else the camera shows in every image: text, a reticle.
    pub marks: Vec<Mark>,
    /// What each pixel adds to every image.
    pub pattern: PatternConfig,
    /// Pixels that are always dark or always bright in one channel.
    pub dead_pixels: usize,
}

/// A camera that brightens and darkens its images by itself, whatever exposure it is told.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AutoExposureConfig {
    /// The mean that it wants, as a share of full scale.
    pub mean_level: f64,
    /// Within this time it comes nearer by 63 %, s.
    pub settle_s: f64,
    /// The most by which it brightens or darkens.
    pub most: f64,
}

impl Default for AutoExposureConfig {
    fn default() -> Self {
        Self {
            mean_level: 0.5,
            settle_s: 0.2,
            most: 16.0,
        }
    }
}

/// Specks on the sensor's window, drawn from the seed: they stay where they are while the specimen moves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DustConfig {
    /// How many.
    pub specks: usize,
    /// Least and most radius at half depth, px. Any size; drawn evenly.
    pub radius_px: [f64; 2],
    /// Least and most light that a speck takes in its middle, 0..1.
    pub attenuation: [f64; 2],
    /// How steep the edge is, least and most: at the radius the shadow falls by n/2 of its depth per radius. 1 is a wide
    /// soft shadow, 3 that of dust on the window, 60 a hard edge: dust on the sensor itself.
    pub steepness: [i32; 2],
    /// Least and most length over width: 1 is round, 20 a fibre. The length lies any way.
    pub stretch: [f64; 2],
    /// Share of the depth in rings of diffraction around it.
    pub rings: f64,
}

/// Something that the camera draws into every image at one place. Places are that of the upper left corner or of the
/// centre, px; what lies outside the image is cut off.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Mark {
    /// A line of text, burnt in after the read-out, so without noise. Capitals, digits and common signs.
    Text {
        /// What it says.
        text: String,
        /// Its upper left corner.
        at_px: [i64; 2],
        /// Pixels to a dot of its letters, which are 5 dots wide and 7 high.
        dot_px: usize,
        /// Its brightness, 0 (black) to 1 (white).
        level: f64,
        /// Brightness of the box behind it; none without.
        #[serde(default)]
        box_level: Option<f64>,
    },
    /// Like text: the stage's reported place. The labels stay, unless packed, and the digits follow the stage.
    StagePlace {
        /// Its upper left corner.
        at_px: [i64; 2],
        /// Pixels to a dot.
        dot_px: usize,
        /// Its brightness, 0 (black) to 1 (white).
        level: f64,
        /// Brightness of the box behind it; none without.
        #[serde(default)]
        box_level: Option<f64>,
        /// Without blanks before the digits: what follows shifts by a letter as digits come.
        #[serde(default)]
        packed: bool,
    },
    /// A cross hair with ticks and circles in the eyepiece's plane: it takes light, and is as noisy as the image.
    Reticle {
        /// Its centre.
        centre_px: [f64; 2],
        /// Length of an arm.
        arm_px: f64,
        /// Thickness of its lines.
        line_px: f64,
        /// Distance of the ticks along the arms; 0 without.
        #[serde(default)]
        tick_px: f64,
        /// Radii of circles.
        #[serde(default)]
        circles_px: Vec<f64>,
        /// Light that a line takes, 0..1.
        attenuation: f64,
    },
}

/// Fixed-pattern noise, standard deviations, drawn from the seed once.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PatternConfig {
    /// Of a pixel's offset, electrons.
    pub offset_e: f64,
    /// Of a pixel's gain, as a share.
    pub gain: f64,
    /// Of a column's offset, electrons.
    pub column_offset_e: f64,
    /// Of a column's gain, as a share.
    pub column_gain: f64,
}

impl Default for DustConfig {
    fn default() -> Self {
        Self {
            specks: 6,
            radius_px: [3.0, 8.0],
            attenuation: [0.10, 0.25],
            steepness: [3, 3],
            stretch: [1.0, 1.0],
            rings: 0.0,
        }
    }
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            width: 640,
            height: 480,
            channels: Channels::Rgb,
            bit_depth: 8,
            frames_per_s: 30.0,
            exposure_ms: 10.0,
            nominal_exposure_ms: 10.0,
            exposure_range_ms: [0.02, 1000.0],
            readout_ms: 5.0,
            rolling: false,
            auto_exposure: None,
            white_level: 0.92,
            full_well_e: 12_000.0,
            gain: 1.0,
            shot_noise: true,
            read_noise_e: 6.0,
            dust: vec![DustConfig::default()],
            marks: Vec::new(),
            pattern: PatternConfig::default(),
            dead_pixels: 12,
        }
    }
}

impl CameraConfig {
    pub(crate) fn check(&self) -> Result<(), TwinError> {
        require(
            (1..=8192).contains(&self.width) && (1..=8192).contains(&self.height),
            "camera: width and height must be 1 to 8192",
        )?;
        require(
            (8..=16).contains(&self.bit_depth),
            "camera: bit_depth must be 8 to 16",
        )?;
        require(
            positive(&[
                self.frames_per_s,
                self.exposure_ms,
                self.nominal_exposure_ms,
                self.exposure_range_ms[0],
                self.white_level,
                self.full_well_e,
                self.gain,
            ]) && not_negative(&[self.read_noise_e, self.readout_ms]),
            "camera: rates, times, levels and gain must be above 0",
        )?;
        require(
            self.exposure_range_ms[0] <= self.exposure_ms
                && self.exposure_ms <= self.exposure_range_ms[1]
                && self.exposure_range_ms[1].is_finite(),
            "camera: exposure_ms must lie inside exposure_range_ms",
        )?;
        if let Some(auto) = &self.auto_exposure {
            require(
                positive(&[auto.mean_level]) && auto.mean_level < 1.0,
                "camera.auto_exposure: mean_level must be between 0 and 1",
            )?;
            require(
                positive(&[auto.settle_s, auto.most]) && auto.most >= 1.0,
                "camera.auto_exposure: settle_s must be above 0, most at least 1",
            )?;
        }
        self.dust.iter().try_for_each(DustConfig::check)?;
        self.marks.iter().try_for_each(Mark::check)?;
        self.pattern.check()
    }
}

impl DustConfig {
    pub(crate) fn check(&self) -> Result<(), TwinError> {
        let rises = |[a, b]: [f64; 2]| a <= b;
        require(
            self.specks <= 10_000
                && positive(&self.radius_px)
                && rises(self.radius_px)
                && self.attenuation.iter().all(|&a| fraction(a))
                && rises(self.attenuation),
            "camera.dust: specks are at most 10000; radius_px above 0 and attenuation in 0..1 are two rising numbers",
        )?;
        require(
            1 <= self.steepness[0]
                && self.steepness[0] <= self.steepness[1]
                && self.steepness[1] <= 100,
            "camera.dust: steepness is two rising numbers from 1 to 100",
        )?;
        require(
            self.stretch[0] >= 1.0
                && rises(self.stretch)
                && positive(&self.stretch)
                && fraction(self.rings),
            "camera.dust: stretch is two rising numbers from 1 on, rings in 0..1",
        )
    }
}

impl Mark {
    fn check(&self) -> Result<(), TwinError> {
        let bright = |level: &f64| fraction(*level);
        match self {
            Self::Text {
                dot_px,
                level,
                box_level,
                ..
            }
            | Self::StagePlace {
                dot_px,
                level,
                box_level,
                ..
            } => require(
                (1..=100).contains(dot_px)
                    && bright(level)
                    && box_level.as_ref().is_none_or(bright),
                "camera.marks: dot_px is 1 to 100, levels 0..1",
            ),
            Self::Reticle {
                centre_px,
                arm_px,
                line_px,
                tick_px,
                circles_px,
                attenuation,
            } => require(
                not_negative(&[*arm_px, *tick_px])
                    && positive(&[*line_px])
                    && positive(circles_px)
                    && centre_px.iter().all(|c| c.is_finite())
                    && (*tick_px == 0.0 || *tick_px >= 1.0)
                    && fraction(*attenuation),
                "camera.marks: lengths of a reticle are not negative, its lines above 0 px, ticks 1 px apart or 0, attenuation 0..1",
            ),
        }
    }
}

impl PatternConfig {
    fn check(&self) -> Result<(), TwinError> {
        require(
            not_negative(&[
                self.offset_e,
                self.gain,
                self.column_offset_e,
                self.column_gain,
            ]),
            "camera.pattern: standard deviations must not be negative",
        )
    }
}
