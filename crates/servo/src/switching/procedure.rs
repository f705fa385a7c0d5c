//! The switching as a step machine.

use super::numbers::{Arrival, SwitchingReport, report};
use crate::event::tell;
use crate::kinematics::PlanarPose;
use crate::procedure::{Procedure, Progress, home_after_an_answer, withdrawn};
use crate::proof::stays;
use crate::target::MIN_TARGET_FEATURES;
use crate::vision::{centre_px, grab, gray};
use crate::{
    Bring, Calibration, Event, FocusOptions, FocusResult, FrameRole, ServoError, Sink,
    VisionOptions,
};
use scopeservo_features::Features;
use scopeservo_registration::{
    Correspondences, Estimate, NotFound, Prior, RotationPrior, ScalePrior, register_correspondences,
};
use scopeservo_scope::{Axis, Instrument, ScopeError};
use serde::{Deserialize, Serialize};

/// The step aside, as a share of the shorter side of the first objective's field.
const ASIDE: f64 = 0.2;
/// Two calibrations tell their scales apart to this, relative, and their angles to this, rad.
const SCALE_SLACK: f64 = 0.03;
const ANGLE_SLACK_RAD: f64 = 0.03;

/// Settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SwitchingOptions {
    /// How often each objective comes.
    pub times: usize,
    /// How to focus each time; `None` where somebody focuses by hand.
    pub focus: Option<FocusOptions>,
    /// How to look.
    pub vision: VisionOptions,
}

impl Default for SwitchingOptions {
    fn default() -> Self {
        Self {
            times: 5,
            focus: Some(FocusOptions::default()),
            vision: VisionOptions::default(),
        }
    }
}

/// The reference view.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Reference {
    start: PlanarPose,
    features: Features,
}

/// Two calibrated objectives that come in turn, over tissue. The stage comes home unless it was stopped or failed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Switching {
    /// The first, whose view is the wider one, and the second.
    calibrations: [Calibration; 2],
    options: SwitchingOptions,
    bring: Option<Box<Bring>>,
    reference: Option<Reference>,
    /// How many arrivals there were after the reference, those included that were not found in it.
    came: usize,
    arrivals: Vec<Arrival>,
    lost: Option<NotFound>,
}

impl Switching {
    /// Switches between the objectives of two calibrations.
    pub fn new(mut calibrations: [Calibration; 2], options: SwitchingOptions) -> Self {
        calibrations.sort_by(|a, b| b.um_per_px().total_cmp(&a.um_per_px()));
        Self {
            calibrations,
            options,
            bring: None,
            reference: None,
            came: 0,
            arrivals: Vec::new(),
            lost: None,
        }
    }

    /// Which objective comes next: the first for the reference, then the second and the first in turn.
    fn comes(&self) -> usize {
        match self.reference {
            None => 0,
            Some(_) => (self.came + 1) % 2,
        }
    }

    fn advance(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<SwitchingReport>, ServoError> {
        if self.came >= 2 * self.options.times {
            let ids = [0, 1].map(|k| &self.calibrations[k].objective);
            let first = &self.calibrations[0];
            let scale = first.sigma_of(|c| Some(c.um_per_px()));
            let scale_sigma = scale.map_or(0.0, |sigma| sigma / first.um_per_px());
            let Some(told) = report(ids, &self.arrivals, scale_sigma) else {
                return Err(self.unclear());
            };
            self.go_home(scope)?;
            return Ok(Progress::Done(told));
        }
        let next = self.comes();
        let Some(bring) = &mut self.bring else {
            let (focus, vision) = (self.options.focus.clone(), self.options.vision.clone());
            let id = self.calibrations[next].objective.clone();
            self.bring = Some(Box::new(Bring::new(id, focus, vision)));
            return Ok(Progress::Continue);
        };
        if let Progress::Done(focused) = bring.step(scope, sink)? {
            self.bring = None;
            match self.reference {
                None => self.refer(scope, sink)?,
                Some(_) => self.arrive(scope, sink, next, focused)?,
            }
        }
        Ok(Progress::Continue)
    }

    fn view(
        &self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        which: usize,
    ) -> Result<Features, ServoError> {
        let id = &self.calibrations[which].objective;
        let frame = grab(scope, sink, FrameRole::Calibration, id)?;
        self.options.vision.of_view(&gray(scope, &frame)?)
    }

    /// Takes the reference, and steps aside.
    fn refer(&mut self, scope: &Instrument, sink: &mut dyn Sink) -> Result<(), ServoError> {
        let features = self.view(scope, sink, 0)?;
        if features.len() < MIN_TARGET_FEATURES {
            self.lost = Some(NotFound::TooFewFeatures {
                view: features.len(),
                target: features.len(),
                needed: MIN_TARGET_FEATURES,
            });
            return Err(self.unclear());
        }
        let here = scope.gate().position()?;
        if here.x.is_none() {
            return Err(ScopeError::NoSuchAxis { axis: Axis::X }.into());
        }
        let start = PlanarPose::from(&here);
        let info = scope.camera().info();
        let side_px = info.width.min(info.height) as f64;
        let way_m = ASIDE * side_px * 1e-6 * self.calibrations[0].um_per_px();
        let aside = [way_m, -way_m].map(|by| {
            let x_m = [start.x_m[0] + by, start.x_m[1]];
            PlanarPose { x_m, ..start }.request(&here)
        });
        let [first, second] = &aside;
        let free = match scope.gate().check(first).is_ok() {
            true => first,
            false => second,
        };
        self.reference = Some(Reference { start, features });
        scope.move_to(free)?;
        Ok(())
    }

    /// Finds the view of an arrival in the reference.
    fn arrive(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
        which: usize,
        focused: Option<FocusResult>,
    ) -> Result<(), ServoError> {
        let view = self.view(scope, sink, which)?;
        self.came += 1;
        let Some(reference) = &self.reference else {
            return Ok(());
        };
        let (found, inliers) = self.register(&view, &reference.features, which);
        let here = scope.gate().position()?;
        let shift = |e: &Estimate| {
            let of = |f: &Features| centre_px(f.width, f.height);
            let centred = (of(&view), of(&reference.features));
            e.target_from_view.recentred(centred.0, centred.1).offset
        };
        let shift_px = found.as_ref().ok().map(shift);
        let event = Event::CalibrationView {
            index: self.came,
            stage: here,
            shift_px,
            inliers,
            chain: None,
        };
        tell(scope, sink, event);
        match (found, shift_px) {
            (Ok(estimate), Some(shift_px)) => {
                let first = &self.calibrations[0];
                let height = focused.and_then(|f| Some([f.z_um?, f.sigma_um?]));
                self.arrivals.push(Arrival {
                    second: which == 1,
                    centre_um: (first.stage_from_pixel * shift_px).map(|m| 1e6 * m),
                    sigma_um: first.um_per_px() * estimate.sigma_px,
                    angle_rad: estimate
                        .target_from_view
                        .linear
                        .rotation_angle()
                        .unwrap_or(0.0),
                    focus_um: height,
                });
            }
            (Err(reason), _) => self.lost = Some(reason),
            _ => {}
        }
        Ok(())
    }

    /// Registers a view to the reference, without what stays on the camera.
    fn register(
        &self,
        view: &Features,
        reference: &Features,
        which: usize,
    ) -> (Result<Estimate, NotFound>, usize) {
        let [first, own] = [&self.calibrations[0], &self.calibrations[which]];
        let turned = first
            .pixel_from_stage()
            .and_then(|m| (m * own.stage_from_pixel).rotation_angle());
        let prior = Prior {
            scale: Some(ScalePrior {
                ratio: own.um_per_px() / first.um_per_px(),
                tolerance: SCALE_SLACK,
            }),
            rotation: turned.map(|angle_rad| RotationPrior {
                angle_rad,
                tolerance_rad: ANGLE_SLACK_RAD,
            }),
            ..Prior::default()
        };
        let vision = &self.options.vision;
        let (options, engine) = (&vision.registration, &*vision.engine);
        match Correspondences::of(engine, view, reference, &prior, options) {
            Ok(all) => {
                let moved = all.those(|_, c| !stays(c));
                let found = register_correspondences(&moved, &prior, options);
                (found.outcome, found.inliers)
            }
            Err(reason) => (Err(reason), 0),
        }
    }

    fn unclear(&self) -> ServoError {
        let few = NotFound::TooFewFeatures {
            view: 0,
            target: 0,
            needed: MIN_TARGET_FEATURES,
        };
        ServoError::SwitchingUnclear {
            from: self.calibrations[0].objective.clone(),
            to: self.calibrations[1].objective.clone(),
            reason: self.lost.clone().unwrap_or(few),
        }
    }

    fn go_home(&self, scope: &Instrument) -> Result<(), ServoError> {
        if let Some(reference) = &self.reference {
            let here = scope.gate().position()?;
            scope.return_to(&reference.start.request(&here))?;
        }
        Ok(())
    }
}

impl Procedure for Switching {
    type Output = SwitchingReport;

    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<SwitchingReport>, ServoError> {
        let ended = self.advance(scope, sink);
        withdrawn(scope, home_after_an_answer(ended, || self.go_home(scope)))
    }
}
