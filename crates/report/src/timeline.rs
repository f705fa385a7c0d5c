//! A list of events read as a timeline: legs, sweeps, calibrations, magnifications, the end.

use crate::stored::Stored;
use crate::told::{Calibrating, Ended, Iteration, Look, Lost, Magnification, Span, Sweep};
use scopeservo_geometry::{Affine2, Vec2};
use scopeservo_scope::{ObjectiveId, StagePose};
use scopeservo_servo::{Calibration, Event, FrameRole, Outcome, Phase, Stamped, TiltReport};

/// The whole run.
#[derive(Default)]
pub(crate) struct Timeline<'a> {
    pub(crate) engine: Option<(&'a str, &'a str)>,
    pub(crate) target_objective: Option<&'a ObjectiveId>,
    pub(crate) spans: Vec<Span<'a>>,
    pub(crate) sweeps: Vec<Sweep<'a>>,
    /// How the view was seen to be tilted, in order.
    pub(crate) tilts: Vec<&'a TiltReport>,
    pub(crate) calibrations: Vec<Calibrating<'a>>,
    pub(crate) magnifications: Vec<Magnification<'a>>,
    pub(crate) outcome: Option<&'a Outcome>,
    /// Calibrations that were known before.
    stored: &'a [Stored],
    /// The objective of the last frame.
    pub(crate) active: Option<&'a ObjectiveId>,
    /// Where the stage last said it stood.
    pub(crate) stage: Option<&'a StagePose>,
    pub(crate) frames: usize,
    pub(crate) duration_s: f64,
}

impl<'a> Timeline<'a> {
    pub(crate) fn read(events: &'a [Stamped], stored: &'a [Stored]) -> Self {
        let mut timeline = Self {
            stored,
            ..Self::default()
        };
        for stamped in events {
            timeline.take(stamped);
        }
        let start = events.iter().find(
            |e| !matches!(&e.event, Event::FrameGrabbed { role, .. } if *role == FrameRole::Target),
        );
        let (from, to) = (
            start.map_or(0.0, |e| e.time_s),
            events.last().map_or(0.0, |e| e.time_s),
        );
        if let Some(span) = timeline.spans.last_mut() {
            span.to_s = to;
        }
        for span in &mut timeline.spans {
            span.from_s -= from;
            span.to_s -= from;
        }
        timeline.duration_s = (to - from).max(0.0);
        timeline
    }

    fn take(&mut self, stamped: &'a Stamped) {
        match &stamped.event {
            Event::Started {
                target_objective,
                engine,
                cpu_level,
                ..
            } => {
                self.target_objective = Some(target_objective);
                self.engine = Some((engine, cpu_level));
            }
            Event::PhaseStarted { phase, objective } => {
                self.phase(*phase, objective, stamped.time_s);
            }
            Event::FrameGrabbed {
                role,
                objective,
                stage,
                ..
            } => {
                self.active = Some(objective);
                self.stage = stage.as_ref().or(self.stage);
                self.frames += usize::from(*role != FrameRole::Target);
            }
            Event::FocusSample { z_um, sharpness } => {
                self.sweep(None).samples.push([*z_um, *sharpness]);
            }
            Event::FocusSwept { sweep } => self.sweep(None).in_motion = Some(sweep),
            Event::Focused { objective, result } => {
                self.sweep(Some(objective)).result = Some(result)
            }
            Event::Tilted { tilt } => self.tilts.push(tilt),
            Event::Identified { .. }
            | Event::SteppedAside { .. }
            | Event::Blurred { .. }
            | Event::ShadowsFound { .. }
            | Event::Remarked { .. } => {}
            Event::CalibrationView { .. } | Event::ChainEnded { .. } | Event::Calibrated { .. } => {
                self.calibrates(&stamped.event)
            }
            Event::Iteration { .. } => self.looks(&stamped.event),
            Event::Lost {
                objective,
                iteration,
                sequence,
                reason,
            } => self.magnification(objective).lost.push(Lost {
                iteration: *iteration,
                sequence: *sequence,
                reason: reason.to_string(),
            }),
            Event::Finished { outcome } => self.outcome = Some(outcome),
        }
    }

    /// One frame of the servo in which the target was seen.
    fn looks(&mut self, event: &'a Event) {
        let Event::Iteration {
            objective,
            iteration,
            sequence,
            error,
            velocity,
            target_from_view,
            by,
            inliers,
            matches,
            sigma_px,
            pairs,
            converged,
            pixels,
            promised,
            stage,
        } = event
        else {
            return;
        };
        self.stage = Some(stage);
        self.magnification(objective).iterations.push(Iteration {
            iteration: *iteration,
            sequence: *sequence,
            error,
            velocity,
            target_from_view,
            by: *by,
            inliers: *inliers,
            matches: *matches,
            sigma_px: *sigma_px,
            pairs,
            converged: *converged,
            pixels: pixels.as_deref(),
            promised: promised.as_deref(),
        });
    }

    /// What a calibration tells.
    fn calibrates(&mut self, event: &'a Event) {
        match event {
            Event::CalibrationView {
                index,
                shift_px,
                chain,
                ..
            } => {
                if let Some(c) = self.calibrating() {
                    c.shifts_px.push(*shift_px);
                    c.looks.extend(chain.as_deref().map(|chain| Look {
                        index: *index,
                        found: shift_px.is_some(),
                        chain,
                    }));
                }
            }
            Event::ChainEnded {
                places,
                pairs,
                left_out,
                ..
            } => {
                if let Some(c) = self.calibrations.last_mut() {
                    c.ended = Some(Ended {
                        places,
                        pairs,
                        left_out,
                    });
                }
            }
            Event::Calibrated {
                calibration,
                residual_px,
                views,
            } => {
                self.calibrated(calibration, *residual_px, *views);
            }
            _ => {}
        }
    }

    fn calibrated(&mut self, calibration: &'a Calibration, residual_px: f64, views: usize) {
        let made = Some((calibration, residual_px, views));
        match self.calibrations.last_mut() {
            Some(c) if c.made.is_none() && *c.objective == calibration.objective => {
                c.made = made;
            }
            _ => self.calibrations.push(Calibrating {
                objective: &calibration.objective,
                shifts_px: Vec::new(),
                looks: Vec::new(),
                ended: None,
                made,
            }),
        }
    }

    fn phase(&mut self, phase: Phase, objective: &'a ObjectiveId, time_s: f64) {
        let leg = match self.spans.last_mut() {
            None => 0,
            Some(last) => {
                last.to_s = time_s;
                last.leg + usize::from(phase == Phase::Switch || *last.objective != *objective)
            }
        };
        self.spans.push(Span {
            leg,
            phase,
            objective,
            from_s: time_s,
            to_s: time_s,
        });
        match phase {
            Phase::Switch | Phase::Identify => {}
            Phase::Focus => self.sweeps.push(Sweep {
                objective: Some(objective),
                samples: Vec::new(),
                result: None,
                in_motion: None,
            }),
            Phase::Calibrate => self.calibrations.push(Calibrating {
                objective,
                shifts_px: Vec::new(),
                looks: Vec::new(),
                ended: None,
                made: None,
            }),
            Phase::Servo => {
                let calibration = self.calibration(objective);
                self.magnifications.push(Magnification {
                    objective,
                    calibration,
                    iterations: Vec::new(),
                    lost: Vec::new(),
                });
            }
        }
    }

    /// The calibration under way; a timeline whose beginning is missing opens one.
    fn calibrating(&mut self) -> Option<&mut Calibrating<'a>> {
        if self.calibrations.last().is_none_or(|c| c.made.is_some()) {
            self.calibrations.push(Calibrating {
                objective: self.active?,
                shifts_px: Vec::new(),
                looks: Vec::new(),
                ended: None,
                made: None,
            });
        }
        self.calibrations.last_mut()
    }

    /// The sweep under way; a timeline whose beginning is missing opens one.
    fn sweep(&mut self, objective: Option<&'a ObjectiveId>) -> &mut Sweep<'a> {
        if self.sweeps.last().is_none_or(|s| s.result.is_some()) {
            self.sweeps.push(Sweep {
                objective,
                samples: Vec::new(),
                result: None,
                in_motion: None,
            });
        }
        self.sweeps.last_mut().expect("one was just opened")
    }

    /// The magnification under way; a timeline whose beginning is missing opens one.
    fn magnification(&mut self, objective: &'a ObjectiveId) -> &mut Magnification<'a> {
        if self
            .magnifications
            .last()
            .is_none_or(|m| m.objective != objective)
        {
            let calibration = self.calibration(objective);
            self.magnifications.push(Magnification {
                objective,
                calibration,
                iterations: Vec::new(),
                lost: Vec::new(),
            });
        }
        self.magnifications.last_mut().expect("one was just opened")
    }

    /// The newest calibration of an objective, made in this run or known before.
    pub(crate) fn calibration(&self, objective: &ObjectiveId) -> Option<&'a Calibration> {
        let made = self.calibrations.iter().rev();
        let stored = self.stored.iter().rev().map(|s| &s.calibration);
        made.filter_map(|c| c.made.map(|m| m.0))
            .chain(stored)
            .find(|c| c.objective == *objective)
    }

    /// Calibrations that were known before and are of objectives that were looked through.
    pub(crate) fn used(&self) -> impl Iterator<Item = &'a Stored> {
        let used = |id: &ObjectiveId| {
            self.magnifications.iter().any(|m| m.objective == id)
                || self.target_objective == Some(id)
        };
        let made = |id: &ObjectiveId| {
            let mut all = self.calibrations.iter();
            all.any(|c| c.objective == id && c.made.is_some())
        };
        (self.stored.iter()).filter(move |s| {
            let id = &s.calibration.objective;
            used(id) && !made(id)
        })
    }

    /// The newest calibration of the target's objective.
    pub(crate) fn target_calibration(&self) -> Option<&'a Calibration> {
        self.calibration(self.target_objective?)
    }

    /// Where a view's centre lies from the target's, um along the target image's columns and rows.
    pub(crate) fn offset_um(
        &self,
        step: &Iteration<'_>,
        view_px: Vec2,
        target_px: Vec2,
    ) -> Option<Vec2> {
        let um_per_px = self.target_calibration()?.um_per_px();
        let there = step.target_from_view.apply(centre(view_px));
        let here = centre(target_px);
        Some([0, 1].map(|k| (there[k] - here[k]) * um_per_px))
    }

    /// The last frame in which the target was seen.
    pub(crate) fn last_seen(&self) -> Option<&Iteration<'a>> {
        self.magnifications.last()?.iterations.last()
    }

    pub(crate) fn iterations(&self) -> usize {
        self.magnifications
            .iter()
            .map(|m| m.iterations.len() + m.lost.len())
            .sum()
    }
}

/// The pixel in the middle of an image of this size.
pub(crate) fn centre(size: Vec2) -> Vec2 {
    size.map(|v| (v - 1.0) / 2.0)
}

/// The target's corners in a view.
pub(crate) fn outline(target_from_view: &Affine2, target: Vec2) -> Option<[[f64; 2]; 4]> {
    let view_from_target = target_from_view.inverse()?;
    let (r, b) = (target[0] - 0.5, target[1] - 0.5);
    let corners = [[-0.5, -0.5], [r, -0.5], [r, b], [-0.5, b]].map(|p| view_from_target.apply(p));
    corners
        .iter()
        .flatten()
        .all(|v| v.is_finite())
        .then_some(corners)
}
