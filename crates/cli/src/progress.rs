//! The progress bar, and the sink that shares events among bar, recorder and view writer.

use crate::bar;
use crate::views::ViewWriter;
use indicatif::ProgressBar;
use scopeservo_report::Recorder;
use scopeservo_scope::{Frame, ObjectiveId, deg_in_words, um_in_words};
use scopeservo_servo::{Event, FrameRole, Identity, Phase, Sink, Stamped};

/// Shares of a run that its parts take, from experience: the bar should move evenly.
const FOCUS: f64 = 2.0;
const CALIBRATE: f64 = 4.0;
const SERVO: f64 = 12.0;

pub(crate) struct Watcher {
    pub(crate) recorder: Recorder,
    pub(crate) views: Option<ViewWriter>,
    bar: ProgressBar,
    done: f64,
    total: f64,
    first_error_um: f64,
}

/// A calibration takes so many views, about.
const CALIBRATION_VIEWS: f64 = 36.0;

impl Watcher {
    pub(crate) fn new(views: Option<ViewWriter>) -> Self {
        let bar = bar::of(1000);
        Self {
            recorder: Recorder::new(),
            views,
            bar,
            done: 0.0,
            total: FOCUS + CALIBRATE,
            first_error_um: f64::NAN,
        }
    }

    /// The number of the last frame grabbed.
    pub(crate) fn last_frame(&self) -> Option<u64> {
        let mut events = self.recorder.events().iter().rev();
        events.find_map(|e| match e.event {
            Event::FrameGrabbed { sequence, .. } => Some(sequence),
            _ => None,
        })
    }

    pub(crate) fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn show(&self, within: f64) {
        let share = ((self.done + within) / self.total).clamp(0.0, 1.0);
        self.bar.set_position((share * 1000.0) as u64);
    }

    fn follow(&mut self, event: &Event) {
        match event {
            Event::Started { objectives, .. } => {
                let legs = objectives.len() as f64;
                self.total = (legs + 1.0) * (FOCUS + CALIBRATE) + legs * SERVO;
            }
            Event::PhaseStarted { phase, objective } => {
                let what = match phase {
                    Phase::Switch => "changing to",
                    Phase::Focus => "focusing with",
                    Phase::Identify => "looking whether it is",
                    Phase::Calibrate => "calibrating",
                    Phase::Servo => "servoing with",
                };
                self.first_error_um = f64::NAN;
                self.bar.set_message(format!("{what} {objective}"));
            }
            Event::Focused { .. } => self.done += FOCUS,
            Event::Identified {
                objective,
                identity,
            } => {
                // Who turned the nosepiece is told, bar or not, and before being asked again.
                tell!("{}", identified(objective, identity));
            }
            Event::CalibrationView { index, .. } => {
                self.show(CALIBRATE * (*index as f64 / CALIBRATION_VIEWS).min(1.0));
                return;
            }
            Event::Calibrated { .. } => self.done += CALIBRATE,
            Event::Iteration {
                objective,
                iteration,
                error,
                inliers,
                converged,
                ..
            } => {
                let e = error.distance_um();
                if self.first_error_um.is_nan() {
                    self.first_error_um = e;
                }
                self.bar.set_message(format!(
                    "{objective} iteration {iteration}: {}, {}, {inliers} inliers",
                    um_in_words(e, 2),
                    deg_in_words(error.angle_deg(), 3)
                ));
                // The error falls exponentially towards about half a micrometre.
                let way =
                    (self.first_error_um / e).ln() / (self.first_error_um / 0.5).ln().max(0.1);
                if *converged {
                    let off = um_in_words(e, 2);
                    self.bar
                        .set_message(format!("{objective}: {off}, confirming"));
                }
                self.show(SERVO * way.clamp(0.0, 1.0));
                return;
            }
            Event::Lost {
                iteration, reason, ..
            } => {
                self.bar
                    .set_message(format!("iteration {iteration}: {reason}"));
            }
            _ => return,
        }
        if let Event::PhaseStarted {
            phase: Phase::Switch,
            ..
        } = event
        {
            // A finished servo leg is known by the next one's beginning.
            let whole = FOCUS + CALIBRATE;
            let legs = ((self.done - whole) / (whole + SERVO)).ceil().max(0.0);
            if self.done > whole {
                self.done = whole + legs * (whole + SERVO);
            }
        }
        self.show(0.0);
    }
}

/// What an image told, for whoever turned the nosepiece.
fn identified(told: &ObjectiveId, identity: &Identity) -> String {
    let scale = format!("the image has {:.3} um per pixel", identity.um_per_px);
    match (identity.as_told, &identity.looks_like) {
        (true, _) => format!("{told} is in: {scale}"),
        (false, Some(other)) => format!("that is not {told}: {scale}, as {other} has"),
        (false, None) => format!("that is not {told}: {scale}, which fits no objective"),
    }
}

impl Sink for Watcher {
    fn event(&mut self, event: Stamped) {
        self.follow(&event.event);
        if let Some(views) = &mut self.views {
            views.event(&event);
        }
        self.recorder.event(event);
    }

    fn frame(&mut self, frame: &Frame, role: FrameRole) {
        if let Some(views) = &mut self.views {
            views.frame(frame);
        }
        self.recorder.frame(frame, role);
    }
}
