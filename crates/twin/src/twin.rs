//! The microscope as a whole: its state, its truth, and what may happen to it.

use crate::TwinError;
use crate::adapted::Adapted;
use crate::camera::TwinCamera;
use crate::camera_config::DustConfig;
use crate::config::Config;
use crate::devices::{TwinLight, TwinNosepiece, TwinStage};
use crate::faults::StageFault;
use crate::inner::{Inner, State};
use crate::nosepiece::{NosepieceState, fixed_offsets};
use crate::optics::world_from_pixel;
use crate::seeds;
use crate::sensor::Sensor;
use crate::shown::Shown;
use crate::slide::{Slide, SpecimenEvent};
use crate::specimen::Specimen;
use crate::stage::StageState;
use crate::truth::{TrueCalibration, Truth};
use rand::RngExt;
use scopeservo_scope::{
    Axis, Camera, CameraInfo, ChangeRule, Clock, Devices, Light, Nosepiece, Objective, ObjectiveId,
    Rules, ScopeError, Stage,
};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A simulated microscope. Cheap to clone; all clones are the same microscope.
#[derive(Clone)]
pub struct Twin {
    inner: Arc<Inner>,
}

impl Twin {
    /// Builds the microscope over a specimen. Parcentric and parfocal offsets, dust and all noise come from the seed.
    ///
    /// # Errors
    /// [`TwinError::BadConfig`], as [`Config::check`].
    pub fn new(
        config: Config,
        specimen: Arc<dyn Specimen>,
        seed: u64,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, TwinError> {
        config.check()?;
        let now = clock.now().seconds();
        let camera = &config.camera;
        let mut nosepiece = config.nosepiece.clone();
        if !config.stage.has(Axis::Z) {
            nosepiece.parfocal_um = 0.0;
            nosepiece.focus_repeatability_um = 0.0;
        }
        let stage = StageState::new(config.stage.clone(), seed, now);
        // Focus heights count from the middle of the travel, where the stage starts.
        let start_z = config
            .stage
            .info()
            .axis(Axis::Z)
            .map_or(0.0, |z| 0.5 * (z.min + z.max));
        let ms = |v: f64| Duration::from_secs_f64(v * 1e-3);
        let sensor = Sensor::new(camera, seed);
        let inner = Inner {
            stage_info: config.stage.info(),
            camera_info: CameraInfo {
                name: "simulated camera".into(),
                width: camera.width,
                height: camera.height,
                channels: camera.channels,
                bit_depth: camera.bit_depth,
                min_exposure: ms(camera.exposure_range_ms[0]),
                max_exposure: ms(camera.exposure_range_ms[1]),
            },
            objectives: config
                .optics
                .iter()
                .map(|o| Objective {
                    id: o.id.clone(),
                    magnification: o.magnification,
                    numerical_aperture: o.numerical_aperture,
                    nominal_um_per_px: o.nominal_um_per_px,
                    immersion: o.immersion,
                })
                .collect(),
            offsets: fixed_offsets(&nosepiece, config.optics.len(), seed),
            start_z,
            state: Mutex::new(State {
                stage,
                nosepiece: NosepieceState::new(nosepiece, seed, now),
                slide: Slide::new(&config.slide),
                mount: config.mount.clone(),
                shown: Shown::default(),
                specimen,
                window: sensor.window(),
                hair: None,
                exposure: ms(camera.exposure_ms),
                adapted: Adapted::new(now),
                light: 1.0,
                next_sequence: 0,
                drop_frames: 0,
                late_frames: 0,
                late_by: Duration::ZERO,
                torn: false,
                unplugged: false,
                truths: BTreeMap::new(),
                slide_rng: seeds::rng(seed, seeds::SLIDE, 0),
            }),
            sensor,
            config,
            clock,
        };
        let twin = Self {
            inner: Arc::new(inner),
        };
        twin.centre_specimen([0.0; 2], 0.0);
        Ok(twin)
    }

    /// The stage.
    pub fn stage(&self) -> Box<dyn Stage> {
        Box::new(TwinStage(self.inner.clone()))
    }

    /// The camera.
    pub fn camera(&self) -> Box<dyn Camera> {
        Box::new(TwinCamera(self.inner.clone()))
    }

    /// The nosepiece.
    pub fn nosepiece(&self) -> Box<dyn Nosepiece> {
        Box::new(TwinNosepiece(self.inner.clone()))
    }

    /// The light; fully on at first.
    pub fn light(&self) -> Box<dyn Light> {
        Box::new(TwinLight(self.inner.clone()))
    }

    /// All of its devices.
    pub fn devices(&self) -> Devices {
        Devices {
            stage: Some(self.stage()),
            camera: Some(self.camera()),
            nosepiece: Some(self.nosepiece()),
            light: Some(self.light()),
            clock: self.inner.clock.clone(),
        }
    }

    /// The rules that a careful owner of this microscope would set: its nosepiece turns 2 mm away from the specimen.
    pub fn rules(&self) -> Rules {
        let stage = &self.inner.stage_info;
        let change = match stage.axis(Axis::Z) {
            Some(_) => ChangeRule::Retracted {
                z: stage.positive_z.away(0.0, 2e-3),
                // Objectives are parfocal within the reach of a focus sweep.
                margin: 0.0,
            },
            None => ChangeRule::Anywhere,
        };
        Rules::travel_only(change)
    }

    /// The microscope's make.
    pub fn config(&self) -> &Config {
        &self.inner.config
    }

    /// Lays the slide, right side up, so that the present view's centre lies over `specimen_um`, the specimen turned by
    /// `rotation_deg`.
    pub fn centre_specimen(&self, specimen_um: [f64; 2], rotation_deg: f64) {
        let now = self.inner.now();
        let mut state = self.inner.state();
        let (objective, scatter, _) = state.nosepiece.at(now);
        let world = world_from_pixel(
            &self.inner.config,
            &state.mount,
            &state.stage.truth(now),
            objective,
            self.inner.offset(objective, scatter).centre_um,
        );
        let camera = &self.inner.config.camera;
        let centre = world.apply(crate::optics::principal_point(camera.width, camera.height));
        state
            .slide
            .lay(specimen_um, centre, rotation_deg.to_radians());
    }

    /// Looks once and shows nobody, so that the first frame need not wait for tissue that grows when it is first looked at. Frames are the
    /// same with and without it.
    ///
    /// # Errors
    /// [`ScopeError::Device`] for a slide that cannot be read where the microscope stands.
    pub fn look(&self) -> Result<(), ScopeError> {
        TwinCamera(self.inner.clone()).look()
    }

    /// Takes the slide out and puts it back: turned by `rotation_deg` about the specimen point `about_um`, which then
    /// lies shifted by `shift_um` in the world; `flipped` turns it over, its x axis reversed. It seats a little higher
    /// or lower than before.
    pub fn remount(
        &self,
        about_um: [f64; 2],
        shift_um: [f64; 2],
        rotation_deg: f64,
        flipped: bool,
    ) {
        let mut state = self.inner.state();
        let rise = self.inner.config.slide.seat_um * state.slide_rng.random_range(-1.0..1.0);
        state
            .slide
            .remount(about_um, shift_um, rotation_deg.to_radians(), flipped, rise);
    }

    /// Another specimen in the same place: another slide, or blank glass. Returns the one before.
    pub fn replace_specimen(&self, specimen: Arc<dyn Specimen>) -> Arc<dyn Specimen> {
        let mut state = self.inner.state();
        state.slide.effects = crate::slide::Effects::none();
        std::mem::replace(&mut state.specimen, specimen)
    }

    /// Somebody cleans the camera's window: all dust goes.
    pub fn clean_window(&self) {
        self.inner.state().window = self.inner.sensor.clean_window();
    }

    /// More dust settles on the camera's window, drawn from a seed of its own. What lies there stays.
    ///
    /// # Errors
    /// [`TwinError::BadConfig`], as [`Config::check`].
    pub fn settle_dust(&self, dust: &[DustConfig], seed: u64) -> Result<(), TwinError> {
        dust.iter().try_for_each(DustConfig::check)?;
        let mut state = self.inner.state();
        state.window = self.inner.sensor.settle(&state.window, dust, seed);
        Ok(())
    }

    /// Something happens to the specimen.
    pub fn inject(&self, event: SpecimenEvent) {
        self.inner.state().slide.happen(event);
    }

    /// Something breaks.
    pub fn fault(&self, fault: StageFault) {
        let now = self.inner.now();
        let mut state = self.inner.state();
        match fault {
            StageFault::LostSteps { axis, si } => state.stage.lose_steps(axis, si),
            StageFault::StuckAxis { axis, stuck } => state.stage.stick(axis, stuck, now),
            StageFault::Backlash { axis, si } => state.stage.set_backlash(axis, si),
            StageFault::Goes { xy, rz } => state.stage.go(xy, rz),
            StageFault::FrozenCamera(frozen) => state.shown.freeze(frozen),
            StageFault::StaleFrames(late) => state.shown.lag(late),
            StageFault::SilentCamera(silent) => state.shown.silent = silent,
            StageFault::Binned(count) => state.shown.bin(count),
            StageFault::CameraTurned(deg) => {
                state.mount.phi_deg = self.inner.config.mount.phi_deg + deg;
            }
            StageFault::InBeam(index) => {
                let there = index.filter(|i| *i < self.inner.objectives.len());
                state.nosepiece.put_in_beam(there);
            }
            StageFault::Wall { axis, between } => state.stage.set_wall(axis, between),
            StageFault::TakesAlong { axis, along, si } => {
                state.stage.take_along(axis, along, si);
            }
            StageFault::Misreports { axis, si } => state.stage.misreport(axis, si),
            StageFault::IgnoresStop(ignores) => state.stage.ignore_stops(ignores),
            StageFault::Drift { um_per_s } => state.stage.set_drift(um_per_s, now),
            StageFault::Vibration { um } => state.stage.set_ambient(um),
            StageFault::Hair(hair) => state.hair = hair.map(|hair| (hair, now)),
            StageFault::DropFrames(count) => state.drop_frames += count,
            StageFault::LateFrames { count, delay_s } => {
                state.late_frames = count;
                state.late_by = Duration::try_from_secs_f64(delay_s).unwrap_or(Duration::ZERO);
            }
            StageFault::TornFrame => state.torn = true,
            StageFault::Unplugged(pulled) => {
                state.unplugged = pulled;
                // Without current nothing moves, whatever it obeys.
                state.stage.halt(now);
                state.nosepiece.stop(now);
            }
        }
    }

    /// The truth of a grabbed frame at the middle of its exposure. Kept for every frame.
    pub fn truth(&self, sequence: u64) -> Option<Truth> {
        self.inner.state().truths.get(&sequence).cloned()
    }

    /// The truth of this moment.
    pub fn truth_now(&self) -> Truth {
        let now = self.inner.now();
        let view = self.inner.view(&self.inner.state(), now);
        self.inner.truth(&view, None)
    }

    /// The true calibration of an objective, without the nosepiece's scatter of the moment.
    pub fn true_calibration(&self, objective: &ObjectiveId) -> Option<TrueCalibration> {
        let config = &self.inner.config;
        let i = config.optics.iter().position(|o| o.id == *objective)?;
        let offset = self.inner.offsets[i].centre_um;
        let (optics, mount) = (&config.optics[i], &config.mount);
        Some(TrueCalibration {
            kx: if mount.mirrored {
                -optics.kx_px_per_m
            } else {
                optics.kx_px_per_m
            },
            ky: optics.ky_px_per_m,
            phi_deg: mount.phi_deg,
            eta_mm: [
                mount.eta_mm[0] + offset[0] * 1e-3,
                mount.eta_mm[1] + offset[1] * 1e-3,
            ],
        })
    }
}
