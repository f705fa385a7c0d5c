//! `scopeservo driver check`: the conformance suite against any driver.

use crate::args::DriverCheckArgs;
use crate::desk::rein_in;
use crate::doctor::{Finding, Findings};
use crate::error::CliError;
use scopeservo_protocol::{Devices, Driver, Secret};
use scopeservo_scope::{
    Camera, CameraInfo, CancelToken, ChangeRule, Channels, Clock, Frame, Instrument, Kinematics,
    Motion, MotionGate, Nosepiece, Objective, ObjectiveId, PositiveZ, Rules, ScopeError, Stage,
    StageInfo, StagePose, SystemClock, conformance,
};
use scopeservo_setup::SetupError;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How quickly a stop must be answered.
const STOP_WITHIN: Duration = Duration::from_millis(200);

pub(crate) fn run(args: &DriverCheckArgs) -> Result<bool, CliError> {
    let secret = args.secret_file.as_deref().map(read_secret).transpose()?;
    let cancel = CancelToken::new();
    let reins = rein_in(&cancel)?;
    let driver = match (&args.tcp, args.command.split_first()) {
        (Some(address), _) => Driver::connect(address, secret.as_ref()),
        (None, Some((program, arguments))) => Driver::spawn(program, arguments),
        (None, None) => {
            return Err(CliError::Usage(
                "name the driver's program after --, like `scopeservo driver check -- python3 my_driver.py`, or --tcp ADDRESS".into(),
            ));
        }
    };
    let driver = driver.map_err(SetupError::from)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let devices = driver.devices(&clock).map_err(SetupError::from)?;
    let mut findings = Findings::new(args.json);
    findings.add(Finding {
        name: "it says hello".into(),
        ok: true,
        said: format!("{}; {}", driver.hello().name, listed(&devices)),
    });
    let has = [
        devices.stage.is_some(),
        devices.camera.is_some(),
        devices.nosepiece.is_some(),
    ];
    let light = devices.light;
    let rules = Rules::travel_only(match args.retract_z_um {
        Some(um) => ChangeRule::Retracted {
            z: um * 1e-6,
            margin: 0.0,
        },
        None => ChangeRule::Anywhere,
    });
    let gate = MotionGate::new(
        devices.stage.unwrap_or_else(|| Box::new(NoStage::new())),
        devices.nosepiece.unwrap_or_else(|| Box::new(NoNosepiece)),
        rules,
    )?;
    let camera = devices.camera.unwrap_or_else(|| Box::new(NoCamera::new()));
    let scope = Arc::new(Instrument::new(gate, camera, clock, cancel));
    let _ = reins.set(Arc::downgrade(&scope));

    let [stage, camera, nosepiece] = has;
    let mut checks = Vec::new();
    if stage {
        checks.extend(conformance::check_stage(&scope));
    }
    if camera {
        checks.extend(conformance::check_camera(&scope));
    }
    if stage && camera {
        checks.extend(conformance::check_together(&scope));
    }
    if nosepiece && (args.retract_z_um.is_some() || !stage) {
        checks.extend(conformance::check_nosepiece(&scope));
    }
    for check in checks {
        findings.add(check.into());
    }
    if stage || nosepiece {
        findings.add(stop_is_quick(&scope, camera));
    }
    if let Some(light) = light {
        findings.add(light_is_set(&light));
    }
    if nosepiece && stage && args.retract_z_um.is_none() && !args.json {
        say!("    objectives were not changed: name a safe height with --retract-z-um");
    }
    scope.check_cancel()?;
    findings.conclude("driver check")
}

pub(crate) fn read_secret(path: &Path) -> Result<Secret, CliError> {
    let bad = |what: String| CliError::Read {
        path: path.into(),
        what,
    };
    let bytes = std::fs::read(path).map_err(|e| bad(e.to_string()))?;
    Secret::new(&bytes)
        .ok_or_else(|| bad(format!("a secret has {} bytes or more", Secret::MIN_BYTES)))
}

fn listed(devices: &Devices) -> String {
    let mut all = Vec::new();
    if let Some(stage) = &devices.stage {
        let axes: Vec<String> = stage
            .info()
            .axes
            .iter()
            .map(|a| a.axis.to_string())
            .collect();
        all.push(format!("stage {} ({})", stage.info().name, axes.join(", ")));
    }
    if let Some(camera) = &devices.camera {
        let info = camera.info();
        all.push(format!(
            "camera {} ({} x {} px)",
            info.name, info.width, info.height
        ));
    }
    if let Some(nosepiece) = &devices.nosepiece {
        let ids: Vec<&str> = nosepiece
            .objectives()
            .iter()
            .map(|o| o.id.0.as_str())
            .collect();
        all.push(format!("nosepiece ({})", ids.join(", ")));
    }
    if devices.light.is_some() {
        all.push("light".into());
    }
    all.join(", ")
}

/// Ten stops, five of them while a frame is exposed, each answered in time.
fn stop_is_quick(scope: &Instrument, camera: bool) -> Finding {
    let mut worst = Duration::ZERO;
    let stops = || -> Result<(), ScopeError> {
        for k in 0..10 {
            std::thread::scope(|s| {
                let grabbing = (camera && k % 2 == 1).then(|| s.spawn(|| scope.grab()));
                // Long enough for the frame to have begun.
                std::thread::sleep(Duration::from_millis(5));
                let start = Instant::now();
                scope.gate().stop()?;
                worst = worst.max(start.elapsed());
                match grabbing.map(std::thread::ScopedJoinHandle::join) {
                    Some(Ok(frame)) => frame.map(drop),
                    Some(Err(_)) | None => Ok(()),
                }
            })?;
        }
        Ok(())
    };
    let outcome = { stops }();
    let ms = worst.as_secs_f64() * 1e3;
    let (ok, said) = match outcome {
        Err(error) => (false, error.to_string()),
        Ok(()) => (
            // Stage and nosepiece are each told.
            worst <= 2 * STOP_WITHIN,
            format!("the slowest of ten took {ms:.1} ms, both devices together"),
        ),
    };
    Finding {
        name: "stop is answered at once, also while a frame is exposed".into(),
        ok,
        said,
    }
}

fn light_is_set(light: &scopeservo_protocol::Light) -> Finding {
    let outcome = (|| {
        let before = light.level()?;
        let set = light.set_level(if before > 0.5 { 0.25 } else { 0.75 })?;
        let read = light.level()?;
        light.set_level(before)?;
        Ok::<_, ScopeError>((set, read))
    })();
    let (ok, said) = match outcome {
        Ok((set, read)) if (set - read).abs() < 1e-9 => (true, String::new()),
        Ok((set, read)) => (false, format!("it was set to {set} and reads {read}")),
        Err(error) => (false, error.to_string()),
    };
    Finding {
        name: "the light keeps the level it was given".into(),
        ok,
        said,
    }
}

/// Stands where a driver has no stage.
struct NoStage(StageInfo);

impl NoStage {
    fn new() -> Self {
        Self(StageInfo {
            name: "none".into(),
            axes: Vec::new(),
            kinematics: Kinematics::SpecimenXyOnTop,
            positive_z: PositiveZ::Closer,
        })
    }
}

impl Stage for NoStage {
    fn info(&self) -> &StageInfo {
        &self.0
    }
    fn position(&self) -> Result<StagePose, ScopeError> {
        Ok(StagePose::default())
    }
    fn start_move(&self, _: &StagePose) -> Result<(), ScopeError> {
        Ok(())
    }
    fn poll(&self) -> Result<Motion, ScopeError> {
        Ok(Motion::Settled)
    }
    fn stop(&self) -> Result<(), ScopeError> {
        Ok(())
    }
}

/// Stands where a driver has no nosepiece.
struct NoNosepiece;

impl Nosepiece for NoNosepiece {
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

/// Stands where a driver has no camera.
struct NoCamera(CameraInfo);

impl NoCamera {
    fn new() -> Self {
        Self(CameraInfo {
            name: "none".into(),
            width: 1,
            height: 1,
            channels: Channels::Gray,
            bit_depth: 8,
            min_exposure: Duration::ZERO,
            max_exposure: Duration::ZERO,
        })
    }

    fn none<T>() -> Result<T, ScopeError> {
        Err(ScopeError::Refused {
            device: "camera",
            detail: "this driver has none".into(),
        })
    }
}

impl Camera for NoCamera {
    fn info(&self) -> &CameraInfo {
        &self.0
    }
    fn exposure(&self) -> Result<Duration, ScopeError> {
        Self::none()
    }
    fn set_exposure(&self, _: Duration) -> Result<Duration, ScopeError> {
        Self::none()
    }
    fn grab(&self) -> Result<Frame, ScopeError> {
        Self::none()
    }
}
