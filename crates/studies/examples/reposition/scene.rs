//! An instrument, a specimen, a place on it, and how the slide is put back: all from a number.

use scopeservo_geometry::SplitMix64;
use scopeservo_scope::{
    Camera, CancelToken, Clock, Devices, Instrument, ObjectiveId, VirtualClock,
};
use scopeservo_servo::{
    Bring, Calibrate, CalibrateOptions, Calibration, FocusOptions, NoSink, VisionOptions, run,
};
use scopeservo_studies::rounds::Outcome;
use scopeservo_twin::specimen::{FileSpecimen, Specimen, Tissue};
use scopeservo_twin::{Config, StageConfig, Twin};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// Slides, um per pixel, and half of what of them is tissue, um.
const SLIDES: [(&str, f64, f64); 5] = [
    ("carcinoma_he.png", 0.5, 150.0),
    ("skin_he.svs", 0.499, 150.0),
    ("liver_he.jpg", 0.49, 150.0),
    ("liver_sirius_red.jpg", 0.49, 150.0),
    ("embryo_section.png", 0.258, 100.0),
];
const TISSUE_HALF_UM: f64 = 300.0;
/// Different instruments of each kind.
const SEEDS: u64 = 2;
/// Within this of the lowest view's middle the target is in it, um: half of 1058 um less half of 246 um.
const INSIDE_UM: [f64; 2] = [540.0, 400.0];

/// What moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// The paper's hexapod, which carries the microscope by a lever of 125 mm: its travel allows 7 deg.
    Hexapod,
    /// A turntable under the specimen: any angle.
    Turntable,
}

/// A specimen and its name.
type Named = (String, Arc<dyn Specimen>);

/// One run.
pub(crate) struct Scene {
    pub(crate) kind: Kind,
    /// Of the instrument.
    pub(crate) seed: u64,
    /// Number of the specimen; 0 is tissue.
    pub(crate) specimen: usize,
    pub(crate) target_um: [f64; 2],
    /// Where the view's centre lies afterwards, from the target, um.
    pub(crate) start_um: [f64; 2],
    pub(crate) turn_deg: f64,
    /// Shot noise at mid grey over full scale.
    pub(crate) noise: f64,
    /// Which objective is in when the run begins.
    pub(crate) begins_with: &'static str,
    /// The target's.
    pub(crate) saved_with: &'static str,
    /// Which others are focused before the target is saved.
    pub(crate) focused_before: &'static [&'static str],
}

pub(crate) fn draw(index: u64) -> Scene {
    let mut rng = SplitMix64::new(0x5E4B_0AC4 ^ index.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    let mut within = |half: f64| (2.0 * rng.uniform() - 1.0) * half;
    let kind = if index.is_multiple_of(2) {
        Kind::Hexapod
    } else {
        Kind::Turntable
    };
    let specimen = (index / 2 % (SLIDES.len() as u64 + 1)) as usize;
    let half_um = match specimen {
        0 => TISSUE_HALF_UM,
        k => SLIDES[k - 1].2,
    };
    let target_um = [within(half_um), within(half_um)];
    let start_um = INSIDE_UM.map(&mut within);
    let turn_deg = match kind {
        Kind::Hexapod => within(6.0),
        Kind::Turntable => within(175.0),
    };
    Scene {
        kind,
        seed: 1 + index / 12 % SEEDS,
        specimen,
        target_um,
        start_um,
        turn_deg,
        noise: 0.0025 * f64::powf(4.0, 0.5 + 0.5 * within(1.0)),
        begins_with: if (index / 24).is_multiple_of(2) {
            "40x"
        } else {
            "10x"
        },
        saved_with: "40x",
        focused_before: &[],
    }
}

impl Scene {
    /// Its name, and what it is.
    pub(crate) fn specimen(&self) -> Outcome<Named> {
        Self::specimen_of(self.specimen)
    }

    /// One of the others, by a number.
    pub(crate) fn another_specimen(&self, number: usize) -> Outcome<Arc<dyn Specimen>> {
        let step = 1 + number % SLIDES.len();
        Ok(Self::specimen_of((self.specimen + step) % (SLIDES.len() + 1))?.1)
    }

    /// Read once, and what of it was painted serves all runs.
    fn specimen_of(number: usize) -> Outcome<Named> {
        static KNOWN: Mutex<BTreeMap<usize, Named>> = Mutex::new(BTreeMap::new());
        let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(one) = known.get(&number) {
            return Ok(one.clone());
        }
        let folder = std::env::var_os("SCOPESERVO_SPECIMENS");
        let one: Named = match (number, folder) {
            (k, Some(folder)) if k > 0 => {
                let (name, um_per_px, _) = SLIDES[k - 1];
                let slide = FileSpecimen::open(&Path::new(&folder).join(name), Some(um_per_px))?;
                (name.into(), Arc::new(slide))
            }
            (k, _) => (format!("tissue {k}"), Arc::new(Tissue::new(k as u64 + 1))),
        };
        known.insert(number, one.clone());
        Ok(one)
    }
}

/// A microscope and its instrument.
pub(crate) struct Bench {
    pub(crate) twin: Twin,
    pub(crate) scope: Instrument,
}

impl Bench {
    pub(crate) fn new(
        (kind, seed): (Kind, u64),
        noise: f64,
        specimen: Arc<dyn Specimen>,
    ) -> Outcome<Self> {
        Self::seen_by((kind, seed), noise, specimen, |camera| camera)
    }

    /// The same through a camera that somebody does something to.
    pub(crate) fn seen_by(
        (kind, seed): (Kind, u64),
        noise: f64,
        specimen: Arc<dyn Specimen>,
        camera: impl FnOnce(Box<dyn Camera>) -> Box<dyn Camera>,
    ) -> Outcome<Self> {
        Self::of(
            (kind, seed),
            noise,
            specimen,
            camera,
            Arc::new(VirtualClock::new()),
        )
    }

    /// The same by a clock of one's own.
    pub(crate) fn timed_by(
        (kind, seed): (Kind, u64),
        noise: f64,
        specimen: Arc<dyn Specimen>,
        clock: Arc<dyn Clock>,
    ) -> Outcome<Self> {
        Self::of((kind, seed), noise, specimen, |camera| camera, clock)
    }

    fn of(
        (kind, seed): (Kind, u64),
        noise: f64,
        specimen: Arc<dyn Specimen>,
        camera: impl FnOnce(Box<dyn Camera>) -> Box<dyn Camera>,
        clock: Arc<dyn Clock>,
    ) -> Outcome<Self> {
        let mut config = Config::realistic();
        if kind == Kind::Turntable {
            config = config.with_stage(StageConfig::xyz_theta());
        }
        config.camera.full_well_e = 0.5 / (noise * noise);
        let twin = Twin::new(config, specimen, seed, clock)?;
        let devices = Devices {
            camera: Some(camera(twin.camera())),
            ..twin.devices()
        };
        let scope = Instrument::new(devices, twin.rules(), CancelToken::new())?;
        Ok(Self { twin, scope })
    }
}

/// Those of one instrument.
pub(crate) struct Known {
    kind: Kind,
    seed: u64,
    all: Vec<(ObjectiveId, Calibration)>,
}

/// The calibrations of an instrument.
pub(crate) fn of(known: &[Known], scene: &Scene) -> Vec<(ObjectiveId, Calibration)> {
    let is = |k: &&Known| k.kind == scene.kind && k.seed == scene.seed;
    known
        .iter()
        .find(is)
        .map(|k| k.all.clone())
        .unwrap_or_default()
}

/// Calibrates all instruments, unless their calibrations lie in the folder.
pub(crate) fn calibrations(folder: &Path) -> Outcome<Vec<Known>> {
    let mut known = Vec::new();
    for kind in [Kind::Hexapod, Kind::Turntable] {
        for seed in 1..=SEEDS {
            let path = folder.join(format!("calibrations-{kind:?}-{seed}.json").to_lowercase());
            let all = match fs::read(&path) {
                Ok(kept) => serde_json::from_slice(&kept)?,
                Err(_) => {
                    let made = calibrate(kind, seed)?;
                    fs::write(&path, serde_json::to_vec(&made)?)?;
                    made
                }
            };
            known.push(Known { kind, seed, all });
        }
    }
    Ok(known)
}

fn calibrate(kind: Kind, seed: u64) -> Outcome<Vec<(ObjectiveId, Calibration)>> {
    let bench = Bench::new((kind, seed), 0.005, Arc::new(Tissue::new(seed)))?;
    let mut all = Vec::new();
    for objective in bench.scope.gate().objectives() {
        let (id, vision) = (objective.id.clone(), VisionOptions::default());
        let focus = Some(FocusOptions::default());
        let mut bring = Bring::new(id.clone(), focus, vision.clone());
        run(&mut bring, &bench.scope, &mut NoSink)?;
        let mut calibrate = Calibrate::new(objective.clone(), CalibrateOptions::default(), vision);
        all.push((id, run(&mut calibrate, &bench.scope, &mut NoSink)?));
    }
    Ok(all)
}
