//! What a calibration changed against the one before it, and objectives beside each other.

use crate::calibration::image_x_deg;
use crate::model::WorkEnd;
use crate::text::{escape, fixed};
use scopeservo_servo::{Calibration, Change, Changing, changes_between};
use std::fmt::Write as _;

/// A change of more standard deviations than this is there for sure.
const SURE_SIGMAS: f64 = 3.0;

fn words(what: Changing) -> (&'static str, &'static str, usize) {
    match what {
        Changing::ScalePercent => ("size of a pixel", "%", 3),
        Changing::AngleDeg => ("camera's angle", "°", 4),
        Changing::StretchPercent => ("x against y", "%", 3),
        Changing::SquareDeg => ("right angle of the axes", "°", 4),
        Changing::CentreXUm => ("η<sub>x</sub>", "µm", 1),
        Changing::CentreYUm => ("η<sub>y</sub>", "µm", 1),
    }
}

/// What changed since the calibration that was in use before.
pub(crate) fn section(end: &WorkEnd, now: &Calibration) -> String {
    let before = end
        .before
        .iter()
        .find(|(_, b)| b.objective == now.objective);
    let Some((made, before)) = before else {
        return "<p>None of this objective was kept before, so there is nothing to compare it with.</p>\n".into();
    };
    let made = escape(made);
    let Some(changes) = changes_between(before, now) else {
        return format!(
            "<p>One of {made} was in use before. What changed since is not told: not both know how uncertain they are.</p>\n"
        );
    };
    let sure = changes.iter().filter(|c| c.sigmas() > SURE_SIGMAS).count();
    let lead = match sure {
        0 => format!(
            "Against the calibration of {made} nothing changed for sure: every difference is within {} σ.",
            fixed(SURE_SIGMAS, 0)
        ),
        _ => format!("Against the calibration of {made} this changed; for sure what is marked."),
    };
    let mut out = format!(
        "<p>{lead}</p>\n<div class=\"scroll\"><table class=\"changes\">\n<thead><tr><th scope=\"col\">changed by</th>\
         <th scope=\"col\"></th><th scope=\"col\">in σ</th></tr></thead>\n<tbody>\n"
    );
    for change in &changes {
        out.push_str(&row(change));
    }
    out.push_str("</tbody></table></div>\n");
    out
}

fn row(change: &Change) -> String {
    let (name, unit, digits) = words(change.what);
    let sure = change.sigmas() > SURE_SIGMAS;
    format!(
        "<tr{}><th scope=\"row\">{name} <small>{unit}</small></th><td>{} <small>± {}</small></td><td>{}{}</td></tr>\n",
        if sure { " class=\"sure\"" } else { "" },
        fixed(change.by, digits),
        fixed(change.sigma, digits),
        fixed(change.sigmas(), 1),
        if sure { " ●" } else { "" }
    )
}

/// What objectives of one microscope share, beside each other: nothing with one alone.
pub(crate) fn beside_each_other(all: &[&Calibration]) -> String {
    if all.len() < 2 {
        return String::new();
    }
    let mut out = String::from(
        "<article><h3>Beside each other</h3>\n<p>Objectives of one microscope share the camera and the axis of rotation: angle, handedness and \
         centre should be the same, and the size of a pixel go with the magnification.</p>\n<div class=\"scroll\"><table>\n<thead><tr>\
         <th scope=\"col\">objective</th><th scope=\"col\">pixel, µm</th><th scope=\"col\">image x against stage x, °</th>\
         <th scope=\"col\">image</th><th scope=\"col\">η, mm</th></tr></thead>\n<tbody>\n",
    );
    for c in all {
        let eta = c.rotation_centre_m.map_or("–".into(), |e| {
            format!("{}, {}", fixed(1e3 * e[0], 3), fixed(1e3 * e[1], 3))
        });
        let _ = writeln!(
            out,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td><td>{eta}</td></tr>",
            escape(&c.objective.0),
            fixed(c.um_per_px(), 4),
            fixed(image_x_deg(c), 3),
            match c.reading() {
                Some(_) => "as in the paper",
                None => "mirrored",
            }
        );
    }
    out.push_str("</tbody></table></div></article>\n");
    out
}
