//! A handle to an engine, for settings that are stored.

use crate::{FeatureEngine, SiftEngine, sift_engine};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::ops::Deref;
use std::sync::Arc;

/// An engine that settings, tasks and threads share. It is stored by its name; only those that this library has can be read back.
#[derive(Debug, Clone)]
pub struct Engine(Arc<dyn FeatureEngine>);

impl Engine {
    /// A handle to any engine.
    pub fn new(engine: impl FeatureEngine + 'static) -> Self {
        Self(Arc::new(engine))
    }

    /// The engine of this name, of those that are here.
    pub fn named(name: &str) -> Option<Self> {
        (name == sift_engine::NAME).then(Self::default)
    }
}

impl Default for Engine {
    /// SIFT with its own settings.
    fn default() -> Self {
        Self::new(SiftEngine::default())
    }
}

impl Deref for Engine {
    type Target = dyn FeatureEngine;

    fn deref(&self) -> &Self::Target {
        &*self.0
    }
}

impl PartialEq for Engine {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl Serialize for Engine {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        self.name().serialize(to)
    }
}

impl<'de> Deserialize<'de> for Engine {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let name = String::deserialize(from)?;
        Self::named(&name).ok_or_else(|| {
            serde::de::Error::custom(format!(
                "this program has no engine {name}; go on with the one that has"
            ))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_engine_is_stored_by_its_name_and_a_foreign_one_is_said() {
        let json = serde_json::to_string(&Engine::default()).unwrap();
        assert_eq!(json, "\"sift\"");
        assert_eq!(
            serde_json::from_str::<Engine>(&json).unwrap(),
            Engine::default()
        );
        let foreign = serde_json::from_str::<Engine>("\"corners\"").unwrap_err();
        assert!(
            foreign.to_string().contains("no engine corners"),
            "{foreign}"
        );
    }
}
