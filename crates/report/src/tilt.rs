//! How a view was seen to be tilted.

use crate::model::Report;
use crate::svg::{Attr, Canvas, WIDTH};
use crate::text::{count, escape, fixed};
use scopeservo_servo::TiltReport;
use std::fmt::Write as _;

/// The height of a figure for a whole image, at most.
const TALLEST: f64 = 300.0;

/// In one sentence: what is left of it.
pub(crate) fn in_words(all: &[&TiltReport]) -> String {
    let Some(last) = all.last() else {
        return "It did not come to a look at the tilt.".into();
    };
    match (&last.tilt, last.is_level()) {
        (Some(tilt), Some(false)) => format!(
            "A corner is {} µm out of focus when the middle is sharp; the depth of field is {} µm.",
            fixed(tilt.corner_um.value, 2),
            fixed(last.depth_of_field_um, 2)
        ),
        (Some(_), _) => "The view is level as far as the focus shows.".into(),
        (None, _) => "Too little of the view has a focus of its own to tell a tilt.".into(),
    }
}

/// Each look at it, as a map of the heights.
pub(crate) fn section(r: &Report<'_>) -> String {
    let mut out = String::from(
        "<p class=\"lead\">The height at which each part of the view is sharpest, beside the middle of the plane through all of them: one colour above it, the \
         other below, stronger with the distance. Empty squares lie elsewhere than most and do not count.</p>\n<div class=\"plots\">\n",
    );
    for tilt in &r.timeline.tilts {
        out.push_str(&figure(tilt));
    }
    out.push_str("</div>\n");
    out
}

fn figure(report: &TiltReport) -> String {
    let [w, h] = report.image_size_px.map(|side| side.max(1) as f64);
    let scale = (WIDTH / w).min(TALLEST / h);
    let name = format!("Heights in focus over the view at {}", report.objective);
    let mut c = Canvas::new(scale * h, &name);
    let middle_um = report.tilt.as_ref().map_or(0.0, |t| t.z_um);
    let used = || report.heights.iter().filter(|b| b.used);
    let most_um = used()
        .map(|b| (b.z_um - middle_um).abs())
        .fold(1e-9, f64::max);
    // As many squares as there are blocks fill the image.
    let side = 0.8 * scale * (w * h / report.blocks.max(1) as f64).sqrt();
    for block in &report.heights {
        let off_um = block.z_um - middle_um;
        let class = if off_um > 0.0 { "calibrate" } else { "focus" };
        let strong = match block.used {
            true => (off_um.abs() / most_um).clamp(0.05, 1.0),
            false => 0.0,
        };
        let at = |k: usize, side_px: f64| scale * (block.at_px[k] + 0.5 * side_px) - 0.5 * side;
        let mut square = String::new();
        let _ = write!(
            square,
            "<rect class=\"mark {class}\" x=\"{}\" y=\"{}\" width=\"{2}\" height=\"{2}\" fill-opacity=\"{3}\" stroke=\"currentColor\" \
             stroke-opacity=\".3\"><title>{4} µm</title></rect>",
            Attr(at(0, w)),
            Attr(at(1, h)),
            Attr(side),
            Attr(strong),
            fixed(off_um, 2)
        );
        c.raw(&square);
    }
    let caption = match &report.tilt {
        Some(tilt) => format!(
            "{} ± {} µm per mm to the right, {} ± {} downwards; a corner {} µm out of focus, the depth of field {} µm; {} of {}{}.",
            fixed(tilt.slope_um_per_mm[0].value, 2),
            fixed(tilt.slope_um_per_mm[0].sigma, 2),
            fixed(tilt.slope_um_per_mm[1].value, 2),
            fixed(tilt.slope_um_per_mm[1].sigma, 2),
            fixed(tilt.corner_um.value, 2),
            fixed(report.depth_of_field_um, 2),
            tilt.used,
            count(report.blocks, "part"),
            if tilt.shown {
                ""
            } else {
                "; no tilt that the data show"
            }
        ),
        None => format!(
            "{} of {} with a focus of their own: too few.",
            report.heights.len(),
            count(report.blocks, "part")
        ),
    };
    format!(
        "<figure>{}<figcaption><b>{}</b>: {caption}</figcaption></figure>\n",
        c.finish(),
        escape(&report.objective.0)
    )
}
