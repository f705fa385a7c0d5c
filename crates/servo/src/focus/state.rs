//! The state of a focus, and what its samples say.

use super::curve::Curve;
use super::measure::LEVELS;
use super::options::FocusOptions;
use super::peak::Peak;
use super::sample::Sample;
use crate::ServoError;
use scopeservo_scope::{Length, Objective, StagePose};
use serde::{Deserialize, Serialize};

/// A Gaussian of so many pixels stands for the finest level.
const FINEST_PX: f64 = 1.5;
/// A look around a height goes so far above and below at least, um, and in widths of the finest level.
const NEARBY_UM: f64 = 30.0;
const NEARBY: f64 = 10.0;

/// What is under way.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Step {
    /// From the present height outwards.
    Outwards,
    /// Around what a sweep has shown.
    Swept { level: usize, times: u8 },
    /// Around a peak that a level shows.
    Closer { level: usize, times: u8 },
    /// The last pass; `expected` where a focus was found before.
    Fine { continued: u8, expected: bool },
    /// Arrivals at a peak that a level shows: `count` so far.
    Arrival { peak: Peak, level: usize, count: u8 },
}

impl Step {
    pub(super) fn is_fine(self) -> bool {
        matches!(self, Self::Fine { .. })
    }
}

/// The autofocus as a step machine: one sample per step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Focus {
    pub(super) options: FocusOptions,
    pub(super) objective: Objective,
    /// Whether the present height is expected to be in focus.
    #[serde(default)]
    pub(super) here: bool,
    pub(super) start_um: Option<f64>,
    pub(super) step: Step,
    /// Heights of a first sweep, the nearest first.
    pub(super) outwards_um: Vec<f64>,
    /// The level whose widths lie between these.
    pub(super) spaced_by: usize,
    /// Whether a peak that was known badly was looked at once more.
    pub(super) looked_again: bool,
    /// Heights to visit before the next decision.
    pub(super) plan_um: Vec<f64>,
    /// All looks, ascending.
    pub(super) samples: Vec<Sample>,
    /// Where the last look was.
    pub(super) last_um: Option<f64>,
    /// Heights of the last pass.
    pub(super) fine_um: Vec<f64>,
    /// Whether the next look of the last pass is the one from far away.
    pub(super) far_first: bool,
    /// From where to where a closer look has shown that there is nothing.
    pub(super) refuted_um: Vec<[f64; 2]>,
    /// Whether a sweep comes next, and whether one was made.
    #[serde(default)]
    pub(super) sweep_due: bool,
    #[serde(default)]
    pub(super) swept: bool,
    /// How long the last look took with its move, s.
    #[serde(default)]
    pub(super) look_s: Option<f64>,
}

impl Focus {
    /// A sweep around the present height.
    pub fn new(objective: Objective, options: FocusOptions) -> Self {
        Self {
            options,
            objective,
            here: false,
            start_um: None,
            step: Step::Outwards,
            outwards_um: Vec::new(),
            spaced_by: 0,
            looked_again: false,
            plan_um: Vec::new(),
            samples: Vec::new(),
            last_um: None,
            fine_um: Vec::new(),
            far_first: false,
            refuted_um: Vec::new(),
            sweep_due: false,
            swept: false,
            look_s: None,
        }
    }

    /// The same, where the present height seems to be in focus: few frames when it is.
    pub fn expecting_here(self) -> Self {
        Self { here: true, ..self }
    }

    /// The same where the present height is nearly in focus: no farther than a look around it goes.
    pub(crate) fn nearby(objective: Objective, options: &FocusOptions) -> Self {
        let reach_um = NEARBY_UM.max(NEARBY * Self::finest_width_um(&objective));
        let bounded = FocusOptions {
            half_range_um: options.half_range_um.min(reach_um),
            nearest_um: options.nearest_um.min(reach_um),
            ..options.clone()
        };
        Self::new(objective, bounded).expecting_here()
    }

    /// The height from which it is looked for, um.
    pub(crate) fn began_um(&self) -> Option<f64> {
        self.start_um
    }

    /// The samples on one level.
    pub(super) fn curve(&self, level: usize) -> Curve {
        let measure = self.options.measure.measure();
        let width_um = self.width_um(level);
        Curve::of(
            &self.samples,
            level,
            measure,
            self.options.min_contrast,
            width_um,
        )
    }

    pub(super) fn no_focus(&self) -> ServoError {
        let of = |s: Option<&Sample>| s.map_or(f64::NAN, |s| s.z_um);
        let (from_um, to_um) = (of(self.samples.first()), of(self.samples.last()));
        let objective = self.objective.id.clone();
        let rises = |level| self.curve(level).rises_steadily(self.contrast());
        match (0..self.levels()).any(rises) {
            true => ServoError::FocusAtLimit {
                objective,
                from_um,
                to_um,
            },
            false => ServoError::NoFocus {
                objective,
                contrast: self.root(self.curve(0).contrast()),
                from_um,
                to_um,
            },
        }
    }

    /// Sharpness as it is told: sizes, also where the measure has squares.
    pub(super) fn root(&self, value: f64) -> f64 {
        let order = self.options.measure.measure().order();
        value.max(0.0).powf(1.0 / f64::from(order))
    }

    pub(super) fn contrast(&self) -> f64 {
        let order = self.options.measure.measure().order();
        self.options.min_contrast.powi(order)
    }

    /// Levels that images of this objective are looked at on: no coarser than the range.
    pub(super) fn levels(&self) -> usize {
        let fit = |level: &usize| self.width_um(*level) <= 0.5 * self.options.half_range_um;
        1 + (1..LEVELS).take_while(fit).count()
    }

    /// Defocus that blurs by as much as a level does already, um.
    pub(super) fn width_um(&self, level: usize) -> f64 {
        f64::from(1u32 << level) * Self::finest_width_um(&self.objective)
    }

    /// Defocus that blurs by as much as the finest level does already, um: what is seen of less is little.
    pub(crate) fn finest_width_um(objective: &Objective) -> f64 {
        let aperture = objective.numerical_aperture.min(0.95);
        // The standard deviation of the light cone is half of its radius.
        let cone = 0.5 * aperture.asin().tan();
        FINEST_PX * objective.nominal_um_per_px / cone
    }
}

/// The request for a height alone.
pub(super) fn height(z_um: f64) -> StagePose {
    StagePose {
        z: Some(Length::from_um(z_um)),
        ..StagePose::default()
    }
}

/// Wavelength in the middle of the visible, um.
const WAVELENGTH_UM: f64 = 0.55;

/// Depth of field by the wave's nature, um.
pub(crate) fn depth_of_field_um(objective: &Objective) -> f64 {
    WAVELENGTH_UM / objective.numerical_aperture.powi(2)
}
