//! How it is found in a description of an instrument.

use crate::factory::{Around, ConnectError, Connected, Described, Factory, Place, Wired};
use crate::gcs2::{Gcs2Settings, Gcs2Stage};
use scopeservo_scope::Nosepiece;
use std::sync::Arc;

/// `[drivers.NAME.gcs2]`
pub const FACTORY: Factory = Factory {
    kind: "gcs2",
    schema: include_str!("schema.json"),
    read: |table| table.read::<Wired<Gcs2Settings>>(),
};

impl Described for Wired<Gcs2Settings> {
    fn check(&self) -> Result<(), String> {
        self.has_one_place()
    }

    fn place(&self) -> Option<Place<'_>> {
        self.at()
    }

    fn connect(&self, around: &Around<'_>) -> Result<Connected, ConnectError> {
        let stage = Arc::new(Gcs2Stage::connect(self.open()?, &self.settings)?);
        let nosepiece = stage.nosepiece();
        let nosepiece = nosepiece.map(|n| Box::new(n) as Box<dyn Nosepiece>);
        Ok(Connected::stage(stage, nosepiece, around))
    }
}
