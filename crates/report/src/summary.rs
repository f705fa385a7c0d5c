//! The top of the page: did it arrive, how far off, how is that known.

use crate::bullseye;
use crate::model::{Context, Report, verdict_word, view_name};
use crate::picture::aim;
use crate::text::{deg, deg_within, escape, fixed, seconds, um, um_within, units};
use crate::timeline::outline;
use scopeservo_scope::{Axis, StagePose};
use scopeservo_servo::Verdict;
use std::fmt::Write as _;

/// How answers look: a class of the style and the path of an icon.
pub(crate) const DONE: (&str, &str) = ("arrived", "M9 20.5l7 7L31 12.5");
pub(crate) const REFUSED: (&str, &str) = ("refused", "M12 12l16 16M28 12l-16 16");
/// Where the page puts its list of contents.
pub(crate) const CONTENTS: &str = "<!--contents-->";
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
    out.push_str(&beside(r));
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
    let about: Vec<_> = [&*context.specimen, &context.instrument, simulated]
        .into_iter()
        .filter(|t| !t.is_empty())
        .map(|t| escape(&units(t)))
        .collect();
    let mut out = format!(
        "<header class=\"{class}\">\n<div class=\"answer\">\n<p class=\"over\">{}</p>\n<div class=\"verdict\">\
         <svg class=\"icon\" viewBox=\"0 0 40 40\" aria-hidden=\"true\"><circle cx=\"20\" cy=\"20\" r=\"19\"/><path d=\"{icon}\"/></svg>\
         <h1>{word}</h1></div>\n<p class=\"message\">{}</p>\n",
        escape(&units(title)),
        escape(message),
    );
    if !about.is_empty() {
        let _ = writeln!(out, "<p class=\"about\">{}</p>", about.join(" · "));
    }
    out
}

/// The end of the header: facts of the run, and what the page has to show. Its place is beside the answer where there is room.
pub(crate) fn beside(r: &Report<'_>) -> String {
    let facts = facts(r);
    let facts = match facts.is_empty() {
        true => facts,
        false => format!("<dl class=\"facts\">\n{facts}</dl>\n"),
    };
    format!("</div>\n<div class=\"aside\">\n{facts}{CONTENTS}</div>\n</header>\n")
}

fn facts(r: &Report<'_>) -> String {
    let mut out = String::new();
    let mut add = |name: &str, value: &str| {
        if !value.is_empty() {
            let _ = writeln!(out, "<div><dt>{name}</dt><dd>{}</dd></div>", escape(value));
        }
    };
    add("Date", &r.context.date);
    add("Saved view", &r.context.target);
    if let Some(objective) = r.timeline.active {
        add("Objective at the end", &objective.0);
    }
    add(
        "Stage at the end",
        &r.timeline.stage.map_or(String::new(), place),
    );
    for stored in r.timeline.used() {
        let name = format!("Calibration {}", stored.calibration.objective);
        add(&name, &format!("{}{}", stored.file, stored.of_when()));
    }
    out
}

/// A place of the stage, every axis in its unit.
fn place(at: &StagePose) -> String {
    let all = Axis::ALL.into_iter().filter_map(|axis| {
        let si = at.si(axis)?;
        let rotation = match axis {
            Axis::Rx => "rx",
            Axis::Ry => "ry",
            Axis::Rz => "rz",
            Axis::X | Axis::Y | Axis::Z => {
                return Some(format!("{axis} {} µm", fixed(1e6 * si, 1)));
            }
        };
        Some(format!("{rotation} {}", deg(si.to_degrees())))
    });
    all.collect::<Vec<_>>().join(", ")
}

/// With a capital letter and a full stop.
pub(crate) fn sentence(text: &str) -> String {
    let mut chars = text.chars();
    let first = chars.next().map(|c| c.to_uppercase().to_string());
    let mut out = first.unwrap_or_default() + chars.as_str();
    out = units(&out);
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
    let measured = r.timeline.outcome.and_then(|o| {
        o.estimated_error_um?;
        o.magnifications.last()?.end.result()
    });
    if let Some(e) = measured {
        add(
            &mut first,
            "off, as measured, ± one σ",
            um_within(e.error.distance_um(), e.sigma_um),
            "big",
        );
        add(
            &mut first,
            "turned, as measured, ± one σ",
            deg_within(e.error.angle_deg().abs(), e.sigma_deg),
            "big",
        );
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
            "Measured in {from} at {}: {} agreeing places of the saved view lie {} beside where they were, known to ±{} (one \
             standard deviation). Expected error of the arrival, both together: {}.",
            escape(&m.objective.0),
            e.inliers,
            um(e.error.distance_um()),
            um(e.sigma_um),
            um(f64::hypot(e.error.distance_um(), e.sigma_um))
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
                     <figcaption>Saved view and view at the end ({}). Drag the line.{}</figcaption></figure>\n",
                    escape(&m.objective.0),
                    r.gallery.brighter(&["target", &view_name(sequence)])
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
                    format!(" Not recognised: {}.", escape(&l.reason))
                });
                figures.push(format!(
                    "<figure>{view}<figcaption>The last view, {} at iteration {iteration}.{why}{}</figcaption></figure>\n",
                    escape(&m.objective.0),
                    r.gallery.brighter(&[&view_name(sequence)])
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
                        "<figure>{picture}<figcaption>{caption}{}</figcaption></figure>\n",
                        r.gallery.brighter(&[name])
                    ));
                }
            }
            figures.extend(target_alone(r));
        }
    }
    figures.extend(bullseye::figure(r));
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
        "<figure class=\"goal\">{target}<figcaption>The saved view{objective}.{}</figcaption></figure>\n",
        r.gallery.brighter(&["target"])
    ))
}
