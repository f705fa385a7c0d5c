//! The places that view and target share, drawn: why the program believes what it sees.

use crate::blocks::figure;
use crate::model::{Report, view_name};
use crate::picture::Gallery;
use crate::svg::Attr;
use crate::text::{count, escape, fixed};
use std::fmt::Write as _;

/// More lines than this are a carpet.
const SHOWN_PAIRS: usize = 120;
/// Between the two images, as a share of the view's width.
const GAP: f64 = 0.03;

pub(crate) fn section(r: &Report<'_>) -> String {
    let mut out = String::new();
    for m in &r.timeline.magnifications {
        let Some(first) = m.iterations.first() else {
            continue;
        };
        let name = view_name(first.sequence);
        if first.pairs.is_empty() {
            continue;
        }
        let words = ["first view", "saved view"];
        let Some((svg, shown)) = drawing(&r.gallery, [&name, "target"], words, first.pairs) else {
            continue;
        };
        let share = if shown < first.pairs.len() {
            format!("; {shown} of them drawn")
        } else {
            String::new()
        };
        let objective = escape(&m.objective.0);
        let goal = r
            .timeline
            .target_objective
            .map_or(String::new(), |o| escape(&o.0));
        let _ = writeln!(
            out,
            "<figure class=\"pairs\"><div class=\"scroll\">{svg}</div><figcaption><b>{objective} to {goal}.</b> First view (left) and \
             saved view (right): {} among {}{}{share}.</figcaption></figure>",
            count(first.inliers, "agreeing place"),
            count(first.matches, "match").replace("matchs", "matches"),
            first.located_by(),
        );
        out.push_str(&figure(r, m));
    }
    if out.is_empty() {
        return "<p class=\"none\">No view was recognised, so there are no matching places to show.</p>\n".into();
    }
    format!(
        "<p class=\"lead\">Each line joins one place of the specimen in the first view of a magnification and in the saved view. \
         Places are recognised by their look alone, unless said otherwise; only those that agree on one shift, turn and scale are kept.</p>\n{out}"
    )
}

/// Two pictures side by side with lines between the places that they share, x, y in the left one, x, y in the right one; and how many lines.
/// `None` where one of them is not there.
pub(crate) fn drawing(
    gallery: &Gallery,
    names: [&str; 2],
    words: [&str; 2],
    pairs: &[[f32; 4]],
) -> Option<(String, usize)> {
    let [(w, h), (tw, th)] = [gallery.size(names[0])?, gallery.size(names[1])?];
    // Both images as high as the view.
    let scale = h / th;
    let gap = w * GAP;
    let right = w + gap;
    let total = right + tw * scale;
    let mut chosen: Vec<&[f32; 4]> = pairs
        .iter()
        .filter(|p| p.iter().all(|v| v.is_finite()))
        .collect();
    // From top to bottom in the target, so that the colours run as the lines do.
    chosen.sort_by(|a, b| a[3].total_cmp(&b[3]));
    let n = chosen.len().min(SHOWN_PAIRS);
    let stride = chosen.len() as f64 / n.max(1) as f64;
    let mut lines = String::new();
    let mut dots = String::new();
    for k in 0..n {
        let p = chosen[(k as f64 * stride) as usize].map(f64::from);
        let (x, y) = (
            right + (p[2] + 0.5) * scale - 0.5,
            (p[3] + 0.5) * scale - 0.5,
        );
        let shade = k * 6 / n;
        let _ = write!(
            lines,
            "<path class=\"pair s{shade}\" d=\"M{} {}L{} {}\"/>",
            Attr(p[0]),
            Attr(p[1]),
            Attr(x),
            Attr(y)
        );
        for (x, y) in [(p[0], p[1]), (x, y)] {
            let _ = write!(
                dots,
                "<circle class=\"end s{shade}\" cx=\"{}\" cy=\"{}\" r=\"{}\"/>",
                Attr(x),
                Attr(y),
                Attr(w * 0.0045)
            );
        }
    }
    let label = format!(
        "{n} matching places joined by lines between {} and {}",
        words[0], words[1]
    );
    let svg = format!(
        "<svg class=\"pic\" role=\"img\" viewBox=\"-0.5 -0.5 {} {}\" aria-label=\"{label}\"><title>{label}</title>{}\
         <g transform=\"translate({} {}) scale({})\">{}</g><rect class=\"dim\" x=\"-0.5\" y=\"-0.5\" width=\"{}\" height=\"{}\"/>{lines}{dots}{}\
         <g transform=\"translate({} {}) scale({})\">{}</g></svg>",
        Attr(total),
        Attr(h),
        gallery.draw(names[0]),
        Attr(right + 0.5 * scale - 0.5),
        Attr(0.5 * scale - 0.5),
        fixed(scale, 6),
        gallery.draw(names[1]),
        Attr(total),
        Attr(h),
        gallery.bar(names[0]),
        Attr(right + 0.5 * scale - 0.5),
        Attr(0.5 * scale - 0.5),
        fixed(scale, 6),
        gallery.bar(names[1]),
    );
    Some((svg, n))
}
