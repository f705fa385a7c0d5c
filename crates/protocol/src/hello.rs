//! What a driver says it is, and whether that makes sense.

use scopeservo_scope::{
    Axis, AxisInfo, CameraInfo, Channels, Immersion, Kinematics, KnownBy, Nosepiece, Objective,
    ObjectiveId, PositiveZ, StageInfo,
};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The largest frame side, pixels.
const MAX_SIDE_PX: usize = 16_384;
/// The longest name of an objective, characters.
const MAX_ID: usize = 100;

/// The reply to `hello`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// The version of the protocol.
    pub protocol: u32,
    /// For people.
    pub name: String,
    /// The stage, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<StageHello>,
    /// The camera, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<CameraHello>,
    /// The nosepiece, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nosepiece: Option<NosepieceHello>,
    /// The light, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<LightHello>,
}

/// A stage on the wire.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageHello {
    /// Maker and model.
    pub name: String,
    /// What it carries.
    pub moves: Moves,
    /// The axes it has.
    pub axes: Vec<AxisHello>,
    /// What larger z does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub positive_z: Option<PositiveZ>,
    /// Whether it knows where it is.
    #[serde(default = "yes")]
    pub homed: bool,
    /// Whether a move may say how fast it goes.
    #[serde(default, skip_serializing_if = "is_no")]
    pub speeds: bool,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "as serde asks")]
fn is_no(said: &bool) -> bool {
    !said
}

fn yes() -> bool {
    true
}

/// [`Kinematics`] in the words of the page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Moves {
    /// The stage carries the microscope.
    Microscope,
    /// The stage carries the specimen, its rotation rides on x and y.
    SpecimenRotationOnTop,
    /// The stage carries the specimen, x and y ride on the rotation, or there is none.
    SpecimenXyOnTop,
}

/// An axis on the wire: um or deg, by its kind.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AxisHello {
    /// Which.
    pub axis: Axis,
    /// Lower end of travel, of a translation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_um: Option<f64>,
    /// Upper end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_um: Option<f64>,
    /// Half-width in which repeated arrivals end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeatability_um: Option<f64>,
    /// How far from its goal it may say that it has settled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arrival_tolerance_um: Option<f64>,
    /// Lower end of travel, of a rotation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_deg: Option<f64>,
    /// Upper end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_deg: Option<f64>,
    /// Half-width in which repeated arrivals end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeatability_deg: Option<f64>,
    /// How far from its goal it may say that it has settled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub arrival_tolerance_deg: Option<f64>,
}

/// A camera on the wire.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraHello {
    /// Maker and model.
    pub name: String,
    /// Columns.
    pub width_px: usize,
    /// Rows.
    pub height_px: usize,
    /// 1 or 3.
    pub channels: u8,
    /// Significant bits per sample, 8 to 16.
    pub bits: u8,
    /// Shortest exposure.
    pub min_exposure_ms: f64,
    /// Longest exposure.
    pub max_exposure_ms: f64,
}

/// A nosepiece on the wire.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NosepieceHello {
    /// Maker and model.
    pub name: String,
    /// What it carries.
    pub objectives: Vec<ObjectiveHello>,
    /// How it knows which one is active.
    #[serde(default, skip_serializing_if = "is_sensed")]
    pub known_by: KnownBy,
}

fn is_sensed(known_by: &KnownBy) -> bool {
    *known_by == KnownBy::Sensor
}

/// An objective on the wire.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObjectiveHello {
    /// Its name.
    pub id: String,
    /// Total magnification.
    pub magnification: f64,
    /// Numerical aperture.
    pub numerical_aperture: f64,
    /// Nominal size of a camera pixel on the specimen.
    pub um_per_px: f64,
    /// What it works in.
    #[serde(default, skip_serializing_if = "Immersion::is_air")]
    pub immersion: Immersion,
}

/// A light on the wire.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LightHello {
    /// Maker and model.
    pub name: String,
}

impl Hello {
    /// Whether what it says of its devices is possible.
    ///
    /// # Errors
    /// A sentence that names the device and what is wrong.
    pub fn check(&self) -> Result<(), String> {
        if let Some(stage) = &self.stage {
            stage.info().map_err(|e| format!("stage: {e}"))?;
        }
        if let Some(camera) = &self.camera {
            camera.info().map_err(|e| format!("camera: {e}"))?;
        }
        if let Some(nosepiece) = &self.nosepiece {
            nosepiece
                .objectives()
                .map_err(|e| format!("nosepiece: {e}"))?;
        }
        Ok(())
    }
}

impl StageHello {
    /// What the rest of the program takes it to be, or what is wrong with it.
    pub(crate) fn info(&self) -> Result<StageInfo, String> {
        let mut axes: Vec<AxisInfo> = Vec::new();
        for hello in &self.axes {
            let axis = hello.axis;
            let (min, max, repeatability, tolerance) = match axis.is_rotation() {
                true => (
                    hello.min_deg,
                    hello.max_deg,
                    hello.repeatability_deg,
                    hello.arrival_tolerance_deg,
                ),
                false => (
                    hello.min_um,
                    hello.max_um,
                    hello.repeatability_um,
                    hello.arrival_tolerance_um,
                ),
            };
            let unit = axis.display_unit();
            let (Some(min), Some(max), Some(repeatability)) = (min, max, repeatability) else {
                return Err(format!(
                    "{axis} needs min_{unit}, max_{unit} and repeatability_{unit}"
                ));
            };
            if !(min < max && min.is_finite() && max.is_finite()) {
                return Err(format!("{axis} must have its min below its max"));
            }
            if axes.iter().any(|a| a.axis == axis) {
                return Err(format!("{axis} is listed twice"));
            }
            let info = AxisInfo {
                axis,
                min: axis.from_display(min),
                max: axis.from_display(max),
                repeatability: axis.from_display(repeatability),
                arrival_tolerance: tolerance.map(|shown| axis.from_display(shown)),
            };
            info.check().map_err(|e| e.to_string())?;
            axes.push(info);
        }
        if axes.is_empty() {
            return Err("the stage has no axes".into());
        }
        let has_z = axes.iter().any(|a| a.axis == Axis::Z);
        if has_z && self.positive_z.is_none() {
            return Err("the stage has a z axis and must say what positive_z does".into());
        }
        Ok(StageInfo {
            name: self.name.clone(),
            axes,
            kinematics: match self.moves {
                Moves::Microscope => Kinematics::MovesMicroscope,
                Moves::SpecimenRotationOnTop => Kinematics::SpecimenRotationOnTop,
                Moves::SpecimenXyOnTop => Kinematics::SpecimenXyOnTop,
            },
            positive_z: self.positive_z.unwrap_or(PositiveZ::Closer),
        })
    }

    pub(crate) fn of(info: &StageInfo, homed: bool, speeds: bool) -> Self {
        Self {
            speeds,
            name: info.name.clone(),
            moves: match info.kinematics {
                Kinematics::MovesMicroscope => Moves::Microscope,
                Kinematics::SpecimenRotationOnTop => Moves::SpecimenRotationOnTop,
                Kinematics::SpecimenXyOnTop => Moves::SpecimenXyOnTop,
            },
            axes: info.axes.iter().map(AxisHello::of).collect(),
            positive_z: info.axis(Axis::Z).map(|_| info.positive_z),
            homed,
        }
    }
}

impl AxisHello {
    fn of(info: &AxisInfo) -> Self {
        let axis = info.axis;
        let [min, max, repeatability] =
            [info.min, info.max, info.repeatability].map(|si| axis.to_display(si));
        let tolerance = info.arrival_tolerance.map(|si| axis.to_display(si));
        let turns = axis.is_rotation();
        let um = |v: f64| (!turns).then_some(v);
        let deg = |v: f64| turns.then_some(v);
        Self {
            axis,
            min_um: um(min),
            max_um: um(max),
            repeatability_um: um(repeatability),
            arrival_tolerance_um: tolerance.filter(|_| !turns),
            min_deg: deg(min),
            max_deg: deg(max),
            repeatability_deg: deg(repeatability),
            arrival_tolerance_deg: tolerance.filter(|_| turns),
        }
    }
}

impl CameraHello {
    pub(crate) fn info(&self) -> Result<CameraInfo, String> {
        let sides = 1..=MAX_SIDE_PX;
        if !(sides.contains(&self.width_px) && sides.contains(&self.height_px)) {
            return Err(format!(
                "the camera's frames are {} x {} px; 1 to {MAX_SIDE_PX} are possible",
                self.width_px, self.height_px
            ));
        }
        let channels = match self.channels {
            1 => Channels::Gray,
            3 => Channels::Rgb,
            other => {
                return Err(format!(
                    "the camera has {other} channels; 1 or 3 are possible"
                ));
            }
        };
        if !(8..=16).contains(&self.bits) {
            return Err(format!(
                "the camera has {} bits; 8 to 16 are possible",
                self.bits
            ));
        }
        let (min, max) = (self.min_exposure_ms, self.max_exposure_ms);
        if !(min > 0.0 && min <= max && max <= 3.6e6) {
            return Err(
                "the camera's exposures must be above 0, at most an hour, and min at most max"
                    .into(),
            );
        }
        Ok(CameraInfo {
            name: self.name.clone(),
            width: self.width_px,
            height: self.height_px,
            channels,
            bit_depth: self.bits,
            min_exposure: Duration::from_secs_f64(min * 1e-3),
            max_exposure: Duration::from_secs_f64(max * 1e-3),
        })
    }

    pub(crate) fn of(info: &CameraInfo) -> Self {
        Self {
            name: info.name.clone(),
            width_px: info.width,
            height_px: info.height,
            channels: info.channels.count() as u8,
            bits: info.bit_depth,
            min_exposure_ms: info.min_exposure.as_secs_f64() * 1e3,
            max_exposure_ms: info.max_exposure.as_secs_f64() * 1e3,
        }
    }
}

/// Bytes of a frame.
pub(crate) fn frame_bytes(info: &CameraInfo) -> usize {
    let deep = if info.bit_depth > 8 { 2 } else { 1 };
    info.width * info.height * info.channels.count() * deep
}

impl NosepieceHello {
    pub(crate) fn objectives(&self) -> Result<Vec<Objective>, String> {
        let mut all: Vec<Objective> = Vec::new();
        for hello in &self.objectives {
            let id = ObjectiveId(hello.id.clone());
            if hello.id.trim().is_empty() || all.iter().any(|o| o.id == id) {
                return Err(format!("the objective '{id}' has no name of its own"));
            }
            // A backslash is also what a character that cannot be shown has become.
            if hello.id.contains('\\') || hello.id.chars().count() > MAX_ID {
                return Err(format!(
                    "the name of the objective '{id}' has a backslash, a character that cannot be shown, or more than {MAX_ID}: give it a \
                     plain one"
                ));
            }
            let objective = Objective {
                id,
                magnification: hello.magnification,
                numerical_aperture: hello.numerical_aperture,
                nominal_um_per_px: hello.um_per_px,
                immersion: hello.immersion,
            };
            objective.check().map_err(|e| e.to_string())?;
            all.push(objective);
        }
        match all.is_empty() {
            true => Err("the nosepiece has no objectives".into()),
            false => Ok(all),
        }
    }

    pub(crate) fn of(name: &str, nosepiece: &dyn Nosepiece) -> Self {
        Self {
            name: name.into(),
            known_by: nosepiece.known_by(),
            objectives: nosepiece
                .objectives()
                .iter()
                .map(|o| ObjectiveHello {
                    id: o.id.0.clone(),
                    magnification: o.magnification,
                    numerical_aperture: o.numerical_aperture,
                    um_per_px: o.nominal_um_per_px,
                    immersion: o.immersion,
                })
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_pages_example_is_understood() {
        let hello: Hello = serde_json::from_value(
            json!({"id":1,"ok":true,"protocol":1,"name":"my stage","stage":{"name":"Acme XY",
            "moves":"specimen_xy_on_top","axes":[
                {"axis":"x","min_um":0,"max_um":50000,"repeatability_um":0.5},
                {"axis":"y","min_um":0,"max_um":40000,"repeatability_um":0.5}]}}),
        )
        .unwrap();
        let stage = hello.stage.unwrap();
        assert!(stage.homed);
        let info = stage.info().unwrap();
        assert!((info.axis(Axis::X).unwrap().max - 0.05).abs() < 1e-12);
        assert_eq!(
            StageHello::of(&info, true, false)
                .info()
                .unwrap()
                .axes
                .len(),
            2
        );
        let mut stated = info.clone();
        stated.axes[0].arrival_tolerance = Some(3e-6);
        let back = StageHello::of(&stated, true, false).info().unwrap();
        assert!((back.axes[0].tolerance() - 3e-6).abs() < 1e-15);
        assert_eq!(back.axes[1].arrival_tolerance, None);
    }

    #[test]
    fn an_objective_works_in_air_unless_it_says_otherwise() {
        let hello = json!({"name":"n","objectives":[
            {"id":"10x","magnification":100.0,"numerical_aperture":0.25,"um_per_px":2.2},
            {"id":"100x","magnification":1000,"numerical_aperture":1.25,"um_per_px":0.2,"immersion":"oil"}]});
        let told: NosepieceHello = serde_json::from_value(hello.clone()).unwrap();
        let media: Vec<Immersion> = told
            .objectives()
            .unwrap()
            .iter()
            .map(|o| o.immersion)
            .collect();
        assert_eq!(media, [Immersion::Air, Immersion::Oil]);
        // As a driver of before it was thought of would say it.
        let back = serde_json::to_value(&told).unwrap();
        assert_eq!(back["objectives"][0], hello["objectives"][0]);
        assert_eq!(back["objectives"][1]["immersion"], "oil");
        let mut odd = hello;
        odd["objectives"][0]["immersion"] = json!("castor oil");
        let said = serde_json::from_value::<NosepieceHello>(odd).unwrap_err();
        assert!(said.to_string().contains("castor oil"), "{said}");
    }

    #[test]
    fn nonsense_is_named() {
        let stage = |axes: serde_json::Value| -> String {
            let hello = json!({"name":"s","moves":"microscope","axes":axes});
            serde_json::from_value::<StageHello>(hello)
                .unwrap()
                .info()
                .unwrap_err()
        };
        for (axes, word) in [
            (json!([]), "no axes"),
            (
                json!([{"axis":"x","min_deg":0,"max_deg":1,"repeatability_deg":0}]),
                "min_um",
            ),
            (
                json!([{"axis":"x","min_um":1,"max_um":1,"repeatability_um":0}]),
                "below",
            ),
            (
                json!([{"axis":"x","min_um":0,"max_um":1,"repeatability_um":-1}]),
                "negative",
            ),
            (
                json!([{"axis":"x","min_um":0,"max_um":1,"repeatability_um":1}]),
                "tenth of the travel",
            ),
            (
                json!([{"axis":"x","min_um":0,"max_um":10000,"repeatability_um":600}]),
                "50 um",
            ),
            (
                json!([{"axis":"x","min_um":0,"max_um":1000,"repeatability_um":1,"arrival_tolerance_um":0}]),
                "arrival tolerance",
            ),
            (
                json!([{"axis":"z","min_um":0,"max_um":1,"repeatability_um":0}]),
                "positive_z",
            ),
            (
                json!([{"axis":"x","min_um":0,"max_um":1,"repeatability_um":0},{"axis":"x","min_um":0,"max_um":1,"repeatability_um":0}]),
                "twice",
            ),
        ] {
            let said = stage(axes);
            assert!(said.contains(word), "{word}: {said}");
        }
        let camera = |field: &str, value: serde_json::Value| {
            let mut hello = json!({"name":"c","width_px":640,"height_px":480,"channels":1,"bits":8,"min_exposure_ms":1,"max_exposure_ms":10});
            hello[field] = value;
            serde_json::from_value::<CameraHello>(hello).unwrap().info()
        };
        assert!(camera("bits", json!(8)).is_ok());
        for (field, value) in [
            ("width_px", json!(0)),
            ("height_px", json!(100_000)),
            ("channels", json!(4)),
            ("bits", json!(24)),
            ("min_exposure_ms", json!(0)),
            ("max_exposure_ms", json!(0.5)),
        ] {
            assert!(camera(field, value).is_err(), "{field}");
        }
    }
}
