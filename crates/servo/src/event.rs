//! What procedures tell: progress bar, report, replay and resume all read the same events.

use crate::calibrate::told::{ChainPlace, ChainView};
use crate::pixels_seen::PixelsSeen;
use crate::{
    Calibration, FocusResult, FocusSweep, Identity, LocatedBy, Outcome, PoseError, Promised,
    Remark, TiltReport, Velocity,
};
use scopeservo_geometry::Affine2;
use scopeservo_registration::NotFound;
use scopeservo_scope::{Frame, Instrument, ObjectiveId, StagePose};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// The parts of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// Changing the objective.
    Switch,
    /// Autofocus.
    Focus,
    /// A look at which objective is active.
    Identify,
    /// Calibration.
    Calibrate,
    /// Visual servoing.
    Servo,
}

/// What a frame was grabbed for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameRole {
    /// The target, when it was saved.
    Target,
    /// A focus sweep.
    Focus,
    /// A look at which objective is active.
    Identify,
    /// A calibration view.
    Calibration,
    /// An iteration of the servo.
    Servo,
    /// A step aside, to see what moves with the stage.
    Aside,
}

/// One thing that happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// A run began.
    Started {
        /// Objectives in the order in which they will be servoed.
        objectives: Vec<ObjectiveId>,
        /// Objective of the target.
        target_objective: ObjectiveId,
        /// The feature engine.
        engine: String,
        /// The CPU level that the engine uses.
        cpu_level: String,
    },
    /// A part of the run began.
    PhaseStarted {
        /// Which part.
        phase: Phase,
        /// The objective it is for.
        objective: ObjectiveId,
    },
    /// A frame was grabbed. The frame itself went to [`Sink::frame`].
    FrameGrabbed {
        /// Its sequence number.
        sequence: u64,
        /// What for.
        role: FrameRole,
        /// The active objective.
        objective: ObjectiveId,
        /// When the exposure began, seconds on the instrument's clock. Logs of earlier versions do not tell.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        exposure_start_s: Option<f64>,
        /// How long it lasted, s, where the camera tells.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        exposure_s: Option<f64>,
        /// Where the stage stood, by what it last said at rest: m and rad, its own axes. `None` when it moved meanwhile, or had not been asked
        /// since it last moved.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        stage: Option<StagePose>,
    },
    /// The sharpness at one height.
    FocusSample {
        /// Stage height, um.
        z_um: f64,
        /// What the measure answers, over the light, as a size: the noise's share taken off where the measure can.
        sharpness: f64,
    },
    /// The coarse scan of a focus was made in motion, or not.
    FocusSwept {
        /// What came of it.
        sweep: FocusSweep,
    },
    /// A focus was found.
    Focused {
        /// The active objective.
        objective: ObjectiveId,
        /// The result.
        result: FocusResult,
    },
    /// How the view is tilted was measured.
    Tilted {
        /// What was seen.
        tilt: Box<TiltReport>,
    },
    /// The view that is to be saved is blurred, and was left so.
    Blurred {
        /// The active objective.
        objective: ObjectiveId,
        /// The stage's z where it is sharpest less where it is, um.
        sharper_by_um: f64,
        /// Features of the view.
        features: usize,
        /// And where it is sharpest.
        features_there: usize,
    },
    /// Shadows that lie on the camera were found, and are divided out from now on.
    ShadowsFound {
        /// How many.
        shadows: usize,
    },
    /// An image told which objective is active.
    Identified {
        /// The objective that is said to be there.
        objective: ObjectiveId,
        /// What the image tells.
        identity: Identity,
    },
    /// One calibration view was registered to the reference view, or not.
    CalibrationView {
        /// How many views before it.
        index: usize,
        /// Where the stage says it was.
        stage: StagePose,
        /// Displacement of the image's centre in pixels, when found.
        shift_px: Option<[f64; 2]>,
        /// Inliers.
        inliers: usize,
        /// What a joint calibration tells of it. Logs of earlier versions do not.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        chain: Option<Box<ChainView>>,
    },
    /// A joint calibration has looked for the last time, whatever came of it.
    ChainEnded {
        /// The objective.
        objective: ObjectiveId,
        /// Where each of its views lies.
        places: Vec<ChainPlace>,
        /// Which were registered to each other, by their indices, the earlier first.
        pairs: Vec<[usize; 2]>,
        /// Which of these pairs the others contradict.
        left_out: Vec<usize>,
    },
    /// A calibration was made.
    Calibrated {
        /// The calibration.
        calibration: Box<Calibration>,
        /// Root mean square residual of its views, pixels.
        residual_px: f64,
        /// Views used.
        views: usize,
    },
    /// One iteration of the servo.
    Iteration {
        /// The active objective.
        objective: ObjectiveId,
        /// Counts from 0 in each magnification.
        iteration: usize,
        /// The frame.
        sequence: u64,
        /// Where the stage says it was.
        stage: StagePose,
        /// The error e before the move.
        error: PoseError,
        /// The velocity v_c, per iteration.
        velocity: Velocity,
        /// Target pixel from view pixel.
        target_from_view: Affine2,
        /// By what the target was located. Logs of earlier versions do not tell: by features.
        #[serde(default)]
        by: LocatedBy,
        /// Inliers: features, or blocks of pixels.
        inliers: usize,
        /// Matches.
        matches: usize,
        /// Standard deviation of where the view's centre lands, target pixels.
        sigma_px: f64,
        /// Inliers: x, y in the view, x, y in the target.
        pairs: Vec<[f32; 4]>,
        /// Whether this error passes the convergence test.
        converged: bool,
        /// What the pixels say, with the target's own objective. Logs of earlier versions do not tell.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pixels: Option<Box<PixelsSeen>>,
        /// Where the move before was to lead; `None` where none was made. Logs of earlier versions do not tell.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        promised: Option<Box<Promised>>,
    },
    /// A view was not found in the target.
    Lost {
        /// The active objective.
        objective: ObjectiveId,
        /// The iteration.
        iteration: usize,
        /// The frame.
        sequence: u64,
        /// Why.
        reason: NotFound,
    },
    /// The stage stepped aside, to see what moves with it.
    SteppedAside {
        /// The active objective.
        objective: ObjectiveId,
        /// How far it was asked to go, pixels of the view.
        step_px: f64,
        /// How far the specimen was seen to move, when it was.
        seen_px: Option<f64>,
        /// Places that stayed: they are fixed to the camera.
        fixed: usize,
    },
    /// Something was seen of the instrument that is to be known, and the run goes on.
    Remarked {
        /// What.
        #[serde(flatten)]
        remark: Remark,
    },
    /// The run ended.
    Finished {
        /// How.
        outcome: Outcome,
    },
}

/// An event and the moment on the instrument's clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Stamped {
    /// Seconds on the instrument's clock.
    pub time_s: f64,
    /// What happened.
    #[serde(flatten)]
    pub event: Event,
}

/// Where events and frames go.
pub trait Sink {
    /// Something happened.
    fn event(&mut self, event: Stamped);
    /// A frame was grabbed; called before its [`Event::FrameGrabbed`].
    fn frame(&mut self, frame: &Frame, role: FrameRole);
    /// The same for a frame that a sink may keep without a copy.
    fn shared_frame(&mut self, frame: &Arc<Frame>, role: FrameRole) {
        self.frame(frame, role);
    }
}

/// A sink that keeps nothing.
#[derive(Debug, Default)]
pub struct NoSink;

impl Sink for NoSink {
    fn event(&mut self, _: Stamped) {}
    fn frame(&mut self, _: &Frame, _: FrameRole) {}
}

/// Tells `event` with the present moment.
pub(crate) fn tell(scope: &Instrument, sink: &mut dyn Sink, event: Event) {
    sink.event(Stamped {
        time_s: scope.clock().now().seconds(),
        event,
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_of_before_frames_told_their_pose_is_still_read() {
        let old = r#"{"time_s": 1.5, "event": "frame_grabbed", "sequence": 7, "role": "servo", "objective": "40x"}"#;
        let grabbed: Stamped = serde_json::from_str(old).unwrap();
        let expected = Event::FrameGrabbed {
            sequence: 7,
            role: FrameRole::Servo,
            objective: ObjectiveId("40x".into()),
            exposure_start_s: None,
            exposure_s: None,
            stage: None,
        };
        assert_eq!(grabbed.event, expected);
    }
}
