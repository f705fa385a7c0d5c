//! The top of the page: did it arrive, how far off, how is that known.

use crate::model::{Context, Report, verdict_word, view_name};
use crate::picture::aim;
use crate::svg::{Attr, Canvas, Key, Mark, Panel, Scale, nice_step};
use crate::text::{deg, escape, fixed, prose, seconds, short, um, units};
use crate::timeline::outline;
use scopeservo_servo::Verdict;
use std::fmt::Write as _;

/// How answers look: a class of the style and the path of an icon.
pub(crate) const DONE: (&str, &str) = ("arrived", "M9 20.5l7 7L31 12.5");
pub(crate) const REFUSED: (&str, &str) = ("refused", "M12 12l16 16M28 12l-16 16");
pub(crate) const UNFINISHED: (&str, &str) = ("unfinished", "M12 20h.2M20 20h.2M28 20h.2");

pub(crate) fn section(r: &Report<'_>, title: &str) -> String {
    let outcome = r.timeline.outcome;
    let (class, icon) = match outcome.map(|o| o.verdict) {
        Some(Verdict::Arrived) => DONE,
        Some(Verdict::NotFound) => (
            "lost",
            "M14 15a6 6 0 1 1 8.5 5.5c-2 1-2.5 2-2.5 4.500M20 30.500v.2",
        ),
        Some(Verdict::Refused) => REFUSED,
        // Two that look the same.
        Some(Verdict::Ambiguous) => (
            "refused",
            "M9 20a5 5 0 1 0 10 0a5 5 0 1 0-10 0M21 20a5 5 0 1 0 10 0a5 5 0 1 0-10 0",
        ),
        None => UNFINISHED,
    };
    let message = outcome.map_or_else(
        || "The record of this run ends before an answer was given.".into(),
        |o| sentence(&o.message),
    );
    let mut out = head(
        r.context,
        title,
        (class, icon),
        [verdict_word(&r.timeline), &message],
    );
    out.push_str(&numbers(r));
    out.push_str(&known(r));
    out.push_str("</header>\n");
    out.push_str(&comparison(r));
    out
}

/// The beginning of a page's header, up to what it is about: how it looks, the answer in a word, and the answer in a sentence.
pub(crate) fn head(
    context: &Context,
    title: &str,
    (class, icon): (&str, &str),
    [word, message]: [&str; 2],
) -> String {
    let told = context.instrument.contains("simulated");
    let simulated = match context.simulated && !told {
        true => "simulated microscope",
        false => "",
    };
    let about: Vec<_> = [
        &*context.specimen,
        &context.instrument,
        simulated,
        &context.date,
    ]
    .into_iter()
    .filter(|t| !t.is_empty())
    .map(prose)
    .collect();
    let mut out = format!(
        "<header class=\"{class}\">\n<p class=\"over\">{}</p>\n<div class=\"verdict\">\
         <svg class=\"icon\" viewBox=\"0 0 40 40\" aria-hidden=\"true\"><circle cx=\"20\" cy=\"20\" r=\"19\"/><path d=\"{icon}\"/></svg>\
         <h1>{word}</h1></div>\n<p class=\"message\">{}</p>\n",
        escape(title),
        escape(message),
    );
    if !about.is_empty() {
        let _ = writeln!(out, "<p class=\"about\">{}</p>", about.join(" · "));
    }
    out
}

/// With a capital letter and a full stop.
pub(crate) fn sentence(text: &str) -> String {
    let mut chars = text.chars();
    let first = chars.next().map(|c| c.to_uppercase().to_string());
    let mut out = first.unwrap_or_default() + chars.as_str();
    // Events are written in ASCII; a page need not be.
    out = units(&out);
    for digit in '0'..='9' {
        out = out.replace(&format!(" -{digit}"), &format!(" \u{2212}{digit}"));
    }
    if !out.ends_with(['.', '!', '?']) {
        out.push('.');
    }
    out
}

fn numbers(r: &Report<'_>) -> String {
    let mut first = String::new();
    let mut second = String::new();
    let add = |out: &mut String, name: &str, value: String, class: &str| {
        let _ = writeln!(
            out,
            "<div class=\"{class}\"><dt>{name}</dt><dd>{}</dd></div>",
            escape(&value)
        );
    };
    if let Some(outcome) = r.timeline.outcome {
        if let Some(v) = outcome.estimated_error_um {
            add(&mut first, "off, as measured", um(v), "big");
        }
        if let Some(v) = outcome.estimated_error_deg {
            add(&mut first, "turned, as measured", deg(v), "big");
        }
    }
    if let Some(t) = r.truth.filter(|t| t.error_um.is_finite()) {
        add(&mut first, "off in truth", um(t.error_um), "big true");
        add(
            &mut first,
            "turned in truth",
            deg(t.error_deg.abs()),
            "big true",
        );
    }
    let iterations = r.timeline.iterations();
    if iterations > 0 {
        add(&mut second, "iterations", iterations.to_string(), "");
        let moves = r
            .timeline
            .magnifications
            .iter()
            .flat_map(|m| &m.iterations)
            .filter(|i| !i.converged)
            .count();
        add(&mut second, "corrections", moves.to_string(), "");
    }
    if r.timeline.frames > 0 {
        add(&mut second, "frames", r.timeline.frames.to_string(), "");
    }
    if r.timeline.duration_s > 0.0 {
        add(
            &mut second,
            "instrument time",
            seconds(r.timeline.duration_s),
            "",
        );
    }
    [first, second]
        .into_iter()
        .filter(|list| !list.is_empty())
        .map(|list| format!("<dl class=\"numbers\">\n{list}</dl>\n"))
        .collect()
}

fn known(r: &Report<'_>) -> String {
    let mut out = String::new();
    let last = r.timeline.outcome.and_then(|o| o.magnifications.last());
    let result = last.and_then(|m| m.end.result());
    if let (Some(m), Some(e)) = (last, result) {
        let frames = r.timeline.magnifications.last().map_or(0, |m| {
            m.iterations
                .iter()
                .rev()
                .take_while(|i| i.converged)
                .count()
        });
        let from = if frames > 1 {
            format!("the last {frames} frames")
        } else {
            "the last frame".into()
        };
        let _ = write!(
            out,
            "Estimated from {from} at {}, compared with the saved view: {} apart over {} inliers, known to ±{}; \
             both added in quadrature.",
            escape(&m.objective.0),
            um(e.error.distance_um()),
            e.inliers,
            um(e.sigma_um)
        );
    }
    match (
        r.truth,
        r.timeline.outcome.and_then(|o| o.estimated_error_um),
    ) {
        (Some(t), Some(estimate)) if t.error_um.is_finite() => {
            let _ = write!(
                out,
                " The simulation knows the truth: the view is {} off, the estimate {} it by {}.",
                um(t.error_um),
                if estimate >= t.error_um {
                    "exceeds"
                } else {
                    "falls short of"
                },
                um((t.error_um - estimate).abs())
            );
        }
        (None, Some(_)) => out.push_str(
            " This is the program's own measurement; a stage that drifts afterwards is not in it.",
        ),
        _ => {}
    }
    if out.is_empty() {
        String::new()
    } else {
        format!("<p class=\"known\">{}</p>\n", out.trim_start())
    }
}

/// The last view beside the target: what a person would look at to believe it.
fn comparison(r: &Report<'_>) -> String {
    let last = r
        .timeline
        .magnifications
        .last()
        .and_then(|m| Some((m, *m.frames().last()?)));
    let mut figures = Vec::new();
    match last {
        Some((m, (_, sequence))) if r.gallery.size("blend").is_some() => {
            let view = r
                .gallery
                .figure(&view_name(sequence), "The view at the end of the run", "");
            let target = r.gallery.figure("target", "The saved view", "");
            if let (Some(view), Some(target)) = (view, target) {
                figures.push(format!(
                    "<figure class=\"wide\"><div class=\"compare\">{target}<div class=\"over-it\">{view}</div>\
                     <span class=\"left\" aria-hidden=\"true\">saved view</span><span class=\"right\" aria-hidden=\"true\">now</span><i></i>\
                     <input type=\"range\" min=\"0\" max=\"100\" value=\"50\" aria-label=\"Share of the saved view that is shown\" \
                     oninput=\"this.parentNode.style.setProperty('--at',this.value+'%')\"/></div>\
                     <figcaption>Saved view and view at the end ({}). Drag the line.</figcaption></figure>\n",
                    escape(&m.objective.0)
                ));
            }
            if let Some(blend) = r.gallery.figure(
                "blend",
                "Saved view in red and view at the end in cyan; grey where they agree",
                "",
            ) {
                figures.push(format!(
                    "<figure>{blend}<figcaption>Saved view in red, view at the end in cyan: grey where they agree, fringes where \
                     they do not.</figcaption></figure>\n"
                ));
            }
        }
        Some((m, (iteration, sequence))) => {
            let target_size = r.target_size();
            let overlay = r.gallery.size(&view_name(sequence)).map(|(w, h)| {
                let seen = m.by_sequence(sequence);
                let corners = seen.and_then(|s| outline(s.target_from_view, target_size?));
                aim(w, h, corners.as_ref())
            });
            let view = r.gallery.figure(
                &view_name(sequence),
                "The last view of the run",
                &overlay.unwrap_or_default(),
            );
            if let Some(view) = view {
                let lost = m.lost.iter().find(|l| l.sequence == sequence);
                let why = lost.map_or(String::new(), |l| {
                    format!(" Not recognised: {}.", prose(&l.reason))
                });
                figures.push(format!(
                    "<figure>{view}<figcaption>The last view, {} at iteration {iteration}.{why}</figcaption></figure>\n",
                    escape(&m.objective.0)
                ));
            }
            figures.extend(target_alone(r));
        }
        None => {
            for (name, caption) in [
                ("sharpest", "The sharpest image of the last focus sweep."),
                ("newest", "The last image of the run."),
            ] {
                if let Some(picture) = r.gallery.figure(name, caption, "") {
                    figures.push(format!(
                        "<figure>{picture}<figcaption>{caption}</figcaption></figure>\n"
                    ));
                }
            }
            figures.extend(target_alone(r));
        }
    }
    figures.extend(bullseye(r));
    if figures.is_empty() {
        return "<p class=\"none\">No image of this run was kept.</p>\n".into();
    }
    format!("<div class=\"looks\">\n{}</div>\n", figures.concat())
}

fn target_alone(r: &Report<'_>) -> Option<String> {
    let target = r.gallery.figure("target", "The saved view", "")?;
    let objective = r
        .timeline
        .target_objective
        .map_or(String::new(), |o| format!(", {}", escape(&o.0)));
    Some(format!(
        "<figure class=\"goal\">{target}<figcaption>The saved view{objective}.</figcaption></figure>\n"
    ))
}

/// Rings about a centre, `ring` micrometres apart, where one micrometre is `unit` long.
fn rings(c: &mut Canvas, [cx, cy]: [f64; 2], ring: f64, unit: f64, count: usize) {
    for k in 1..=count {
        let radius = k as f64 * ring * unit;
        c.raw(&format!(
            "<circle class=\"grid\" cx=\"{}\" cy=\"{}\" r=\"{}\"/>",
            Attr(cx),
            Attr(cy),
            Attr(radius)
        ));
        let decimals = (-ring.log10().floor()).max(0.0) as usize;
        c.text(
            "tick mid lift",
            cx,
            cy - radius + 4.0,
            &fixed(k as f64 * ring, decimals),
        );
    }
}

/// The square of one pixel of the target, from its centre and half its side.
fn square(c: &mut Canvas, [cx, cy]: [f64; 2], half: f64) {
    c.raw(&format!(
        "<rect class=\"pixel\" x=\"{}\" y=\"{}\" width=\"{2}\" height=\"{2}\"/>",
        Attr(cx - half),
        Attr(cy - half),
        Attr(2.0 * half)
    ));
}

/// Where the view's centre ended around the target's, against one pixel.
fn bullseye(r: &Report<'_>) -> Option<String> {
    r.timeline.outcome?.estimated_error_um?;
    let step = r.timeline.last_seen()?;
    let target = r.target_size()?;
    let (w, h) = r.gallery.size(&view_name(step.sequence))?;
    let [x, y] = r.timeline.offset_um(step, [w, h], target)?;
    let pixel_um = r.timeline.target_calibration()?.um_per_px();
    let sigma_um = step.sigma_px * pixel_um;
    let truth = r.true_at(step.sequence).map(|t| [t.x_um, t.y_um]);
    let reach = [
        x,
        y,
        truth.map_or(0.0, |t| t[0]),
        truth.map_or(0.0, |t| t[1]),
        pixel_um,
    ]
    .into_iter()
    .filter(|v| v.is_finite())
    .fold(2.0 * sigma_um, |m, v| m.max(v.abs()));
    let ring = nice_step(reach / 3.0);
    let outer = ring * (reach / ring * 1.02).ceil();
    let side = 236.0;
    let p = Panel {
        left: 22.0,
        top: 10.0,
        width: side,
        height: side,
        x: Scale::exact(-outer, outer),
        y: Scale::exact(-outer, outer),
        y_down: true,
    };
    let mut c = Canvas::new(
        side + 34.0,
        &format!(
            "The view's centre ended {} from the saved view's",
            um(x.hypot(y))
        ),
    );
    let unit = side / (2.0 * outer);
    let [cx, cy] = p.at(0.0, 0.0);
    rings(
        &mut c,
        [cx, cy],
        ring,
        unit,
        (outer / ring).round() as usize,
    );
    square(&mut c, [cx, cy], pixel_um * unit / 2.0);
    c.mark("faint", Mark::Plus, cx, cy);
    let [mx, my] = p.at(x, y);
    c.raw(&format!(
        "<circle class=\"sigma\" cx=\"{}\" cy=\"{}\" r=\"{}\"/>",
        Attr(mx),
        Attr(my),
        Attr((sigma_um * unit).max(1.0))
    ));
    c.mark("ink", Mark::Dot, mx, my);
    let mut keys = vec![Key {
        class: "ink",
        mark: Some(Mark::Dot),
        line: false,
        label: "last measurement",
    }];
    if let Some([tx, ty]) = truth {
        let [tx, ty] = p.at(tx, ty);
        c.mark("truth", Mark::Ring, tx, ty);
        keys.push(Key {
            class: "truth",
            mark: Some(Mark::Ring),
            line: false,
            label: "truth",
        });
    }
    c.legend(36.0, side + 30.0, &keys);
    Some(format!(
        "<figure>{}<figcaption>Where the view's centre ended around the saved view's, µm. The square is one pixel of the \
         saved view ({} µm); the disc is one standard deviation.</figcaption></figure>\n",
        c.finish(),
        short(pixel_um)
    ))
}
