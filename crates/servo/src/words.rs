//! Words for people that errors and answers share.

use scopeservo_registration::{NoGrid, Rival};
use scopeservo_scope::{Axis, deg_in_words, um_in_words};

/// What a rival is, for people: the way from one place to the other that looks like it.
pub(crate) fn rival_in_words(rival: &Rival, um_per_px: Option<f64>) -> String {
    let [x, y] = rival.shift_px;
    let turned = match rival.turn_rad.to_degrees() {
        deg if deg.abs() >= 0.5 => format!(", turned by {deg:.0} deg"),
        _ => String::new(),
    };
    match um_per_px {
        Some(um) => format!(
            "{:.1}, {:.1} um ({x:.0}, {y:.0} px{turned})",
            x * um,
            y * um
        ),
        None => format!("{x:.0}, {y:.0} px{turned}"),
    }
}

/// Where a view was in the end, when it was found again.
pub(crate) fn astray_in_words(off_um: Option<f64>) -> String {
    off_um.map_or(
        "views that must show the same place do not".to_owned(),
        |um| {
            let um = um_in_words(um, 1);
            format!("in the end the view was {um} beside where the stage said it is")
        },
    )
}

/// How far an axis goes, of m or rad.
pub(crate) fn way_in_words(axis: Axis, si: f64) -> String {
    match axis.is_rotation() {
        true => deg_in_words(si.to_degrees(), 2),
        false => um_in_words(si * 1e6, 0),
    }
}

/// What another pitch than the one that was told may be, by the nominal size of a pixel.
pub(crate) fn pitch_in_words(why: &NoGrid, pitch_um: f64, um_per_px: f64) -> String {
    match why {
        NoGrid::OtherPitch { seen_px, .. } => format!(
            ". By the engraved scale it has {:.1} um: is the pitch {pitch_um} um, and is this the objective? (On a chequer board the pitch \
             is the way to the next square of one colour, the diagonal of a square)",
            seen_px * um_per_px
        ),
        NoGrid::TooFewNodes { .. } | NoGrid::TooFine { .. } => {
            ". Take an objective or a grid with 8 pixels a period at least, and three periods in the shorter side".into()
        }
        _ => ". Put in a pattern slide, in focus: dots, squares or crossing lines in squares".into(),
    }
}
