//! The blocks of pixels that testify, drawn on the view: which of them lie where the transform puts them.

use crate::model::{Report, view_name};
use crate::svg::Attr;
use crate::text::{escape, fixed};
use crate::timeline::Magnification;
use std::fmt::Write as _;

/// Of the last view of a magnification whose pixels were asked; empty where there is none, or where its picture was not kept.
pub(crate) fn figure(r: &Report<'_>, m: &Magnification<'_>) -> String {
    let asked = m.iterations.iter().rev().find_map(|i| {
        let evidence = i.pixels?.evidence.as_ref()?;
        let name = view_name(i.sequence);
        Some((evidence, r.gallery.size(&name)?, name))
    });
    let Some((evidence, (w, h), name)) = asked else {
        return String::new();
    };
    let mut squares = String::new();
    for block in &evidence.blocks {
        let class = if block.agrees { "yes" } else { "no" };
        let [x, y] = block.in_view.map(|v| v - evidence.side_px / 2.0);
        let _ = write!(
            squares,
            "<rect class=\"block {class}\" x=\"{}\" y=\"{}\" width=\"{side}\" height=\"{side}\"/>",
            Attr(x),
            Attr(y),
            side = Attr(evidence.side_px),
        );
    }
    let label = format!(
        "{} of {} blocks of pixels lie where they should",
        evidence.agree, evidence.asked
    );
    let kind = match evidence.held_out {
        true => "on which no feature lies that was used",
        false => "features used or not, as hardly any is without",
    };
    format!(
        "<figure class=\"one-view\"><svg class=\"pic\" role=\"img\" viewBox=\"-0.5 -0.5 {} {}\" aria-label=\"{label}\"><title>{label}</title>{}{squares}</svg>\
         <figcaption><b>{}, by its pixels.</b> {label} ({kind}), {} % of the structure; where the place is wrong 1 in 100 does.</figcaption></figure>\n",
        Attr(w),
        Attr(h),
        r.gallery.draw(&name),
        escape(&m.objective.0),
        fixed(100.0 * evidence.share, 0),
    )
}
