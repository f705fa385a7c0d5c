//! Words for people that errors and answers share.

use scopeservo_registration::Rival;
use scopeservo_scope::Axis;

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

/// How far an axis goes, of m or rad.
pub(crate) fn way_in_words(axis: Axis, si: f64) -> String {
    match axis.is_rotation() {
        true => format!("{:.2} deg", si.to_degrees()),
        false => format!("{:.0} um", si * 1e6),
    }
}
