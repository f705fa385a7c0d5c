//! What is expected of a saved view, and in words.

use scopeservo_scope::ObjectiveId;
use serde::{Deserialize, Serialize};
use std::fmt;

/// A target whose chance is less than this is told off.
pub(super) const LIKELY: f64 = 0.9;
/// One that its own objective hardly finds again is not saved: no run could tell that it is back.
const OWN: f64 = 0.5;

/// Views of one objective that were made of a target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tried {
    /// The objective.
    pub objective: ObjectiveId,
    /// Views made.
    pub views: usize,
    /// Those in which the target was found where it is, or below its own magnification was most likely there.
    pub found: usize,
    /// Those in which it was found elsewhere.
    pub misled: usize,
}

/// What makes a target hard to come back to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Weakness {
    /// It has few features.
    FewFeatures,
    /// What there is lies in one part of the image.
    OneCorner,
    /// What there is lies along a line.
    OneLine,
    /// It repeats itself in part.
    Repeats,
    /// What there is is too fine, or too faint, for the lowest objective.
    TooFine,
}

/// What is expected of a target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TargetQuality {
    /// Predicted share of runs that come back, from anywhere in the lowest view.
    pub chance: f64,
    /// From the lowest magnification on.
    pub tried: Vec<Tried>,
    /// Features that count.
    pub features: usize,
    /// Share of the image's area that has any.
    pub textured: f64,
    /// Standard deviations of its place, um, and its angle, deg, in one view of its own objective: the median of those that were found.
    pub sigma_um: Option<f64>,
    /// See there.
    pub sigma_deg: Option<f64>,
    /// Why it may not be come back to, where that is so.
    pub weakness: Option<Weakness>,
}

impl Tried {
    /// Share of the views in which the target was found.
    pub(super) fn share(&self) -> f64 {
        self.found as f64 / self.views.max(1) as f64
    }
}

impl TargetQuality {
    /// Whether it can be told from its surroundings.
    pub fn can_be_told(&self) -> bool {
        self.chance >= LIKELY
    }

    /// Whether no run could tell that it is back.
    pub fn is_hopeless(&self) -> bool {
        self.tried.last().is_none_or(|own| own.share() < OWN)
    }
}

impl fmt::Display for TargetQuality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&in_words(self))
    }
}

/// Whether a target can be told from its surroundings, why not, and what would help.
fn in_words(quality: &TargetQuality) -> String {
    let seen: Vec<String> = quality
        .tried
        .iter()
        .map(|t| format!("{} of {} with {}", t.found, t.views, t.objective))
        .collect();
    let found = format!(
        "found in {} of the views made of it; predicted chance of coming back {:.0} %",
        seen.join(", "),
        100.0 * quality.chance
    );
    let because = match quality.weakness {
        None => return format!("can be told from its surroundings: {found}"),
        Some(Weakness::FewFeatures) => format!(
            "it has only {} features, on {:.0} % of its area. Save one with more tissue, or with a lower magnification",
            quality.features,
            100.0 * quality.textured
        ),
        Some(Weakness::OneCorner) => {
            "all there is lies in one part of it. Bring that into the middle with more around it, or take a lower magnification".into()
        }
        Some(Weakness::OneLine) => {
            "all there is lies along a line. Save one with something beside it".into()
        }
        Some(Weakness::Repeats) => {
            "it repeats itself in part. Save one with a defect or an edge, something that is there only once".into()
        }
        Some(Weakness::TooFine) => {
            let lowest = quality.tried.first().map_or(String::new(), |t| t.objective.to_string());
            format!(
                "what it shows is too fine or too faint for {lowest}. Save one with coarser structures, or with a lower magnification"
            )
        }
    };
    let can = match quality.can_be_told() {
        true => "can be told from its surroundings, but not as surely as others",
        false => "cannot be told from its surroundings for sure",
    };
    format!("{can}, because {because} ({found})")
}
