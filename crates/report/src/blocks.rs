//! The blocks of pixels that testify, drawn on the view: which of them lie where the transform puts them.

use crate::model::{Report, view_name};
use crate::svg::Attr;
use crate::text::{escape, fixed};
use crate::told::Magnification;
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
    let null = null(evidence.agree as f64 / evidence.asked.max(1) as f64);
    format!(
        "<figure class=\"one-view\"><svg class=\"pic\" role=\"img\" viewBox=\"-0.5 -0.5 {} {}\" aria-label=\"{label}\"><title>{label}</title>{}{squares}{}</svg>\
         <figcaption><b>{}, by its pixels.</b> {label} ({kind}), {} % of the structure.{null}</figcaption></figure>\n",
        Attr(w),
        Attr(h),
        r.gallery.draw(&name),
        r.gallery.bar(&name),
        escape(&m.objective.0),
        fixed(100.0 * evidence.share, 0),
    )
}

/// What wrong places showed: of 113 pairs of another slide, a serial section, a field or some pixels beside, or a lattice, the largest share of blocks
/// that agreed, and what they did in the median (docs/measured.md, "Pixels").
const NULL_WORST: f64 = 0.024;
const NULL_MEDIAN: f64 = 0.003;
/// And what right places showed in the median, from the same blurred by 6 pixels on.
const RIGHT_LEAST: f64 = 0.19;

/// This share beside those of wrong and of right places, as a strip from 0 to all.
fn null(share: f64) -> String {
    let at = |v: f64| Attr(4.0 + 272.0 * v.clamp(0.0, 1.0));
    let label = format!(
        "{} % of the blocks agree here; at wrong places {} % did in the median and {} % at most, at right ones from {} % on",
        fixed(100.0 * share, 0),
        fixed(100.0 * NULL_MEDIAN, 1),
        fixed(100.0 * NULL_WORST, 1),
        fixed(100.0 * RIGHT_LEAST, 0),
    );
    format!(
        "<svg class=\"strip\" role=\"img\" viewBox=\"0 0 280 44\" aria-label=\"{label}\"><title>{label}</title>\
         <rect class=\"wrong\" x=\"{}\" y=\"18\" width=\"{}\" height=\"8\"/><rect class=\"right\" x=\"{}\" y=\"18\" width=\"{}\" height=\"8\"/>\
         <path class=\"here\" d=\"M{} 12v20\"/><text class=\"tick\" x=\"4\" y=\"41\">wrong places</text>\
         <text class=\"tick end\" x=\"276\" y=\"41\">right ones</text><text class=\"tick mid\" x=\"{}\" y=\"9\">here</text></svg>",
        at(0.0),
        Attr(272.0 * NULL_WORST),
        at(RIGHT_LEAST),
        Attr(272.0 * (1.0 - RIGHT_LEAST)),
        at(share),
        Attr(4.0 + 272.0 * share.clamp(0.06, 0.94)),
    )
}
