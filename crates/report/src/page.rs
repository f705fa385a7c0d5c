//! The page as a whole.

use crate::model::{Report, um_per_px, verdict_word, view_name};
use crate::picture::Gallery;
use crate::recorder::SHOWN_ITERATIONS;
use crate::text::escape;
use crate::timeline::Timeline;
use crate::{Context, Recorder, Truth};
use crate::{calibration, focus, matches, provenance, summary, views};
use scopeservo_scope::ObjectiveId;
use std::fmt::Write as _;

const STYLE: &str = include_str!("style.css");

/// The whole page.
///
/// `truth` is what a simulation knows and a microscope does not; without it the page says how the error was estimated.
pub fn html(recorder: &Recorder, truth: Option<&Truth>, context: &Context) -> String {
    let timeline = Timeline::read(recorder.events());
    let gallery = gallery(recorder, &timeline, context);
    let report = Report {
        timeline,
        gallery,
        truth,
        context,
    };
    let title = match context.title.as_str() {
        "" => "A repositioning run",
        title => title,
    };
    let parts = [
        ("The way there", views::section(&report)),
        ("What was recognised", matches::section(&report)),
        ("Focus", focus::section(&report)),
        ("Calibration", calibration::section(&report)),
        ("Where the time went", provenance::time(&report)),
        ("How this was made", provenance::section(&report)),
    ];
    whole(
        &format!("{}: {title}", verdict_word(&report.timeline)),
        &summary::section(&report, title),
        &parts,
        &report.gallery,
    )
}

/// A page of its head, its parts, each with its heading, and the images that these draw.
pub(crate) fn whole(
    title: &str,
    head: &str,
    parts: &[(&str, String)],
    gallery: &Gallery,
) -> String {
    let mut out = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n\
         <meta name=\"color-scheme\" content=\"light dark\"/>\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'\"/>\n\
         <title>{}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n{head}",
        escape(title)
    );
    out.push_str("<nav aria-label=\"Contents\"><ol>\n");
    for (i, (heading, _)) in parts.iter().enumerate() {
        let _ = writeln!(out, "<li><a href=\"#h{i}\">{heading}</a></li>");
    }
    out.push_str("</ol></nav>\n");
    for (i, (heading, body)) in parts.iter().enumerate() {
        let _ = write!(
            out,
            "<section aria-labelledby=\"h{i}\">\n<h2 id=\"h{i}\">{heading}</h2>\n{body}</section>\n"
        );
    }
    out.push_str("</main>\n");
    out.push_str(&gallery.embed());
    out.push_str("</body>\n</html>\n");
    out
}

/// The images that the page shows.
fn gallery(recorder: &Recorder, timeline: &Timeline<'_>, context: &Context) -> Gallery {
    let mut gallery = Gallery::default();
    let scale = |objective: Option<&ObjectiveId>| um_per_px(timeline, context, objective);
    if let Some(jpeg) = recorder.target().and_then(|t| t.jpeg()) {
        gallery.add("target", jpeg);
    }
    let of_target = scale(timeline.target_objective);
    gallery.scaled("target", of_target);
    for magnification in &timeline.magnifications {
        let frames = magnification.frames();
        let last = frames.last().map(|f| f.1);
        for (iteration, sequence) in frames {
            if (SHOWN_ITERATIONS.contains(&iteration) || last == Some(sequence))
                && let Some(jpeg) = recorder.view(sequence)
            {
                gallery.add(view_name(sequence), jpeg);
                gallery.scaled(view_name(sequence), scale(Some(magnification.objective)));
            }
        }
    }
    let same_objective =
        timeline.magnifications.last().map(|m| m.objective) == timeline.target_objective;
    if let (true, Some(target), Some((_, view))) =
        (same_objective, recorder.target(), recorder.last_view())
        && let Some(jpeg) = target.blend(view).and_then(|b| b.jpeg())
    {
        gallery.add("blend", jpeg);
        gallery.scaled("blend", of_target);
    }
    if timeline.magnifications.is_empty() {
        let unfocused = timeline.sweeps.last().is_some_and(|s| s.result.is_none());
        let (name, picture) = if unfocused {
            ("sharpest", recorder.sharpest())
        } else {
            ("newest", recorder.newest())
        };
        if let Some(jpeg) = picture.and_then(|p| p.jpeg()) {
            gallery.add(name, jpeg);
            gallery.scaled(name, scale(timeline.active));
        }
    }
    gallery
}
