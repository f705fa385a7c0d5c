//! An emulated controller and the driver on it.

#![allow(unreachable_pub, reason = "a part of one test")]

use crate::common::tcp;
use scopeservo_drivers::emulator::gcs2::{EmulatedStage, Gcs2Emulator};
use scopeservo_drivers::gcs2::{Gcs2Settings, Gcs2Stage};
use scopeservo_scope::{Kinematics, PositiveZ, ScopeError};

pub fn settings() -> Gcs2Settings {
    let mut settings =
        Gcs2Settings::hexapod(Kinematics::MovesMicroscope, PositiveZ::Closer, 0.1, 0.0001);
    settings.reply_timeout_ms = 300;
    settings.stop_timeout_ms = 200;
    settings
}

pub fn connect(emulator: &Gcs2Emulator, settings: &Gcs2Settings) -> Result<Gcs2Stage, ScopeError> {
    Gcs2Stage::connect(tcp(&emulator.address()), settings)
}

pub fn hexapod_with(change: impl FnOnce(&mut EmulatedStage)) -> (Gcs2Emulator, Gcs2Stage) {
    let mut stage = EmulatedStage::hexapod();
    change(&mut stage);
    let emulator = Gcs2Emulator::serve(stage).unwrap();
    let stage = connect(&emulator, &settings()).unwrap();
    (emulator, stage)
}

pub fn hexapod() -> (Gcs2Emulator, Gcs2Stage) {
    hexapod_with(|_| {})
}
