//! Focus, calibrate, control, reposition: Algorithm 1 of the paper on any instrument.
//!
//! Read [`mod@servo`] first: the loop is one screen. Every procedure is a step machine: its state is a value that can
//! be stored and continued, one [`Procedure::step`] is at most a few moves and frames, and all that happens is told to a
//! [`Sink`] as [`Event`]s. Nothing here prints, reads the wall clock or keeps global state.
//!
//! Data flow one way: camera -> features -> match and fit -> homography -> pose error -> control -> stage.

#![warn(clippy::too_many_lines)]
#![cfg_attr(
    not(test),
    warn(
        clippy::disallowed_methods,
        clippy::disallowed_types,
        clippy::disallowed_macros
    )
)]

mod attempt;
mod bring;
mod calibrate;
mod calibration;
mod code;
mod compact;
mod error;
mod event;
mod focus;
mod grid_check;
mod hand_eye;
mod identify;
mod identity;
mod kinematics;
mod law;
mod level;
mod localize;
mod located_by;
mod one_side;
mod pixels_seen;
mod pose;
mod possible;
mod procedure;
mod proof;
mod reposition;
mod self_test;
pub mod servo;
mod small_step;
mod switching;
mod target;
mod trial;
mod vision;
mod words;

pub use attempt::Attempt;
pub use bring::Bring;
pub use calibrate::{
    Alone, Calibrate, CalibrateOptions, CalibrationMethod, CalibrationSet, ChainPair, ChainPlace,
    ChainView, NotOne, Parcentric, SET_SCHEMA, agree, joint, one_microscope,
};
pub use calibration::{Backlash, CALIBRATION_SCHEMA, Calibration, EXAMPLE_MOVE, IntrinsicReading};
pub use code::{ErrorCode, ErrorKind, Remedy};
pub use error::ServoError;
pub use event::{Event, FrameRole, NoSink, Phase, Sink, Stamped};
pub use focus::{
    Focus, FocusMeasure, FocusOptions, FocusResult, FocusSweep, Measure, SweepEnd, sharpness,
};
pub use grid_check::{
    Compared, Comparison, GridCheck, GridOptions, GridReading, GridReport, Known, Quantity,
    StageSeen, compare_with,
};
pub use hand_eye::{Observation, solve_hand_eye};
pub use identify::Identify;
pub use identity::Identity;
pub use kinematics::{Motion2, PlanarPose, motion_between, pose_after};
pub use law::{ControlLaw, Direct, Proportional, Velocity, control_law, motion_of};
pub use level::{
    BlockHeight, Level, LevelError, LevelOptions, LevelReport, Levelled, MeasureTilt, StageTilt,
    Tilt, TiltReport,
};
pub use localize::{CorrelationLocalizer, Expected, FeatureLocalizer, Localizer, Measurement};
pub use located_by::LocatedBy;
pub use pixels_seen::PixelsSeen;
pub use pose::{PoseError, PoseEstimate, pose_error, pose_estimate};
pub use procedure::{Procedure, Progress, run};
pub use proof::FixedPlaces;
pub use reposition::{
    Ladder, Leg, LegPolicy, MagnificationResult, Outcome, Reason, Reposition, RepositionOptions,
    Shortest, SoFar, Verdict,
};
pub use self_test::{
    Broken, Change, Changing, SelfTest, SelfTestReport, SelfTestVerdict, Together, changes_between,
    together,
};
pub use servo::Servo;
pub use servo::contradiction::Contradiction;
pub use servo::end::{LimitedBy, ServoEnd, ServoResult};
pub use servo::hand_over::HandOver;
pub use servo::missing::{Beyond, Missing};
pub use servo::options::{Law, ServoOptions};
pub use servo::promise::Promised;
pub use servo::refit::Remark;
pub use servo::run::ServoRun;
pub use servo::task::ServoTask;
pub use switching::{FocusSwitch, Switching, SwitchingOptions, SwitchingReport};
pub use target::{
    InFocus, Picture, SaveOptions, SaveTarget, Taken, Target, TargetQuality, Tried, Weakness,
};
pub use trial::{Drift, drift_seen, first_step, scale_seen};
pub use vision::VisionOptions;
