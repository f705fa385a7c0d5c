//! How it is found in a description of an instrument.

use crate::factory::{Around, ConnectError, Connected, Described, Factory, Place, Wired};
use crate::sangaboard::{SangaSettings, SangaStage};
use std::sync::Arc;

/// `[drivers.NAME.sangaboard]`
pub const FACTORY: Factory = Factory {
    kind: "sangaboard",
    schema: include_str!("schema.json"),
    read: |table| table.read::<Wired<SangaSettings>>(),
};

impl Described for Wired<SangaSettings> {
    fn check(&self) -> Result<(), String> {
        self.has_one_place()
    }

    fn place(&self) -> Option<Place<'_>> {
        self.at()
    }

    fn connect(&self, around: &Around<'_>) -> Result<Connected, ConnectError> {
        let stage = SangaStage::connect(self.open()?, &self.settings)?;
        Ok(Connected::stage(Arc::new(stage), None, around))
    }
}
