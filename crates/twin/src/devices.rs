//! The twin behind the instrument contract.

use crate::inner::{Inner, State};
use crate::optics::View;
use crate::render::{blend, instants, render};
use crate::scene::{Planes, Scene};
use crate::sensor::Exposure;
use crate::slide::Effects;
use crate::specimen::Specimen;
use scopeservo_scope::{
    Camera, CameraInfo, Frame, Light, Motion, Nosepiece, Objective, ObjectiveId, ScopeError, Stage,
    StageInfo, StagePose, Timestamp, check_level,
};
use std::sync::Arc;
use std::time::Duration;

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

pub(crate) struct TwinCamera(pub(crate) Arc<Inner>);

/// One frame on its way: when, and what is wrong with it.
struct Slot {
    sequence: u64,
    start: Duration,
    period: Duration,
    exposure: Duration,
    late_by: Duration,
    torn: bool,
}

impl TwinCamera {
    /// Time from one frame to the next.
    fn period(&self, exposure: Duration) -> Duration {
        let camera = &self.0.config.camera;
        let readout = Duration::from_secs_f64(camera.readout_ms * 1e-3);
        (exposure + readout).max(Duration::from_secs_f64(1.0 / camera.frames_per_s))
    }

    /// Takes the first slot that begins now or later, behind those that are lost.
    fn take_slot(&self) -> Slot {
        let mut state = self.0.state();
        let exposure = state.exposure;
        let period = self.period(exposure);
        let now = self.0.clock.now().since(Timestamp::default());
        let lost = std::mem::take(&mut state.drop_frames);
        let first = now.as_nanos().div_ceil(period.as_nanos()) as u64;
        // 64 bits of nanoseconds are 584 years.
        let start = Duration::from_nanos((first + u64::from(lost)) * period.as_nanos() as u64);
        let sequence = state.next_sequence + u64::from(lost);
        state.next_sequence = sequence + 1;
        let late = state.late_frames > 0;
        state.late_frames = state.late_frames.saturating_sub(1);
        Slot {
            sequence,
            start,
            period,
            exposure,
            late_by: if late { state.late_by } else { Duration::ZERO },
            torn: std::mem::take(&mut state.torn),
        }
    }

    /// The views of one exposure: what to blend, and how far the image moves between two of them.
    fn views(&self, state: &State, start: f64, exposure: f64) -> (Vec<View>, f64) {
        let camera = &self.0.config.camera;
        let at = |share: f64| self.0.view(state, start + share * exposure);
        let three = [at(0.0), at(0.5), at(1.0)];
        let (count, gap_px) = instants(&three, camera.width, camera.height);
        if count == 1 {
            return (vec![three[1]], 0.0);
        }
        let views = (0..count)
            .map(|i| at((i as f64 + 0.5) / count as f64))
            .collect();
        // A third of the gap, as a standard deviation, closes it without widening the smear much.
        (views, if gap_px > 1.0 { gap_px / 3.0 } else { 0.0 })
    }

    /// Looks where the microscope stands now and shows nobody: what the specimen makes up when it is first looked at is there afterwards.
    /// Frames and their numbers stay as they were.
    pub(crate) fn look(&self) -> Result<(), ScopeError> {
        let now = self.0.now();
        let (specimen, effects, view) = {
            let state = self.0.state();
            let view = self.0.view(&state, now);
            (state.specimen.clone(), state.slide.effects.clone(), view)
        };
        self.light(&*specimen, &effects, &(vec![view], 0.0))
            .map(drop)
    }

    fn light(
        &self,
        specimen: &dyn Specimen,
        effects: &Effects,
        (views, smear_px): &(Vec<View>, f64),
    ) -> Result<Planes, ScopeError> {
        let camera = &self.0.config.camera;
        let mut rendered = Vec::with_capacity(views.len());
        for view in views {
            let scene = Scene {
                specimen,
                effects,
                optics: &self.0.config.optics[view.objective],
                width: camera.width,
                height: camera.height,
            };
            let planes = render(&scene, view, *smear_px).map_err(|e| ScopeError::Device {
                device: "camera",
                detail: format!("the simulated specimen could not be read: {e}"),
            })?;
            rendered.push(planes);
        }
        Ok(blend(rendered).unwrap_or_default())
    }
}

impl Camera for TwinCamera {
    fn info(&self) -> &CameraInfo {
        &self.0.camera_info
    }

    fn exposure(&self) -> Result<Duration, ScopeError> {
        Ok(self.0.plugged("camera")?.exposure)
    }

    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
        self.0.camera_info.check_exposure(exposure)?;
        self.0.plugged("camera")?.exposure = exposure;
        Ok(exposure)
    }

    fn grab(&self) -> Result<Frame, ScopeError> {
        drop(self.0.plugged("camera")?);
        let slot = self.take_slot();
        let camera = &self.0.config.camera;
        let readout = Duration::from_secs_f64(camera.readout_ms * 1e-3);
        let ready = slot.start + slot.exposure + readout + slot.late_by;
        let now = self.0.clock.now().since(Timestamp::default());
        self.0.clock.sleep(ready.saturating_sub(now));

        let (start, exposure) = (slot.start.as_secs_f64(), slot.exposure.as_secs_f64());
        let (specimen, effects, window, level, place, middle, views, older) = {
            let mut state = self.0.state();
            let middle = self.0.view(&state, start + 0.5 * exposure);
            let truth = self.0.truth(&middle, Some(slot.sequence));
            state.truths.insert(slot.sequence, truth);
            let older = slot
                .torn
                .then(|| self.views(&state, start - slot.period.as_secs_f64(), exposure));
            (
                state.specimen.clone(),
                state.slide.effects.clone(),
                state.window.clone(),
                state.light,
                state.stage.reported(start + 0.5 * exposure),
                middle,
                self.views(&state, start, exposure),
                older,
            )
        };
        let mut light = self.light(&*specimen, &effects, &views)?;
        if let Some(older) = older {
            let below = self.light(&*specimen, &effects, &older)?;
            let half = camera.width * (camera.height / 2);
            for (l, b) in light.iter_mut().zip(&below) {
                l[half..].copy_from_slice(&b[half..]);
            }
        }
        let samples = self.0.sensor.develop(
            &light,
            &self.0.config.optics[middle.objective],
            &Exposure {
                // Half the light is as dark as half the exposure.
                ms: exposure * 1e3 * level,
                lit: middle.lit,
                sequence: slot.sequence,
                window: &window,
                place: &place,
            },
        );
        Ok(Frame {
            width: camera.width,
            height: camera.height,
            channels: camera.channels,
            bit_depth: camera.bit_depth,
            samples,
            sequence: slot.sequence,
            exposure_start: Timestamp::from_start(slot.start),
            exposure: slot.exposure,
        })
    }
}
