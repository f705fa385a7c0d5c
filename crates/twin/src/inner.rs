//! What the devices of one microscope share.

use crate::adapted::Adapted;
use crate::config::{Config, MountConfig};
use crate::faults::DriftingHair;
use crate::nosepiece::{NosepieceState, Offset};
use crate::optics::{View, view};
use crate::sensor::Sensor;
use crate::shown::Shown;
use crate::slide::Slide;
use crate::specimen::Specimen;
use crate::stage::StageState;
use crate::truth::Truth;
use rand_pcg::Pcg64Mcg;
use scopeservo_scope::{CameraInfo, Clock, Objective, ScopeError, StageInfo};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// What never changes, and the state behind its lock.
pub(crate) struct Inner {
    pub(crate) config: Config,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) stage_info: StageInfo,
    pub(crate) camera_info: CameraInfo,
    pub(crate) objectives: Vec<Objective>,
    pub(crate) sensor: Sensor,
    pub(crate) offsets: Vec<Offset>,
    pub(crate) start_z: f64,
    pub(crate) state: Mutex<State>,
}

/// What changes.
pub(crate) struct State {
    pub(crate) stage: StageState,
    pub(crate) nosepiece: NosepieceState,
    pub(crate) slide: Slide,
    /// As the camera sits now.
    pub(crate) mount: MountConfig,
    pub(crate) shown: Shown,
    pub(crate) specimen: Arc<dyn Specimen>,
    /// Light that passes the camera's window, per pixel.
    pub(crate) window: Arc<Vec<f32>>,
    /// A hair that drifts past the window, and since when.
    pub(crate) hair: Option<(DriftingHair, f64)>,
    pub(crate) exposure: Duration,
    pub(crate) adapted: Adapted,
    /// Level of the lamp, 0 to 1.
    pub(crate) light: f64,
    pub(crate) next_sequence: u64,
    pub(crate) drop_frames: u32,
    pub(crate) late_frames: u32,
    pub(crate) late_by: Duration,
    pub(crate) torn: bool,
    /// Whether the plug is pulled.
    pub(crate) unplugged: bool,
    pub(crate) truths: BTreeMap<u64, Truth>,
    pub(crate) slide_rng: Pcg64Mcg,
}

impl Inner {
    pub(crate) fn state(&self) -> MutexGuard<'_, State> {
        // A panic elsewhere leaves plain numbers behind, none of them half written.
        self.state.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// The state, for a device that is asked.
    pub(crate) fn plugged(
        &self,
        device: &'static str,
    ) -> Result<MutexGuard<'_, State>, ScopeError> {
        let state = self.state();
        match state.unplugged {
            true => Err(ScopeError::Lost {
                device,
                detail: "its plug was pulled".into(),
            }),
            false => Ok(state),
        }
    }

    pub(crate) fn now(&self) -> f64 {
        self.clock.now().seconds()
    }

    /// What is seen at a moment, seconds.
    pub(crate) fn view(&self, state: &State, t: f64) -> View {
        let (objective, scatter, lit) = state.nosepiece.at(t);
        view(
            &self.config,
            (&state.mount, &state.slide),
            &state.stage.truth(t),
            self.start_z,
            (objective, self.offset(objective, scatter)),
            lit,
        )
    }

    pub(crate) fn offset(&self, objective: usize, scatter: Offset) -> Offset {
        let fixed = self.offsets[objective];
        Offset {
            centre_um: [
                fixed.centre_um[0] + scatter.centre_um[0],
                fixed.centre_um[1] + scatter.centre_um[1],
            ],
            focus_um: fixed.focus_um + scatter.focus_um,
        }
    }

    pub(crate) fn truth(&self, view: &View, sequence: Option<u64>) -> Truth {
        Truth::new(
            view,
            sequence,
            &self.config.optics[view.objective].id,
            &self.config.stage,
            [self.config.camera.width, self.config.camera.height],
        )
    }
}
