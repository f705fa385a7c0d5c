//! What is said: calls and the codes of refusals.

use scopeservo_scope::{Axis, Motion, StagePose};
use serde::{Deserialize, Serialize};

/// The version of the protocol.
pub const PROTOCOL: u32 = 1;

/// A place of the stage, or goals of some of its axes, in the units of the wire.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// Along x.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x_um: Option<f64>,
    /// Along y.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y_um: Option<f64>,
    /// Focus.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub z_um: Option<f64>,
    /// About x.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rx_deg: Option<f64>,
    /// About y.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ry_deg: Option<f64>,
    /// About z.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rz_deg: Option<f64>,
}

impl Place {
    fn axes(&mut self) -> [(Axis, &mut Option<f64>); 6] {
        [
            (Axis::X, &mut self.x_um),
            (Axis::Y, &mut self.y_um),
            (Axis::Z, &mut self.z_um),
            (Axis::Rx, &mut self.rx_deg),
            (Axis::Ry, &mut self.ry_deg),
            (Axis::Rz, &mut self.rz_deg),
        ]
    }
}

impl From<&StagePose> for Place {
    fn from(pose: &StagePose) -> Self {
        let mut place = Self::default();
        for (axis, slot) in place.axes() {
            *slot = pose.si(axis).map(|si| axis.to_display(si));
        }
        place
    }
}

impl From<Place> for StagePose {
    fn from(mut place: Place) -> Self {
        place
            .axes()
            .into_iter()
            .fold(StagePose::default(), |pose, (axis, slot)| match slot {
                Some(shown) => pose.with_si(axis, axis.from_display(*shown)),
                None => pose,
            })
    }
}

/// Goals of a move, and how fast it may go.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Go {
    /// Where to.
    #[serde(flatten)]
    pub to: Place,
    /// Along the way, where that is below the usual speed. Only a stage that knows speeds is sent it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_um_per_s: Option<f64>,
}

/// What is asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "call", rename_all = "snake_case")]
pub enum Call {
    /// Who is there.
    Hello {
        /// [`PROTOCOL`].
        protocol: u32,
        /// Who asks, for people.
        client: String,
        /// That the caller knows the secret.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        proof: Option<String>,
    },
    /// Where the stage is.
    Position,
    /// Go there.
    Move(Go),
    /// What the stage is doing.
    Motion,
    /// Find the reference.
    Home,
    /// Everything stops.
    Stop,
    /// Which objective is active, and what the nosepiece is doing.
    Objective,
    /// Bring an objective into the beam.
    Change {
        /// Which.
        objective: String,
    },
    /// The exposure, set when given.
    Exposure {
        /// Milliseconds.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        exposure_ms: Option<f64>,
    },
    /// A fresh frame.
    Grab,
    /// The light, set when given.
    Light {
        /// 0 to 1.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        level: Option<f64>,
    },
    /// The end.
    Bye,
}

/// A call with its number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Request {
    /// Its number.
    pub(crate) id: u64,
    /// What is asked.
    #[serde(flatten)]
    pub(crate) call: Call,
}

/// Why a call was not carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Code {
    /// The request cannot be understood.
    BadRequest,
    /// There is no such call or device.
    Unsupported,
    /// Outside what the device can do.
    OutsideLimits,
    /// The stage lacks the axis.
    NoSuchAxis,
    /// The nosepiece lacks the objective.
    NoSuchObjective,
    /// An earlier command still runs.
    Busy,
    /// The device must be homed first.
    NotHomed,
    /// Any other reason.
    Refused,
    /// The caller must prove that it knows the secret.
    Secret,
    /// The device failed.
    Fault,
}

/// The reply to `motion`: [`Motion`] in the same words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct MotionReply {
    /// What the device is doing.
    pub(crate) motion: Motion,
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn calls_look_as_the_page_says() {
        let place = Place {
            x_um: Some(300.5),
            ..Place::default()
        };
        for (call, wire) in [
            (Call::Position, json!({"id": 7, "call": "position"})),
            (
                Call::Move(Go {
                    to: place,
                    speed_um_per_s: None,
                }),
                json!({"id": 7, "call": "move", "x_um": 300.5}),
            ),
            (
                Call::Move(Go {
                    to: place,
                    speed_um_per_s: Some(860.0),
                }),
                json!({"id": 7, "call": "move", "x_um": 300.5, "speed_um_per_s": 860.0}),
            ),
            (
                Call::Exposure { exposure_ms: None },
                json!({"id": 7, "call": "exposure"}),
            ),
            (
                Call::Change {
                    objective: "40x".into(),
                },
                json!({"id": 7, "call": "change", "objective": "40x"}),
            ),
        ] {
            let request = Request { id: 7, call };
            assert_eq!(serde_json::to_value(&request).unwrap(), wire);
            assert_eq!(serde_json::from_value::<Request>(wire).unwrap(), request);
        }
        let later = json!({"id": 7, "call": "grab", "new_in_version_2": {"a": 1}});
        let read: Request = serde_json::from_value(later).unwrap();
        assert_eq!(read.call, Call::Grab);
    }

    #[test]
    fn places_are_micrometres_and_degrees() {
        let place = Place {
            x_um: Some(12.5),
            rz_deg: Some(-90.0),
            ..Place::default()
        };
        let pose = StagePose::from(place);
        assert!((pose.si(Axis::X).unwrap() - 12.5e-6).abs() < 1e-18);
        assert!((pose.si(Axis::Rz).unwrap() + std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert_eq!(pose.si(Axis::Y), None);
        let back = Place::from(&pose);
        assert!((back.x_um.unwrap() - 12.5).abs() < 1e-9 && back.y_um.is_none());
    }
}
