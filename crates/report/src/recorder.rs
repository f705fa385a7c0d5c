//! Collects a run while it happens: every event, and the few images that the page shows.

use crate::picture::{Jpeg, Picture};
use scopeservo_scope::{Frame, ObjectiveId};
use scopeservo_servo::{Event, FrameRole, Phase, Sink, Stamped};
use std::collections::BTreeMap;

/// The iterations whose views are shown, as in the paper's Fig. 7; the last one is shown too.
pub(crate) const SHOWN_ITERATIONS: [usize; 5] = [0, 4, 8, 16, 32];

/// Of calibrations so many views are kept, at most: those of four objectives.
const CALIBRATION_VIEWS: usize = 160;

/// Collects events and the few frames a report shows. Memory is bounded: at most six compressed views per magnification,
/// four frames as they came, and where they are asked for the newest compressed views of calibrations.
#[derive(Debug, Clone, Default)]
pub struct Recorder {
    events: Vec<Stamped>,
    target: Option<Picture>,
    kept: BTreeMap<u64, Jpeg>,
    /// The newest frame that is not a target.
    newest: Option<(u64, Picture)>,
    /// The newest view of the servo.
    view: Option<(u64, ObjectiveId, Picture)>,
    sharpest: Option<(f64, Picture)>,
    /// Views of calibrations, where they are to be kept.
    calibration: Option<BTreeMap<u64, Jpeg>>,
}

impl Recorder {
    /// An empty one.
    pub fn new() -> Self {
        Self::default()
    }

    /// From now on views of calibrations are kept as well: a report of a calibration shows some of them.
    pub fn keep_calibration_views(&mut self) {
        self.calibration.get_or_insert_default();
    }

    /// A view of a calibration, if it was kept.
    pub(crate) fn calibration_view(&self, sequence: u64) -> Option<Jpeg> {
        self.calibration.as_ref()?.get(&sequence).cloned()
    }

    /// What happened, in order.
    pub fn events(&self) -> &[Stamped] {
        &self.events
    }

    /// The newest view of the servo as a JPEG: what was seen at arrival, of a run that arrived.
    pub fn last_seen(&self) -> Option<Vec<u8>> {
        let (_, _, picture) = self.view.as_ref()?;
        picture.jpeg().map(|jpeg| jpeg.into_bytes())
    }

    pub(crate) fn target(&self) -> Option<&Picture> {
        self.target.as_ref()
    }

    /// The newest view of the servo and its sequence number.
    pub(crate) fn last_view(&self) -> Option<(u64, &Picture)> {
        self.view.as_ref().map(|(sequence, _, p)| (*sequence, p))
    }

    /// The newest frame of any kind but the target.
    pub(crate) fn newest(&self) -> Option<&Picture> {
        self.newest.as_ref().map(|(_, p)| p)
    }

    /// Its sequence number.
    pub(crate) fn newest_sequence(&self) -> Option<u64> {
        self.newest.as_ref().map(|n| n.0)
    }

    /// The sharpest image of the newest focus sweep.
    pub(crate) fn sharpest(&self) -> Option<&Picture> {
        self.sharpest.as_ref().map(|(_, p)| p)
    }

    /// A view of the servo, if it was kept.
    pub(crate) fn view(&self, sequence: u64) -> Option<Jpeg> {
        if let Some(jpeg) = self.kept.get(&sequence) {
            return Some(jpeg.clone());
        }
        let (newest, picture) = self.last_view()?;
        (newest == sequence).then(|| picture.jpeg()).flatten()
    }

    /// The last view of a magnification stays.
    fn keep_view(&mut self) {
        if let Some((sequence, _, picture)) = &self.view
            && !self.kept.contains_key(sequence)
            && let Some(jpeg) = picture.jpeg()
        {
            self.kept.insert(*sequence, jpeg);
        }
    }

    fn looked(&mut self, objective: &ObjectiveId, iteration: usize, sequence: u64) {
        let Some((_, picture)) = self.newest.clone().filter(|n| n.0 == sequence) else {
            return;
        };
        if self.view.as_ref().is_some_and(|v| v.1 != *objective) {
            self.keep_view();
        }
        if SHOWN_ITERATIONS.contains(&iteration)
            && let Some(jpeg) = picture.jpeg()
        {
            self.kept.insert(sequence, jpeg);
        }
        self.view = Some((sequence, objective.clone(), picture));
    }
}

impl Sink for Recorder {
    fn event(&mut self, event: Stamped) {
        match &event.event {
            Event::PhaseStarted { phase, .. } => match phase {
                Phase::Servo => self.keep_view(),
                Phase::Focus => self.sharpest = None,
                Phase::Switch | Phase::Identify | Phase::Calibrate => {}
            },
            Event::FocusSample { sharpness, .. }
                if self.sharpest.as_ref().is_none_or(|s| *sharpness > s.0) =>
            {
                self.sharpest = self.newest.clone().map(|n| (*sharpness, n.1));
            }
            Event::Iteration {
                objective,
                iteration,
                sequence,
                ..
            }
            | Event::Lost {
                objective,
                iteration,
                sequence,
                ..
            } => self.looked(objective, *iteration, *sequence),
            _ => {}
        }
        self.events.push(event);
    }

    fn frame(&mut self, frame: &Frame, role: FrameRole) {
        let Some(picture) = Picture::of(frame) else {
            return;
        };
        if role == FrameRole::Target {
            self.target = Some(picture);
            return;
        }
        if let (Some(kept), FrameRole::Calibration) = (&mut self.calibration, role)
            && let Some(jpeg) = picture.jpeg()
        {
            kept.insert(frame.sequence, jpeg);
            if kept.len() > CALIBRATION_VIEWS {
                kept.pop_first();
            }
        }
        self.newest = Some((frame.sequence, picture));
    }
}
