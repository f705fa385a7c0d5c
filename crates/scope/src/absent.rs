//! What stands where a device is missing.

use crate::{
    Camera, CameraInfo, Channels, Frame, Kinematics, Motion, Nosepiece, Objective, ObjectiveId,
    PositiveZ, ScopeError, Stage, StageInfo, StagePose,
};
use std::time::Duration;

/// A stage without axes, a nosepiece without objectives, or a camera without pixels.
#[derive(Debug)]
pub struct Absent {
    stage: StageInfo,
    camera: CameraInfo,
}

impl Absent {
    /// For one of the three.
    pub fn new() -> Self {
        Self {
            stage: StageInfo {
                name: "none".into(),
                axes: Vec::new(),
                kinematics: Kinematics::SpecimenXyOnTop,
                positive_z: PositiveZ::Closer,
            },
            camera: CameraInfo {
                name: "none".into(),
                width: 0,
                height: 0,
                channels: Channels::Gray,
                bit_depth: 8,
                min_exposure: Duration::ZERO,
                max_exposure: Duration::ZERO,
            },
        }
    }
}

impl Default for Absent {
    fn default() -> Self {
        Self::new()
    }
}

fn none<T>(device: &'static str) -> Result<T, ScopeError> {
    Err(ScopeError::Refused {
        device,
        detail: "there is none".into(),
    })
}

impl Stage for Absent {
    fn info(&self) -> &StageInfo {
        &self.stage
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        Ok(StagePose::default())
    }
    fn start_move(&self, _: &StagePose) -> Result<(), ScopeError> {
        none("stage")
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        Ok(Motion::Settled)
    }
    fn stop(&self) -> Result<(), ScopeError> {
        Ok(())
    }
}

impl Nosepiece for Absent {
    fn objectives(&self) -> &[Objective] {
        &[]
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        Ok(None)
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        Err(ScopeError::NoSuchObjective {
            asked: to.clone(),
            available: "none".into(),
        })
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        Ok(Motion::Settled)
    }
    fn stop(&self) -> Result<(), ScopeError> {
        Ok(())
    }
}

impl Camera for Absent {
    fn info(&self) -> &CameraInfo {
        &self.camera
    }
    fn exposure(&self) -> Result<Duration, ScopeError> {
        none("camera")
    }
    fn set_exposure(&self, _: Duration) -> Result<Duration, ScopeError> {
        none("camera")
    }
    fn grab(&self) -> Result<Frame, ScopeError> {
        none("camera")
    }
}
