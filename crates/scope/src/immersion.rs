//! What is between an objective and the specimen, and that it never becomes another unasked.

use crate::ObjectiveId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt;
use std::sync::Arc;

/// The medium between an objective and the specimen.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum Immersion {
    /// Nothing: a dry objective.
    #[default]
    Air,
    /// Water.
    Water,
    /// Glycerol.
    Glycerol,
    /// Silicone oil.
    Silicone,
    /// Immersion oil.
    Oil,
}

impl Immersion {
    /// All that there are.
    pub const ALL: [Self; 5] = [
        Self::Air,
        Self::Water,
        Self::Glycerol,
        Self::Silicone,
        Self::Oil,
    ];

    /// Its word in files and messages to programs.
    pub fn word(self) -> &'static str {
        match self {
            Self::Air => "air",
            Self::Water => "water",
            Self::Glycerol => "glycerol",
            Self::Silicone => "silicone",
            Self::Oil => "oil",
        }
    }

    /// Its refractive index, generously: no objective that works in it has a larger aperture.
    pub fn largest_aperture(self) -> f64 {
        match self {
            Self::Air => 1.0,
            Self::Water => 1.34,
            Self::Silicone => 1.42,
            Self::Glycerol => 1.48,
            // Some oils for apertures of 1.65 are denser than glass.
            Self::Oil => 1.79,
        }
    }

    /// That of a word.
    pub fn of_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|medium| medium.word() == word)
    }

    /// Whether it is what an objective is for of which nothing is said.
    pub fn is_air(&self) -> bool {
        *self == Self::Air
    }
}

impl fmt::Display for Immersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Silicone => "silicone oil",
            other => other.word(),
        })
    }
}

/// A change of objective that asks for another medium on the specimen: oil on a dry objective ruins it, and a dry objective where oil was
/// sees nothing. Only somebody who has made the specimen ready can agree to it, and only to this one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ImmersionChange {
    /// The objective that comes.
    pub objective: ObjectiveId,
    /// What it works in.
    pub to: Immersion,
    /// What may be on the specimen now; several where it is not known which objective is active.
    pub from: BTreeSet<Immersion>,
}

impl ImmersionChange {
    /// What may be on the specimen now, in words.
    pub fn from_words(&self) -> String {
        let words: Vec<String> = self.from.iter().map(Immersion::to_string).collect();
        words.join(" or ")
    }
}

/// Asks somebody whether the specimen is ready for the medium of the objective that comes, and waits while the second argument says that the
/// answer is wanted. `false` when it is not, or nobody is there.
pub type AskImmersion = Arc<dyn Fn(&ImmersionChange, &dyn Fn() -> bool) -> bool + Send + Sync>;
