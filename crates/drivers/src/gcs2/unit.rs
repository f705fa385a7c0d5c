//! What a controller counts an axis in.

use std::f64::consts::PI;

/// A unit of length or of angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Unit {
    turns: bool,
    /// Of these in a metre or radian.
    per_si: f64,
    /// One of these in metres or radians.
    in_si: f64,
}

const fn length(per_m: f64, in_m: f64) -> Unit {
    Unit {
        turns: false,
        per_si: per_m,
        in_si: in_m,
    }
}

const fn angle(per_turn: f64) -> Unit {
    Unit {
        turns: true,
        per_si: per_turn / (2.0 * PI),
        in_si: 2.0 * PI / per_turn,
    }
}

impl Unit {
    /// What controllers count in that do not say it.
    pub(crate) const MILLIMETRE: Unit = length(1e3, 1e-3);
    /// The same for axes that turn.
    pub(crate) const DEGREE: Unit = Unit {
        turns: true,
        per_si: 180.0 / PI,
        in_si: PI / 180.0,
    };

    /// The unit that a controller means; `None` for a word that is none of those known here.
    pub(crate) fn read(word: &str) -> Option<Self> {
        // The sign of a micrometre comes in several codes.
        let word = word
            .trim()
            .to_lowercase()
            .replace(['\u{b5}', '\u{3bc}'], "u");
        Some(match word.as_str() {
            "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => Self::MILLIMETRE,
            "um" | "micron" | "microns" | "micrometer" | "micrometers" | "micrometre"
            | "micrometres" => length(1e6, 1e-6),
            "nm" | "nanometer" | "nanometers" | "nanometre" | "nanometres" => length(1e9, 1e-9),
            "cm" => length(1e2, 1e-2),
            "m" => length(1.0, 1.0),
            "in" | "inch" | "inches" => length(1.0 / 0.0254, 0.0254),
            "deg" | "degree" | "degrees" | "\u{b0}" => Self::DEGREE,
            "rad" | "radian" | "radians" => angle(2.0 * PI),
            "mrad" => angle(2e3 * PI),
            "urad" => angle(2e6 * PI),
            "arcmin" => angle(360.0 * 60.0),
            "arcsec" => angle(360.0 * 3600.0),
            _ => return None,
        })
    }

    /// Whether it is one of angles.
    pub(crate) fn turns(self) -> bool {
        self.turns
    }

    /// Metres or radians in this unit.
    pub(crate) fn of_si(self, si: f64) -> f64 {
        si * self.per_si
    }

    /// Of this unit in metres or radians.
    pub(crate) fn si(self, value: f64) -> f64 {
        value * self.in_si
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_read_as_controllers_write_them() {
        for (words, one_m) in [
            (&["mm", "MM", " mm ", "Millimeter"][..], 1e-3),
            (
                &[
                    "um", "UM", "\u{b5}m", "\u{3bc}m", "\u{b5}M", "MICRONS", "micron",
                ],
                1e-6,
            ),
            (&["nm", "NM", "Nanometres"], 1e-9),
            (&["m", "M"], 1.0),
            (&["inch", "IN"], 0.0254),
        ] {
            for word in words {
                let unit = Unit::read(word).expect(word);
                assert!(!unit.turns());
                assert!((unit.si(1.0) / one_m - 1.0).abs() < 1e-12, "{word}");
                assert!((unit.of_si(one_m) - 1.0).abs() < 1e-12, "{word}");
            }
        }
        for (words, in_turn) in [
            (&["deg", "DEG", "degrees", "\u{b0}"][..], 360.0),
            (&["mrad", "MRAD"], 2e3 * PI),
            (&["urad", "\u{b5}rad"], 2e6 * PI),
            (&["rad"], 2.0 * PI),
            (&["arcsec"], 1_296_000.0),
        ] {
            for word in words {
                let unit = Unit::read(word).expect(word);
                assert!(unit.turns());
                let turn = unit.of_si(2.0 * PI);
                assert!((turn / in_turn - 1.0).abs() < 1e-12, "{word}");
                assert!((unit.si(turn) - 2.0 * PI).abs() < 1e-12, "{word}");
            }
        }
        for word in ["", "furlong", "mm/s", "1", "umm", "\u{fffd}m"] {
            assert_eq!(Unit::read(word), None, "{word}");
        }
    }
}
