//! The nosepiece: which objectives there are and which one looks at the specimen.

use crate::{Immersion, Motion, ObjectiveId, ScopeError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// What is engraved on an objective, and what the maker's data sheet says of the image it gives here.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Objective {
    /// Its name.
    pub id: ObjectiveId,
    /// Total magnification at the eyepiece, for people and for ordering.
    pub magnification: f64,
    /// Numerical aperture.
    pub numerical_aperture: f64,
    /// Nominal size of one camera pixel on the specimen, um. Plans the first calibration moves; measured afterwards.
    pub nominal_um_per_px: f64,
    /// What it works in.
    #[serde(default, skip_serializing_if = "Immersion::is_air")]
    pub immersion: Immersion,
}

impl Objective {
    /// Whether its numbers can be those of an objective.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`].
    pub fn check(&self) -> Result<(), ScopeError> {
        let sizes = [
            self.magnification,
            self.numerical_aperture,
            self.nominal_um_per_px,
        ];
        if !sizes.iter().all(|v| v.is_finite() && *v > 0.0) {
            return Err(ScopeError::BadSetting {
                what: format!(
                    "magnification, numerical_aperture and um_per_px of {} must be above 0",
                    self.id
                ),
            });
        }
        let (aperture, medium) = (self.numerical_aperture, self.immersion);
        match aperture <= medium.largest_aperture() {
            true => Ok(()),
            false => Err(ScopeError::BadSetting {
                what: format!(
                    "{} has a numerical aperture of {aperture}, and in {medium} there is none above {}: correct it, or what the objective \
                     works in (immersion)",
                    self.id,
                    medium.largest_aperture()
                ),
            }),
        }
    }
}

/// How a nosepiece knows which objective is active.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KnownBy {
    /// A sensor tells.
    #[default]
    Sensor,
    /// It counts from where it stood when somebody said which one was in.
    Count,
    /// Somebody who was asked to turn it says so.
    Report,
}

/// A motorised (or hand-turned) nosepiece. A change is started and polled.
pub trait Nosepiece: Send + Sync {
    /// The objectives it carries.
    fn objectives(&self) -> &[Objective];
    /// The active objective; `None` while turning or unknown.
    fn current(&self) -> Result<Option<ObjectiveId>, ScopeError>;
    /// Starts to change and returns at once.
    fn start_change(&self, to: &ObjectiveId) -> Result<(), ScopeError>;
    /// What the nosepiece is doing.
    fn poll(&self) -> Result<Motion, ScopeError>;
    /// Stops at once where the hardware can.
    fn stop(&self) -> Result<(), ScopeError>;
    /// How it knows what [`Nosepiece::current`] tells. What is not sensed has to be shown by an image before anything leans on it; the
    /// instrument keeps what images have shown.
    fn known_by(&self) -> KnownBy {
        KnownBy::Sensor
    }
}

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
    fn no_objective_has_a_larger_aperture_than_its_medium_allows() {
        let checked = |numerical_aperture: f64, immersion| {
            let objective = Objective {
                id: ObjectiveId("60x".into()),
                magnification: 600.0,
                numerical_aperture,
                nominal_um_per_px: 0.1,
                immersion,
            };
            objective.check().map_err(|e| e.to_string())
        };
        for (aperture, medium) in [
            (0.95, Immersion::Air),
            (1.2, Immersion::Water),
            (1.3, Immersion::Glycerol),
            (1.35, Immersion::Silicone),
            (1.49, Immersion::Oil),
            (1.65, Immersion::Oil),
        ] {
            assert_eq!(checked(aperture, medium), Ok(()), "{aperture} in {medium}");
        }
        for (aperture, medium) in [
            (50.0, Immersion::Air),
            (1.25, Immersion::Air),
            (1.4, Immersion::Water),
            (40.0, Immersion::Oil),
        ] {
            let said = checked(aperture, medium).unwrap_err();
            let named = format!("an aperture of {aperture}, and in {medium} ");
            assert!(
                said.contains(&named.replace("an aperture", "a numerical aperture")),
                "{said}"
            );
        }
        for aperture in [0.0, -0.5, f64::NAN] {
            assert!(checked(aperture, Immersion::Oil).is_err(), "{aperture}");
        }
    }

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
