//! The twin behind the instrument contract: what moves, and the light.

use crate::inner::Inner;
use scopeservo_scope::{
    Light, Motion, Nosepiece, Objective, ObjectiveId, ScopeError, Stage, StageInfo, StagePose,
    check_level, check_speed,
};
use std::sync::Arc;

pub(crate) struct TwinStage(pub(crate) Arc<Inner>);

impl Stage for TwinStage {
    fn info(&self) -> &StageInfo {
        &self.0.stage_info
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        let now = self.0.now();
        Ok(self.0.plugged("stage")?.stage.reported(now))
    }
    fn start_move(&self, to: &StagePose) -> Result<(), ScopeError> {
        let now = self.0.now();
        self.0.plugged("stage")?.stage.start_move(to, now)
    }
    fn start_move_at(&self, to: &StagePose, m_per_s: f64) -> Result<(), ScopeError> {
        check_speed(m_per_s)?;
        let now = self.0.now();
        let mut state = self.0.plugged("stage")?;
        state.stage.start_move_at(to, m_per_s, now)
    }
    fn knows_speeds(&self) -> bool {
        true
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        let now = self.0.now();
        Ok(self.0.plugged("stage")?.stage.motion(now))
    }
    fn stop(&self) -> Result<(), ScopeError> {
        let now = self.0.now();
        self.0.plugged("stage")?.stage.stop(now);
        Ok(())
    }
}

pub(crate) struct TwinNosepiece(pub(crate) Arc<Inner>);

impl Nosepiece for TwinNosepiece {
    fn objectives(&self) -> &[Objective] {
        &self.0.objectives
    }
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError> {
        let now = self.0.now();
        let index = self.0.plugged("nosepiece")?.nosepiece.current(now);
        Ok(index.map(|i| self.0.objectives[i].id.clone()))
    }
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError> {
        let all = &self.0.objectives;
        let Some(index) = all.iter().position(|o| o.id == *to) else {
            let names: Vec<&str> = all.iter().map(|o| o.id.0.as_str()).collect();
            return Err(ScopeError::NoSuchObjective {
                asked: to.clone(),
                available: names.join(", "),
            });
        };
        let now = self.0.now();
        self.0
            .plugged("nosepiece")?
            .nosepiece
            .start_change(index, now)
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        let now = self.0.now();
        Ok(self.0.plugged("nosepiece")?.nosepiece.motion(now))
    }
    fn stop(&self) -> Result<(), ScopeError> {
        let now = self.0.now();
        self.0.plugged("nosepiece")?.nosepiece.stop(now);
        Ok(())
    }
}

pub(crate) struct TwinLight(pub(crate) Arc<Inner>);

impl Light for TwinLight {
    fn level(&self) -> Result<f64, ScopeError> {
        Ok(self.0.plugged("light")?.light)
    }
    fn set_level(&self, level: f64) -> Result<f64, ScopeError> {
        check_level(level)?;
        self.0.plugged("light")?.light = level;
        Ok(level)
    }
}
