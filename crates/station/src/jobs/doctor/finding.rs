//! What a doctor finds: values, for each front end to put into words.

use scopeservo_scope::conformance;
use scopeservo_scope::{
    AxisRange, CameraInfo, ChangeRule, Motion, Objective, ObjectiveId, Remedy, ScopeError,
    StagePose,
};
use serde::{Deserialize, Serialize};

/// What was looked at, with what was seen, as far as it was.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "check", rename_all = "snake_case")]
pub enum Check {
    /// The stage, as it describes itself.
    Stage {
        /// Maker and model.
        name: String,
        /// The limits for all objectives.
        ranges: Vec<AxisRange>,
    },
    /// The stage says where it is.
    Position {
        /// Where.
        at: Option<StagePose>,
    },
    /// It stands inside its rules.
    Inside,
    /// It stands still.
    Still {
        /// What it is doing.
        motion: Option<Motion>,
    },
    /// The objectives there are.
    Objectives {
        /// All of them.
        all: Vec<Objective>,
    },
    /// The nosepiece says where it is.
    InBeam {
        /// Which objective is in; `None` while nobody knows.
        objective: Option<ObjectiveId>,
    },
    /// Where objectives change.
    Change {
        /// The rule.
        rule: ChangeRule,
        /// How many objectives there are.
        objectives: usize,
    },
    /// The camera, as it describes itself.
    Camera {
        /// What it is.
        info: CameraInfo,
    },
    /// The camera says its exposure.
    Exposure {
        /// How long, s.
        exposure_s: Option<f64>,
    },
    /// An image is taken; told when it is not.
    Picture,
    /// How bright the image is.
    Light {
        /// Mean of all samples, a share of full scale.
        mean: f64,
        /// Share of samples at full scale.
        saturated: f64,
        /// How long the image took, s.
        taken_s: f64,
    },
    /// There is something to see.
    Structure {
        /// Features.
        features: Option<usize>,
        /// Mean |Laplacian| of the luminance over its mean.
        sharpness: f64,
    },
    /// The view stands while the stage does.
    Drift {
        /// Pixels of the view a second.
        px_per_s: Option<f64>,
    },
    /// The image moves as far as the stage says.
    Scale {
        /// The objective that is said to be active; `None` when that could not be asked.
        objective: Option<ObjectiveId>,
        /// Size of a pixel, um, by the stage's report.
        um_per_px: Option<f64>,
    },
    /// A device keeps its contract.
    Contract {
        /// What it has to do, in the words of the conformance suite.
        what: String,
    },
}

/// What is wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "trouble", rename_all = "snake_case")]
pub enum Trouble {
    /// An error, or what of a contract does not hold.
    Error {
        /// For people; it names no flag of a program.
        message: String,
        /// What a program can do about it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        remedy: Option<Remedy>,
    },
    /// The stage moves although nobody asked it to.
    MovesUnasked,
    /// Too much of the image is at full scale.
    TooBright,
    /// Next to nothing of the image is lit.
    Dark,
    /// Too few features to calibrate on or to come back to.
    TooLittle,
    /// The view is in focus at a height that counts as retracted.
    RetractedInFocus,
    /// The view moves too fast to be come back to.
    Drifts,
    /// The scale is not that of the objective.
    ScaleDoesNotFit,
}

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// What, and what was seen.
    #[serde(flatten)]
    pub check: Check,
    /// Whether it belongs to the trial that the user has to allow.
    pub of_trial: bool,
    /// What is wrong; `None` when all is well.
    pub trouble: Option<Trouble>,
}

impl Finding {
    pub(super) fn new(check: Check, trouble: Option<Trouble>) -> Self {
        Self {
            check,
            of_trial: false,
            trouble,
        }
    }

    pub(super) fn well(check: Check) -> Self {
        Self::new(check, None)
    }

    /// What a device said, or its error, seen as a check.
    pub(super) fn of<T>(
        said: Result<T, impl Into<Trouble>>,
        seen: impl FnOnce(Option<T>) -> Check,
    ) -> Self {
        match said {
            Ok(said) => Self::well(seen(Some(said))),
            Err(error) => Self::new(seen(None), Some(error.into())),
        }
    }

    pub(super) fn in_trial(self) -> Self {
        Self {
            of_trial: true,
            ..self
        }
    }

    /// Whether all is well.
    pub fn is_ok(&self) -> bool {
        self.trouble.is_none()
    }
}

impl Trouble {
    pub(super) fn told(error: impl ToString) -> Self {
        Self::Error {
            message: error.to_string(),
            remedy: None,
        }
    }
}

impl From<ScopeError> for Trouble {
    fn from(error: ScopeError) -> Self {
        Self::Error {
            message: error.to_string(),
            remedy: error.remedy(),
        }
    }
}

impl From<conformance::Check> for Finding {
    fn from(check: conformance::Check) -> Self {
        let what = check.name.into();
        let trouble = check.outcome.err().map(Trouble::told);
        Self::new(Check::Contract { what }, trouble)
    }
}
