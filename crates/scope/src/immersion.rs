//! What is between an objective and the specimen, and that it never becomes another unasked.

use crate::{Objective, ObjectiveId};
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

/// Orders objectives so that the medium changes least often: those that work in what is there now first, then medium by medium, each
/// from the lowest magnification up. `of` tells an item's objective.
pub fn by_immersion<T>(items: &mut [T], now: Option<Immersion>, of: impl Fn(&T) -> &Objective) {
    let lowest = |medium: Immersion| {
        let all = items.iter().map(&of).filter(|o| o.immersion == medium);
        all.map(|o| o.magnification).fold(f64::INFINITY, f64::min)
    };
    let media: BTreeSet<Immersion> = items.iter().map(|i| of(i).immersion).collect();
    let mut media: Vec<(bool, f64, Immersion)> = media
        .into_iter()
        .map(|m| (Some(m) != now, lowest(m), m))
        .collect();
    media.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let rank = |o: &Objective| media.iter().position(|(_, _, m)| *m == o.immersion);
    items.sort_by(|a, b| {
        let (a, b) = (of(a), of(b));
        let by_medium = rank(a).cmp(&rank(b));
        by_medium.then(a.magnification.total_cmp(&b.magnification))
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objectives_are_ordered_so_that_the_medium_changes_least_often() {
        let objective = |id: &str, magnification: f64, immersion| Objective {
            id: ObjectiveId(id.into()),
            magnification,
            numerical_aperture: 0.25,
            nominal_um_per_px: 1.0,
            immersion,
        };
        let mut all = [
            objective("100x", 100.0, Immersion::Oil),
            objective("63x", 63.0, Immersion::Air),
            objective("40x", 40.0, Immersion::Oil),
            objective("10x", 10.0, Immersion::Air),
        ];
        let names = |all: &[Objective]| all.iter().map(|o| o.id.0.clone()).collect::<Vec<_>>();
        for now in [None, Some(Immersion::Air), Some(Immersion::Water)] {
            by_immersion(&mut all, now, |o| o);
            assert_eq!(names(&all), ["10x", "63x", "40x", "100x"]);
        }
        by_immersion(&mut all, Some(Immersion::Oil), |o| o);
        assert_eq!(names(&all), ["40x", "100x", "10x", "63x"]);
    }
}
