//! How it is found in a description of an instrument.

use crate::factory::{Around, ConnectError, Connected, Described, Factory, Place, Wired};
use crate::gcode::{GcodeSettings, GcodeStage};
use scopeservo_scope::Nosepiece;
use std::sync::Arc;

/// `[drivers.NAME.gcode]`
pub const FACTORY: Factory = Factory {
    kind: "gcode",
    schema: include_str!("schema.json"),
    read: |table| table.read::<Wired<GcodeSettings>>(),
};

impl Described for Wired<GcodeSettings> {
    fn check(&self) -> Result<(), String> {
        self.has_one_place()
    }

    fn place(&self) -> Option<Place<'_>> {
        self.at()
    }

    fn connect(&self, around: &Around<'_>) -> Result<Connected, ConnectError> {
        let stage = Arc::new(GcodeStage::connect(self.open()?, &self.settings)?);
        let nosepiece = stage.nosepiece();
        let nosepiece = nosepiece.map(|n| Box::new(n) as Box<dyn Nosepiece>);
        Ok(Connected::stage(stage, nosepiece, around))
    }
}
