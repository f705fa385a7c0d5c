//! What a controller counts its axes in.

use crate::common::{detail, pose, refusal, wait};
use crate::controller::{connect, settings};
use scopeservo_drivers::emulator::gcs2::{EmulatedAxis, EmulatedStage, Gcs2Emulator};
use scopeservo_drivers::gcs2::Gcs2Stage;
use scopeservo_scope::{Axis, Motion, ScopeError, Stage};

/// A controller of one axis for focus, which goes from 0 to 400 um, or of one that turns by 10 deg each way: what it says that it counts in,
/// how many of these there are in a um or deg, and which commands it does not know.
fn one_axis(
    turns: bool,
    unit: &[u8],
    per_display: f64,
    unknown: &[&'static str],
) -> (Gcs2Emulator, Result<Gcs2Stage, ScopeError>) {
    let (low, high) = if turns { (-10.0, 10.0) } else { (0.0, 400.0) };
    let emulator = Gcs2Emulator::serve(EmulatedStage {
        axes: vec![EmulatedAxis {
            name: "1".into(),
            low: low * per_display,
            high: high * per_display,
            unit: unit.to_vec(),
        }],
        coupled: false,
        velocity: 10_000.0 * per_display,
        referenced: true,
        reference_ms: 50,
        unknown: unknown.to_vec(),
    })
    .unwrap();
    let mut settings = settings();
    settings.coupled = false;
    settings.linear.retain(|a| a.axis == Axis::Z && !turns);
    settings.rotary.retain(|a| a.axis == Axis::Rz && turns);
    settings.linear.iter_mut().for_each(|a| a.name = "1".into());
    settings.rotary.iter_mut().for_each(|a| a.name = "1".into());
    let stage = connect(&emulator, &settings);
    (emulator, stage)
}

#[test]
fn axes_are_counted_in_what_the_controller_says() {
    for (unit, per_um) in [
        (&b"UM"[..], 1.0),
        (b"um", 1.0),
        (b"\xb5m", 1.0),
        (b"\xc2\xb5m", 1.0),
        (b"MICRONS", 1.0),
        (b"nm", 1e3),
        (b"MM", 1e-3),
        (b"", 1e-3),
    ] {
        let (emulator, stage) = one_axis(false, unit, per_um, &[]);
        let stage = stage.unwrap();
        let z = *stage.info().axis(Axis::Z).unwrap();
        assert!(z.min == 0.0 && (z.max - 400e-6).abs() < 1e-12, "{z:?}");
        stage.start_move(&pose(Axis::Z, 100e-6)).unwrap();
        assert_eq!(wait(&stage), Motion::Settled);
        assert!((emulator.truth()[0] / per_um - 100.0).abs() < 1e-6);
        let at = stage.position().unwrap().si(Axis::Z).unwrap();
        assert!((at - 100e-6).abs() < 1e-12, "{at}");
        stage.set_velocity_si(Axis::Z, 1e-6 / per_um).unwrap();
        assert!(emulator.heard().contains(&"VEL 1 1.000000".into()));
        let outside = stage.start_move(&pose(Axis::Z, 401e-6));
        assert!(matches!(outside, Err(ScopeError::OutsideLimits { .. })));
    }
    for (unit, per_deg) in [
        (&b"DEG"[..], 1.0),
        (b"\xb0", 1.0),
        (b"MRAD", 1e3_f64.to_radians()),
        (b"\xb5rad", 1e6_f64.to_radians()),
        (b"", 1.0),
    ] {
        let (emulator, stage) = one_axis(true, unit, per_deg, &[]);
        let stage = stage.unwrap();
        let to = 5f64.to_radians();
        stage.start_move(&pose(Axis::Rz, to)).unwrap();
        assert_eq!(wait(&stage), Motion::Settled);
        assert!((emulator.truth()[0] / per_deg - 5.0).abs() < 1e-6);
        let at = stage.position().unwrap().si(Axis::Rz).unwrap();
        assert!((at - to).abs() < 1e-8, "{at}");
    }
}

#[test]
fn a_unit_that_cannot_be_is_told_before_anything_moves() {
    for (turns, unit, words) in [
        (false, &b"FURLONG"[..], &["'FURLONG'", "no unit"][..]),
        (false, b"\x1b[2J", &[r"'\u{1b}[2J'"]),
        (false, b"DEG", &["counts axis 1 in DEG", "so it turns"]),
        (true, b"MM", &["counts axis 1 in MM", "so it shifts"]),
    ] {
        let (emulator, stage) = one_axis(turns, unit, 1.0, &[]);
        let error = stage.err().unwrap();
        assert!(matches!(error, ScopeError::BadSetting { .. }), "{error:?}");
        for word in words {
            assert!(error.to_string().contains(word), "{word}: {error}");
        }
        assert!(!emulator.heard().iter().any(|l| l.starts_with("MOV")));
    }
}

#[test]
fn controllers_that_know_no_units_or_no_reference_are_driven() {
    for unknown in [&["PUN?"][..], &["FRF?", "FRF"], &["PUN?", "FRF?", "FRF"]] {
        // What they count in is millimetres then.
        let (emulator, stage) = one_axis(false, b"MM", 1e-3, unknown);
        let stage = stage.unwrap();
        assert!(stage.is_homed().unwrap());
        // Nothing of what was not known is left to be blamed on a move.
        stage.start_move(&pose(Axis::Z, 100e-6)).unwrap();
        assert_eq!(wait(&stage), Motion::Settled);
        assert!((emulator.truth()[0] - 0.1).abs() < 1e-9);
        assert!(stage.position().is_ok());
        if unknown.contains(&"FRF?") {
            let why = refusal(stage.start_homing().unwrap_err());
            assert!(why.contains("no reference move"), "{why}");
            assert!(!emulator.heard().iter().any(|l| l.starts_with("FRF 1")));
        }
    }
    // A controller that answers neither the one nor the error is silent.
    let (_emulator, stage) = one_axis(false, b"MM", 1e-3, &["PUN?", "ERR?"]);
    assert!(matches!(stage.err(), Some(ScopeError::Timeout { .. })));
}

#[test]
fn a_controller_that_counts_otherwise_than_when_it_was_connected_is_not_moved() {
    for (turns, unit, per_display, other, per_unit) in [
        // A place in um reads like one in mm that is far away, and the other way round.
        (false, &b"MM"[..], 1e-3, &b"UM"[..], 1e3),
        (false, b"um", 1.0, b"mm", 1e-3),
        (true, b"DEG", 1.0, b"MRAD", 17.453_292_519_943_295),
    ] {
        let (emulator, stage) = one_axis(turns, unit, per_display, &[]);
        let stage = stage.unwrap();
        let to = match turns {
            true => pose(Axis::Rz, 0.01),
            false => pose(Axis::Z, 20e-6),
        };
        stage.start_move(&to).unwrap();
        assert_eq!(wait(&stage), Motion::Settled);
        emulator.count_in(other, per_unit);
        let stood = emulator.truth();
        let back = match turns {
            true => pose(Axis::Rz, 0.005),
            false => pose(Axis::Z, 10e-6),
        };
        let from = emulator.heard().len();
        for refused in [stage.start_move(&back), stage.start_move_at(&back, 1e-5)] {
            let why = detail(refused.unwrap_err());
            assert!(
                why.contains("PUN?") && why.contains("Nothing moved"),
                "{why}"
            );
        }
        let said = emulator.heard()[from..].join(" ");
        assert!(!said.contains("MOV") && !said.contains("VEL "), "{said}");
        assert_eq!(emulator.truth(), stood);
    }
}
