//! An emulated board and the driver on it.

#![allow(unreachable_pub, reason = "a part of one test")]

use crate::common::tcp;
use scopeservo_drivers::emulator::gcode::{EmulatedBoard, GcodeEmulator};
use scopeservo_drivers::gcode::{GcodeAxis, GcodeSettings, GcodeStage};
use scopeservo_scope::{Axis, Kinematics, PositiveZ, ScopeError};

pub fn settings() -> GcodeSettings {
    let axis = |(axis, letter)| GcodeAxis {
        axis,
        letter,
        min_um: -50_000.0,
        max_um: 50_000.0,
        steps_per_mm: 400.0,
        repeatability_um: 2.5,
        arrival_tolerance_um: None,
    };
    GcodeSettings {
        kinematics: Some(Kinematics::SpecimenXyOnTop),
        positive_z: Some(PositiveZ::Apart),
        nosepiece: None,
        axes: [(Axis::X, 'X'), (Axis::Y, 'Y'), (Axis::Z, 'Z')]
            .map(axis)
            .into(),
        speed_um_per_s: 10_000.0,
        needs_homing: false,
        allow_queued_stop: false,
        checksums: true,
        boot_ms: 0,
        reply_timeout_ms: 300,
        busy_timeout_ms: 5000,
        homing_timeout_ms: 2000,
        stop_timeout_ms: 300,
        stall_timeout_ms: 200,
    }
}

pub fn connect(
    emulator: &GcodeEmulator,
    settings: &GcodeSettings,
) -> Result<GcodeStage, ScopeError> {
    GcodeStage::connect(tcp(&emulator.address()), settings)
}

pub fn start(
    board: impl FnOnce(&mut EmulatedBoard),
    change: impl FnOnce(&mut GcodeSettings),
) -> (GcodeEmulator, Result<GcodeStage, ScopeError>) {
    let (mut emulated, mut settings) = (EmulatedBoard::new(), settings());
    board(&mut emulated);
    change(&mut settings);
    let emulator = GcodeEmulator::serve(emulated).unwrap();
    let stage = connect(&emulator, &settings);
    (emulator, stage)
}

pub fn plain() -> (GcodeEmulator, GcodeStage) {
    let (emulator, stage) = start(|_| {}, |_| {});
    (emulator, stage.unwrap())
}
