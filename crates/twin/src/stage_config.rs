//! What the stage is: its axes, their travel and their failings.

use crate::TwinError;
use crate::numbers::{finite, not_negative, positive, require};
use scopeservo_scope::{Axis, AxisInfo, Kinematics, PositiveZ, StageInfo};
use serde::{Deserialize, Serialize};

/// One axis. Lengths are in the unit of the field's name for x, y, z; rotations use the second unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisConfig {
    /// Which axis.
    pub axis: Axis,
    /// Both ends of travel, mm or deg. The stage starts in the middle.
    pub travel: [f64; 2],
    /// Top speed, mm/s or deg/s.
    pub speed: f64,
    /// Half-width of the interval in which repeated arrivals end, um or urad.
    #[serde(default)]
    pub repeatability: f64,
    /// Play in the drive, um or urad: the difference between arriving from below and from above.
    #[serde(default)]
    pub backlash: f64,
    /// Half-width of the encoder's error at each arrival, um or urad: what it says, not where it stands.
    #[serde(default)]
    pub encoder_error: f64,
}

/// The stage.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StageConfig {
    /// Maker and model, for people.
    pub name: String,
    /// The axes it has.
    pub axes: Vec<AxisConfig>,
    /// Which side moves.
    pub kinematics: Kinematics,
    /// What positive z does.
    pub positive_z: PositiveZ,
    /// Whether all axes share the same legs, as in a hexapod: then every move scatters all of them.
    pub parallel: bool,
    /// Time to reach full speed, s.
    pub ramp_s: f64,
    /// Time between the end of travel and settled, s.
    pub settle_s: f64,
    /// Amplitude of the shaking while moving and, decaying, while settling, um.
    pub vibration_um: f64,
    /// Amplitude of the building's shaking, always there, um.
    pub ambient_um: f64,
    /// Thermal drift of x, y, z, um/s.
    pub drift_um_per_s: [f64; 3],
}

impl Default for StageConfig {
    fn default() -> Self {
        Self::hexapod()
    }
}

impl StageConfig {
    /// The paper's PI H-811 hexapod, carrying the microscope.
    pub fn hexapod() -> Self {
        let axis = |axis, travel: f64, speed, repeatability| AxisConfig {
            axis,
            travel: [-travel, travel],
            speed,
            repeatability,
            backlash: 0.0,
            encoder_error: 0.0,
        };
        Self {
            name: "simulated PI H-811 hexapod".into(),
            axes: vec![
                axis(Axis::X, 17.0, 10.0, 0.15),
                axis(Axis::Y, 16.0, 10.0, 0.15),
                axis(Axis::Z, 6.5, 10.0, 0.06),
                axis(Axis::Rx, 10.0, 10.0, 2.0),
                axis(Axis::Ry, 10.0, 10.0, 2.0),
                axis(Axis::Rz, 21.0, 10.0, 3.0),
            ],
            kinematics: Kinematics::MovesMicroscope,
            positive_z: PositiveZ::Closer,
            parallel: true,
            ramp_s: 0.02,
            settle_s: 0.1,
            vibration_um: 0.5,
            ambient_um: 0.02,
            drift_um_per_s: [0.004, -0.003, 0.005],
        }
    }

    /// A motorised microscope stage with a turning plate: the specimen rides on the rotation, which rides on x and y.
    pub fn xyz_theta() -> Self {
        let mut stage = Self::xyz();
        stage.name = "simulated xyz stage with turntable".into();
        stage.kinematics = Kinematics::SpecimenRotationOnTop;
        stage.axes.push(AxisConfig {
            axis: Axis::Rz,
            travel: [-180.0, 180.0],
            speed: 10.0,
            repeatability: 20.0,
            backlash: 50.0,
            encoder_error: 0.0,
        });
        stage
    }

    /// A motorised microscope stage with a focus drive, without rotation.
    pub fn xyz() -> Self {
        let mut stage = Self::xy();
        stage.name = "simulated xyz stage".into();
        stage.axes.push(AxisConfig {
            axis: Axis::Z,
            travel: [-5.0, 5.0],
            speed: 2.0,
            repeatability: 0.1,
            backlash: 0.2,
            encoder_error: 0.0,
        });
        stage
    }

    /// Two axes and nothing else: somebody focuses by hand.
    pub fn xy() -> Self {
        let axis = |axis, travel: f64| AxisConfig {
            axis,
            travel: [-travel, travel],
            speed: 10.0,
            repeatability: 0.3,
            backlash: 0.6,
            encoder_error: 0.05,
        };
        Self {
            name: "simulated xy stage".into(),
            axes: vec![axis(Axis::X, 57.0), axis(Axis::Y, 37.0)],
            kinematics: Kinematics::SpecimenXyOnTop,
            parallel: false,
            ..Self::hexapod()
        }
    }

    /// The same stage without scatter, backlash, encoder error, shaking and drift.
    #[must_use]
    pub fn exact(mut self) -> Self {
        for axis in &mut self.axes {
            axis.repeatability = 0.0;
            axis.backlash = 0.0;
            axis.encoder_error = 0.0;
        }
        self.vibration_um = 0.0;
        self.ambient_um = 0.0;
        self.drift_um_per_s = [0.0; 3];
        self
    }

    pub(crate) fn check(&self) -> Result<(), TwinError> {
        for (i, a) in self.axes.iter().enumerate() {
            require(
                self.axes[..i].iter().all(|b| b.axis != a.axis),
                &format!("stage: {} is listed twice", a.axis),
            )?;
            require(
                finite(&a.travel) && a.travel[0] < a.travel[1] && positive(&[a.speed]),
                &format!("stage {}: travel must rise and speed be above 0", a.axis),
            )?;
            require(
                not_negative(&[a.repeatability, a.backlash, a.encoder_error]),
                &format!(
                    "stage {}: repeatability, backlash and encoder_error must not be negative",
                    a.axis
                ),
            )?;
        }
        require(
            not_negative(&[
                self.ramp_s,
                self.settle_s,
                self.vibration_um,
                self.ambient_um,
            ]) && finite(&self.drift_um_per_s),
            "stage: times and amplitudes must be finite and not negative",
        )
    }

    pub(crate) fn info(&self) -> StageInfo {
        StageInfo {
            name: self.name.clone(),
            axes: self
                .axes
                .iter()
                .map(|a| AxisInfo {
                    axis: a.axis,
                    min: a.travel[0] * coarse_si(a.axis),
                    max: a.travel[1] * coarse_si(a.axis),
                    // What a data sheet calls repeatability holds the backlash and the encoder, too.
                    repeatability: (a.repeatability + 0.5 * a.backlash + a.encoder_error) * 1e-6,
                    arrival_tolerance: None,
                })
                .collect(),
            kinematics: self.kinematics,
            positive_z: self.positive_z,
        }
    }

    pub(crate) fn has(&self, axis: Axis) -> bool {
        self.axes.iter().any(|a| a.axis == axis)
    }
}

/// mm or deg in SI.
pub(crate) fn coarse_si(axis: Axis) -> f64 {
    if axis.is_rotation() {
        1f64.to_radians()
    } else {
        1e-3
    }
}
