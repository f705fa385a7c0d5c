//! The devices of a driver, behind the contracts of the rest of the program.

use crate::hello::frame_bytes;
use crate::link::{CallError, Link, Reply, Wait};
use crate::message::{Call, Code, Go, MotionReply, Place};
use crate::patience::{ANSWER, Patience};
use scopeservo_scope::{
    Camera, CameraInfo, Clock, Frame, KnownBy, Light, Motion, Nosepiece, Objective, ObjectiveId,
    Samples, ScopeError, Stage, StageInfo, StagePose, check_level, check_speed,
};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Clocks of two programs tick apart by less than this within one frame.
const CLOCK_SLACK: Duration = Duration::from_millis(2);

/// One device of a driver: one request at a time, but for stops. Clones are the same device.
#[derive(Clone)]
pub(crate) struct Remote {
    link: Link,
    device: &'static str,
    one: Arc<Mutex<()>>,
}

impl Remote {
    pub(crate) fn new(link: Link, device: &'static str) -> Self {
        Self {
            link,
            device,
            one: Arc::default(),
        }
    }

    fn turn(&self) -> MutexGuard<'_, ()> {
        // It guards no data.
        self.one.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn ask(&self, call: Call) -> Result<Reply, ScopeError> {
        let _turn = self.turn();
        self.link.ask(call, ANSWER).map_err(|e| self.error(e))
    }

    /// The reply as a value; nonsense ends the connection.
    pub(crate) fn ask_for<T: DeserializeOwned>(&self, call: Call) -> Result<T, ScopeError> {
        let reply = self.ask(call)?;
        self.read(&reply)
    }

    fn read<T: DeserializeOwned>(&self, reply: &Reply) -> Result<T, ScopeError> {
        serde_json::from_value(serde_json::Value::Object(reply.object.clone()))
            .map_err(|error| self.nonsense(&error.to_string()))
    }

    fn nonsense(&self, what: &str) -> ScopeError {
        self.link.break_off(&format!("it sent nonsense: {what}"));
        self.link.lost(self.device)
    }

    /// Stops everything. Waits for no other request.
    fn stop(&self) -> Result<(), ScopeError> {
        let asked = self.link.ask(Call::Stop, ANSWER);
        asked.map(drop).map_err(|e| self.error(e))
    }

    /// Asks for the place of a stage while a frame is late: whatever it answers it is there, and silence ends the connection.
    fn is_there(&self) {
        let _turn = self.turn();
        let wait = Wait {
            before: "'grab', and then not ",
            ..Wait::within(ANSWER)
        };
        let _ = self.link.ask_while(Call::Position, 0, &wait);
    }

    fn error(&self, error: CallError) -> ScopeError {
        let device = self.device;
        match error {
            CallError::Lost(detail) => ScopeError::Lost { device, detail },
            CallError::Said { code, message, .. } => match code {
                Code::Busy => ScopeError::Busy { device },
                Code::NotHomed => ScopeError::NotHomed { device },
                Code::Fault | Code::BadRequest => ScopeError::Device {
                    device,
                    detail: message,
                },
                Code::Unsupported
                | Code::OutsideLimits
                | Code::NoSuchAxis
                | Code::NoSuchObjective
                | Code::Refused
                | Code::Secret => ScopeError::Refused {
                    device,
                    detail: message,
                },
            },
        }
    }
}

/// A stage of a driver.
pub(crate) struct RemoteStage {
    remote: Remote,
    info: StageInfo,
    knows_speeds: bool,
    reference: Mutex<Reference>,
}

/// What the driver said at first, and what came of homing since.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reference {
    Known,
    Unknown,
    Sought,
}

impl RemoteStage {
    pub(crate) fn new(remote: Remote, info: StageInfo, homed: bool, knows_speeds: bool) -> Self {
        let reference = match homed {
            true => Reference::Known,
            false => Reference::Unknown,
        };
        Self {
            remote,
            info,
            knows_speeds,
            reference: Mutex::new(reference),
        }
    }

    fn go(&self, to: &StagePose, speed_um_per_s: Option<f64>) -> Result<(), ScopeError> {
        let to = Place::from(to);
        let go = Go { to, speed_um_per_s };
        self.remote.ask(Call::Move(go)).map(drop)
    }

    fn reference(&self) -> MutexGuard<'_, Reference> {
        self.reference
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

impl Stage for RemoteStage {
    fn info(&self) -> &StageInfo {
        &self.info
    }

    fn position(&self) -> Result<StagePose, ScopeError> {
        let pose = StagePose::from(self.remote.ask_for::<Place>(Call::Position)?);
        for axis in &self.info.axes {
            if !pose.si(axis.axis).is_some_and(f64::is_finite) {
                let what = format!("the position lacks {}", axis.axis);
                return Err(self.remote.nonsense(&what));
            }
        }
        Ok(pose)
    }

    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        self.go(to, None)
    }

    fn start_move_at(&self, to: &StagePose, m_per_s: f64) -> Result<(), ScopeError> {
        check_speed(m_per_s)?;
        if !self.knows_speeds {
            return Err(ScopeError::Refused {
                device: "stage",
                detail: "its driver knows no speeds (\"speeds\" in its hello)".into(),
            });
        }
        self.go(to, Some(m_per_s * 1e6))
    }

    fn knows_speeds(&self) -> bool {
        self.knows_speeds
    }

    fn poll(&self) -> Result<Motion, ScopeError> {
        let motion = self.remote.ask_for::<MotionReply>(Call::Motion)?.motion;
        let mut reference = self.reference();
        *reference = match (*reference, motion) {
            (Reference::Sought, Motion::Settled) => Reference::Known,
            (Reference::Sought, Motion::Stopped) => Reference::Unknown,
            (as_before, _) => as_before,
        };
        Ok(motion)
    }

    fn stop(&self) -> Result<(), ScopeError> {
        self.remote.stop()
    }

    fn is_homed(&self) -> Result<bool, ScopeError> {
        Ok(*self.reference() == Reference::Known)
    }

    fn start_homing(&self) -> Result<(), ScopeError> {
        self.remote.ask(Call::Home)?;
        *self.reference() = Reference::Sought;
        Ok(())
    }
}

/// A nosepiece of a driver.
pub(crate) struct RemoteNosepiece {
    pub(crate) remote: Remote,
    pub(crate) objectives: Vec<Objective>,
    pub(crate) known_by: KnownBy,
}

#[derive(Deserialize)]
struct ObjectiveReply {
    objective: Option<String>,
    motion: Motion,
}

impl RemoteNosepiece {
    fn now(&self) -> Result<(Option<ObjectiveId>, Motion), ScopeError> {
        let now: ObjectiveReply = self.remote.ask_for(Call::Objective)?;
        let id = now.objective.map(ObjectiveId);
        if let Some(id) = &id
            && self.objectives.iter().all(|o| o.id != *id)
        {
            return Err(self.remote.nonsense(&format!("there is no objective {id}")));
        }
        Ok((id, now.motion))
    }
}

impl Nosepiece for RemoteNosepiece {
    fn objectives(&self) -> &[Objective] {
        &self.objectives
    }

    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        let (id, motion) = self.now()?;
        Ok(id.filter(|_| motion != Motion::Moving))
    }

    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        let objective = to.0.clone();
        self.remote.ask(Call::Change { objective }).map(drop)
    }

    fn poll(&self) -> Result<Motion, ScopeError> {
        Ok(self.now()?.1)
    }

    fn stop(&self) -> Result<(), ScopeError> {
        self.remote.stop()
    }

    fn known_by(&self) -> KnownBy {
        self.known_by
    }
}

/// A camera of a driver.
pub(crate) struct RemoteCamera {
    pub(crate) remote: Remote,
    pub(crate) info: CameraInfo,
    pub(crate) clock: Arc<dyn Clock>,
    /// The stage of the same driver, which answers also while a frame is exposed.
    pub(crate) stage: Option<Remote>,
    pub(crate) patience: Patience,
    /// The number of the last frame.
    pub(crate) last: Mutex<Option<u64>>,
}

#[derive(Deserialize)]
struct ExposureReply {
    exposure_ms: f64,
}

#[derive(Deserialize)]
struct FrameReply {
    width_px: usize,
    height_px: usize,
    channels: usize,
    bits: u8,
    exposure_ms: f64,
    sequence: u64,
    age_ms: f64,
}

impl RemoteCamera {
    fn duration(&self, ms: f64, what: &str) -> Result<Duration, ScopeError> {
        if ms >= 0.0 {
            // Above the number of nanoseconds that a duration holds it is nonsense, too.
            if let Ok(duration) = Duration::try_from_secs_f64(ms * 1e-3) {
                return Ok(duration);
            }
        }
        Err(self.remote.nonsense(&format!("{what} is {ms} ms")))
    }

    /// A number that does not rise is that of an image which was sent before.
    fn counts(&self, sequence: u64) -> Result<(), ScopeError> {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        match last.replace(sequence) {
            Some(before) if before >= sequence => Err(ScopeError::Device {
                device: "camera",
                detail: format!(
                    "frame {sequence} came after frame {before}: the driver must count its frames (sequence), and send each only once"
                ),
            }),
            _ => Ok(()),
        }
    }

    fn ask_exposure(&self, exposure_ms: Option<f64>) -> Result<Duration, ScopeError> {
        let reply: ExposureReply = self.remote.ask_for(Call::Exposure { exposure_ms })?;
        let exposure = self.duration(reply.exposure_ms, "the exposure")?;
        // Waiting for a frame leans on it: what it said it cannot do is nonsense.
        if exposure > self.info.max_exposure + self.info.max_exposure / 100 + CLOCK_SLACK {
            let what = format!(
                "an exposure of {} ms, beyond its longest",
                reply.exposure_ms
            );
            return Err(self.remote.nonsense(&what));
        }
        Ok(exposure)
    }
}

impl Camera for RemoteCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn exposure(&self) -> Result<Duration, ScopeError> {
        self.ask_exposure(None)
    }

    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
        self.info.check_exposure(exposure)?;
        self.ask_exposure(Some(exposure.as_secs_f64() * 1e3))
    }

    fn grab(&self) -> Result<Frame, ScopeError> {
        let info = &self.info;
        let exposure = self.exposure()?;
        let is_there = || {
            if let Some(stage) = &self.stage {
                stage.is_there();
            }
        };
        let wait = Wait {
            late: exposure + self.patience.late,
            is_there: &is_there,
            ..Wait::within(exposure + self.patience.frame)
        };
        let turn = self.remote.turn();
        let (asked, asked_at) = (self.clock.now(), Instant::now());
        let reply = self
            .remote
            .link
            .ask_while(Call::Grab, frame_bytes(info), &wait)
            .map_err(|e| self.remote.error(e))?;
        drop(turn);
        let head: FrameReply = self.remote.read(&reply)?;
        let shape = (head.width_px, head.height_px, head.channels, head.bits);
        let agreed = (
            info.width,
            info.height,
            info.channels.count(),
            info.bit_depth,
        );
        if shape != agreed || reply.bytes.len() != frame_bytes(info) {
            let what = format!("a frame of {shape:?} where {agreed:?} was agreed on");
            return Err(self.remote.nonsense(&what));
        }
        self.counts(head.sequence)?;
        let age = self.duration(head.age_ms, "the frame's age")?;
        let since_asked = reply.at.saturating_duration_since(asked_at);
        if age > since_asked + CLOCK_SLACK {
            return Err(ScopeError::Device {
                device: "camera",
                detail: format!(
                    "a frame that began {:.0} ms before it was asked for: the driver must not answer from a buffer",
                    (age - since_asked).as_secs_f64() * 1e3
                ),
            });
        }
        let samples = match info.bit_depth {
            ..=8 => Samples::U8(reply.bytes),
            _ => Samples::U16(
                reply
                    .bytes
                    .chunks_exact(2)
                    .map(|b| u16::from_le_bytes([b[0], b[1]]))
                    .collect(),
            ),
        };
        Ok(Frame {
            width: info.width,
            height: info.height,
            channels: info.channels,
            bit_depth: info.bit_depth,
            samples,
            sequence: head.sequence,
            exposure_start: asked.after(since_asked.saturating_sub(age)),
            exposure: self.duration(head.exposure_ms, "the exposure")?,
        })
    }
}

#[derive(Deserialize)]
struct LightReply {
    level: f64,
}

/// A light of a driver.
pub(crate) struct RemoteLight(pub(crate) Remote);

impl RemoteLight {
    fn ask(&self, level: Option<f64>) -> Result<f64, ScopeError> {
        let reply: LightReply = self.0.ask_for(Call::Light { level })?;
        match check_level(reply.level) {
            Ok(()) => Ok(reply.level),
            Err(_) => Err(self
                .0
                .nonsense(&format!("a light level of {}", reply.level))),
        }
    }
}

impl Light for RemoteLight {
    fn level(&self) -> Result<f64, ScopeError> {
        self.ask(None)
    }

    fn set_level(&self, level: f64) -> Result<f64, ScopeError> {
        check_level(level)?;
        self.ask(Some(level))
    }
}
