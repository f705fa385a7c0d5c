//! The text of a description: the tables of drivers are read by their factories, all else by its type. What is wrong keeps its place.

use scopeservo_drivers::factory::{Described, Factory, Table};
use serde::de::DeserializeOwned;
use std::ops::Range;
use std::sync::Arc;
use toml::de::{DeTable, DeValue, Deserializer, Error, ValueDeserializer};

/// What cannot be read, and where.
pub(crate) struct Unreadable {
    pub(crate) message: String,
    pub(crate) span: Option<Range<usize>>,
}

impl From<Error> for Unreadable {
    fn from(error: Error) -> Self {
        Self {
            message: error.message().to_owned(),
            span: error.span(),
        }
    }
}

/// Keys of a driver that need no factory.
const PLAIN: [&str; 4] = ["program", "tcp", "secret_file", "twin"];

/// What factories have read, by the name of the driver.
pub(crate) type Own = Vec<(String, Vec<Arc<dyn Described>>)>;

/// Reads a description whose drivers are of `known` kinds: what is left to its type, and what the factories took.
pub(crate) fn read<T: DeserializeOwned>(
    text: &str,
    known: &[Factory],
) -> Result<(T, Own), Unreadable> {
    let mut root = DeTable::parse(text)?;
    let mut found = Vec::new();
    if let Some(drivers) = root.get_mut().get_mut("drivers")
        && let DeValue::Table(drivers) = drivers.get_mut()
    {
        for (name, driver) in drivers.iter_mut() {
            if let DeValue::Table(driver) = driver.get_mut() {
                let own = take(driver, known)?;
                found.push((name.get_ref().to_string(), own));
            }
        }
    }
    Ok((T::deserialize(Deserializer::from(root))?, found))
}

/// Takes what factories read out of a driver's table.
fn take(
    driver: &mut DeTable<'_>,
    known: &[Factory],
) -> Result<Vec<Arc<dyn Described>>, Unreadable> {
    let all = || PLAIN.into_iter().chain(known.iter().map(|f| f.kind));
    if let Some(unknown) = driver.keys().find(|key| all().all(|k| k != *key.get_ref())) {
        let all: Vec<String> = all().map(|k| format!("`{k}`")).collect();
        return Err(Unreadable {
            // In the words of the other keys.
            message: format!(
                "unknown field `{}`, expected one of {}",
                unknown.get_ref(),
                all.join(", ")
            ),
            span: Some(unknown.span()),
        });
    }
    let mut own = Vec::new();
    for factory in known {
        if let Some(value) = driver.remove(factory.kind) {
            own.push((factory.read)(Table::new(ValueDeserializer::from(value)))?);
        }
    }
    Ok(own)
}
