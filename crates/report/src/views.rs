//! The paper's Fig. 7: per magnification the views on the way, the target, and the curves.

use crate::model::{Report, view_name};
use crate::picture::aim;
use crate::plots;
use crate::recorder::SHOWN_ITERATIONS;
use crate::text::{count, deg, escape, fixed, um};
use crate::timeline::outline;
use crate::told::Magnification;
use scopeservo_servo::Calibration;
use std::fmt::Write as _;

pub(crate) fn section(r: &Report<'_>) -> String {
    if r.timeline.magnifications.is_empty() {
        return "<p class=\"none\">The run ended before the stage was servoed, so there is no way to show.</p>\n".into();
    }
    let mut out = String::from(
        "<p class=\"lead\">Each look tells how far off the view stands, and a move takes that away: all of it, or a share of it with the published method. \
         The dashed frame is the saved view as recognised in the present one; the cross is the middle of the image.</p>\n",
    );
    for m in &r.timeline.magnifications {
        let _ = write!(
            out,
            "<article>\n<h3>{}</h3>\n<p>{}</p>\n",
            escape(&m.objective.0),
            summary(r, m)
        );
        out.push_str(&pictures(r, m));
        out.push_str(&plots::section(r, m));
        out.push_str(&table(r, m));
        out.push_str("</article>\n");
    }
    out
}

fn summary(r: &Report<'_>, m: &Magnification<'_>) -> String {
    let mut out = count(m.frames().len(), "iteration");
    if let (Some(first), Some(last)) = (m.iterations.first(), m.iterations.last()) {
        let _ = write!(
            out,
            ", from {} and {} to {} and {}",
            um(first.error.distance_um()),
            deg(first.error.angle_deg().abs()),
            um(last.error.distance_um()),
            deg(last.error.angle_deg().abs())
        );
        if let Some(c) = m.calibration {
            let _ = write!(out, "; a pixel is {} here", um(c.um_per_px()));
        }
        if let Some(t) = r.true_at(last.sequence) {
            let _ = write!(out, "; in truth {} at the end", um(t.error_um));
        }
    }
    out.push('.');
    if let Some(lost) = m.lost.last() {
        let _ = write!(
            out,
            " In {} the saved view was not recognised; last because of this: {}.",
            count(m.lost.len(), "frame"),
            escape(&lost.reason)
        );
    }
    out
}

fn pictures(r: &Report<'_>, m: &Magnification<'_>) -> String {
    let target = r.target_size();
    let frames = m.frames();
    let last = frames.last().copied();
    let mut out = String::new();
    let mut names = vec!["target".to_owned()];
    for (iteration, sequence) in frames {
        if !SHOWN_ITERATIONS.contains(&iteration) && last != Some((iteration, sequence)) {
            continue;
        }
        let name = view_name(sequence);
        let Some((w, h)) = r.gallery.size(&name) else {
            continue;
        };
        let seen = m.by_sequence(sequence);
        let corners = seen.and_then(|s| outline(s.target_from_view, target?));
        let caption = format!(
            "{iteration}{}",
            match (last == Some((iteration, sequence)), seen) {
                (_, None) => ", not recognised",
                (true, _) => ", the last",
                _ => "",
            }
        );
        let label = format!("View at {}, iteration {caption}", m.objective);
        if let Some(svg) = r
            .gallery
            .figure(&name, &label, &aim(w, h, corners.as_ref()))
        {
            let _ = writeln!(
                out,
                "<figure>{svg}<figcaption>iteration {caption}</figcaption></figure>"
            );
        }
        names.push(name);
    }
    if out.is_empty() {
        return "<p class=\"none\">No views of this magnification were kept.</p>\n".into();
    }
    let goal = r.gallery.size("target").and_then(|(w, h)| {
        r.gallery
            .figure("target", "The saved view", &aim(w, h, None))
    });
    if let Some(svg) = goal {
        let objective = r.timeline.target_objective.map_or("", |o| &o.0);
        let _ = writeln!(
            out,
            "<figure class=\"goal\">{svg}<figcaption>saved view {}</figcaption></figure>",
            escape(objective)
        );
    }
    let dim = r
        .gallery
        .brighter(&names.iter().map(String::as_str).collect::<Vec<_>>());
    let dim = match dim.is_empty() {
        true => dim,
        false => format!("<p class=\"known\">{}</p>\n", dim.trim_start()),
    };
    format!("<div class=\"row\">\n{out}</div>\n{dim}")
}

fn table(r: &Report<'_>, m: &Magnification<'_>) -> String {
    if m.iterations.is_empty() {
        return String::new();
    }
    let pixel_um = r.timeline.target_calibration().map(Calibration::um_per_px);
    let unit = pixel_um.map_or("target px", |_| "µm");
    let mut out = format!(
        "<details class=\"table\"><summary>The numbers</summary><div class=\"scroll\"><table>\n<thead><tr><th scope=\"col\">iteration</th>\
         <th scope=\"col\">e<sub>x</sub>, µm</th><th scope=\"col\">e<sub>y</sub>, µm</th><th scope=\"col\">e<sub>θ</sub>, °</th>\
         <th scope=\"col\">agreeing of matches</th><th scope=\"col\">σ of the place, {unit}</th></tr></thead>\n<tbody>\n",
    );
    for i in &m.iterations {
        let _ = writeln!(
            out,
            "<tr><th scope=\"row\">{}{}</th><td>{}</td><td>{}</td><td>{}</td><td>{} of {}{}</td><td>{}</td></tr>",
            i.iteration,
            if i.converged { " ✓" } else { "" },
            fixed(i.error.t_m[0] * 1e6, 3),
            fixed(i.error.t_m[1] * 1e6, 3),
            fixed(i.error.angle_deg(), 4),
            i.inliers,
            i.matches,
            i.located_by(),
            fixed(i.sigma_px * pixel_um.unwrap_or(1.0), 3)
        );
    }
    out.push_str("</tbody></table></div></details>\n");
    out
}
