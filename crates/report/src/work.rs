//! The report of a calibration, a focus or a tilt: how it ended, in plain words, and how that is known.

use crate::calibration::{card, in_words};
use crate::changes::{beside_each_other, section as changes};
use crate::model::{Report, Work, WorkEnd, view_name};
use crate::page::whole;
use crate::picture::Gallery;
use crate::summary::{DONE, REFUSED, UNFINISHED, beside, head, sentence};
use crate::text::{count, escape, fixed, seconds};
use crate::timeline::Timeline;
use crate::told::Calibrating;
use crate::{Context, Recorder, chain, focus, provenance, tilt};
use scopeservo_servo::Calibration;
use std::fmt::Write as _;

/// The page of a calibration, a focus or a tilt, whatever came of it.
pub fn work_html(recorder: &Recorder, end: &WorkEnd, context: &Context) -> String {
    let timeline = Timeline::read(recorder.events(), &context.stored);
    let gallery = gallery(recorder, &timeline, end);
    let report = Report {
        timeline,
        gallery,
        truth: None,
        context,
    };
    let mut parts = Vec::new();
    if end.failed.is_some() {
        parts.push(("What was seen at the end", at_the_end(&report)));
    }
    if end.work == Work::Calibration {
        parts.push(("What was measured", measured(&report, end)));
    }
    if !report.timeline.tilts.is_empty() {
        parts.push(("How the view is tilted", tilt::section(&report)));
    }
    if !report.timeline.sweeps.is_empty() {
        parts.push(("Focus", focus::section(&report)));
    }
    parts.push(("Where the time went", provenance::time(&report)));
    parts.push(("How this was made", provenance::section(&report)));
    let (look, word) = answer(end);
    let title = match context.title.as_str() {
        "" => "A calibration",
        title => title,
    };
    let message = message(&report, end);
    let mut header = head(context, title, look, [word, &message]);
    header.push_str(&plain(&report));
    header.push_str(&numbers(&report, end));
    header.push_str(&beside(&report));
    let parts = &parts[..];
    whole(&format!("{word}: {title}"), &header, parts, &report.gallery)
}

type Look = (&'static str, &'static str);

fn answer(end: &WorkEnd) -> (Look, &'static str) {
    let stopped = end.failed.as_ref().map(|f| f.stopped);
    match (stopped, end.work) {
        (Some(true), _) => (UNFINISHED, "Stopped"),
        (Some(false), Work::Calibration) => (REFUSED, "Not calibrated"),
        (Some(false), Work::Focus) => (REFUSED, "No focus"),
        (Some(false), Work::Level) => (REFUSED, "Not levelled"),
        (None, Work::Calibration) => (DONE, "Calibrated"),
        (None, Work::Focus) => (DONE, "In focus"),
        (None, Work::Level) => (DONE, "Tilt measured"),
    }
}

fn message(r: &Report<'_>, end: &WorkEnd) -> String {
    if let Some(failed) = &end.failed {
        return sentence(&failed.message);
    }
    match end.work {
        Work::Calibration => {
            let all = r.timeline.calibrations.iter();
            let made = all.filter(|c| c.made.is_some()).count();
            match made {
                1 => "One objective is calibrated.".into(),
                _ => format!("{made} objectives are calibrated."),
            }
        }
        Work::Level => tilt::in_words(&r.timeline.tilts),
        Work::Focus => {
            let last = r.timeline.sweeps.iter().rev().find_map(|s| s.result);
            let z_um = last.and_then(|f| f.z_um);
            z_um.map_or("The view is in focus.".into(), |z| {
                format!("The view is sharpest at z = {} µm.", fixed(z, 2))
            })
        }
    }
}

/// Each calibration that was made, in plain words.
fn plain(r: &Report<'_>) -> String {
    let made = r.timeline.calibrations.iter().filter_map(|c| c.made);
    let lines: String = made
        .map(|(c, ..)| format!("<li>{}</li>\n", escape(&in_words(c))))
        .collect();
    match lines.is_empty() {
        true => lines,
        false => format!("<ul class=\"plain\">\n{lines}</ul>\n"),
    }
}

fn numbers(r: &Report<'_>, end: &WorkEnd) -> String {
    let mut out = String::new();
    let mut add = |name: &str, value: String| {
        let _ = writeln!(out, "<div><dt>{name}</dt><dd>{}</dd></div>", escape(&value));
    };
    if end.work == Work::Calibration {
        let all = &r.timeline.calibrations;
        let made = all.iter().filter(|c| c.made.is_some()).count();
        add("objectives calibrated", made.to_string());
        let views: usize = all.iter().map(|c| c.shifts_px.len()).sum();
        add("calibration views", views.to_string());
    }
    if r.timeline.frames > 0 {
        add("frames", r.timeline.frames.to_string());
    }
    if r.timeline.duration_s > 0.0 {
        add("instrument time", seconds(r.timeline.duration_s));
    }
    match out.is_empty() {
        true => out,
        false => format!("<dl class=\"numbers\">\n{out}</dl>\n"),
    }
}

/// The calibration that did not come to its end.
fn broken_off<'a, 'b>(timeline: &'b Timeline<'a>) -> Option<&'b Calibrating<'a>> {
    timeline.calibrations.last().filter(|c| c.made.is_none())
}

/// The images of a failure: the last view with what it should overlap, or the last image at all.
fn at_the_end(r: &Report<'_>) -> String {
    let mut out = String::new();
    if let Some(c) = broken_off(&r.timeline) {
        if !c.looks.is_empty() {
            let later = c.looks.iter().filter(|l| l.index > 0);
            let found = later.clone().filter(|l| l.found).count();
            let _ = writeln!(
                out,
                "<p class=\"lead\">{}: {} taken; of the {} after the first {found} {} recognised in an earlier one. Lines join places that look alike, \
                 or that agree where a view was recognised.</p>",
                escape(&c.objective.0),
                count(c.looks.len(), "view"),
                later.count(),
                if found == 1 { "was" } else { "were" },
            );
        }
        out.push_str(&chain::pictures(r, c));
    }
    for (name, words) in [
        ("sharpest", "The sharpest image of the last focus sweep."),
        ("newest", "The last image of all."),
    ] {
        if let Some(svg) = r.gallery.figure(name, words, "") {
            let _ = writeln!(
                out,
                "<div class=\"duo\"><figure class=\"one-view\">{svg}<figcaption>{words}{}</figcaption></figure></div>",
                r.gallery.brighter(&[name])
            );
        }
    }
    match out.is_empty() {
        true => "<p class=\"none\">It ended before an image was kept.</p>\n".into(),
        false => out,
    }
}

/// Each objective with its numbers, its views and what changed; and all beside each other.
fn measured(r: &Report<'_>, end: &WorkEnd) -> String {
    if r.timeline.calibrations.is_empty() {
        return "<p class=\"none\">It did not come to a calibration.</p>\n".into();
    }
    let mut out = String::from(
        "<p class=\"lead\">How a pixel of each objective relates to the stage, measured by moving the stage and watching the specimen. \
         <i>k</i> and φ read the map as in the paper's Eq. (1) and (3); η is where the stage's axis of rotation lies from the \
         image's middle. After ± one standard deviation.</p>\n",
    );
    let made = r.timeline.calibrations.iter().filter_map(|c| c.made);
    let made: Vec<_> = made.map(|m| m.0).collect();
    out.push_str(&beside_each_other(&made));
    for c in &r.timeline.calibrations {
        let _ = writeln!(
            out,
            "<article class=\"objective\"><h3>{}</h3>\n<div class=\"measured\">",
            escape(&c.objective.0)
        );
        out.push_str(&card(r, c));
        out.push_str(&chain::figure(c));
        if let Some((calibration, ..)) = c.made {
            let _ = writeln!(
                out,
                "<div class=\"changed\"><h4>Since the one before</h4>\n{}</div>",
                changes(end, calibration)
            );
        }
        out.push_str("</div>\n");
        // Those of a failure stand at the top.
        if c.made.is_some() || end.failed.is_none() {
            out.push_str(&chain::pictures(r, c));
        }
        out.push_str(&chain::table(c));
        out.push_str("</article>\n");
    }
    out
}

fn gallery(recorder: &Recorder, timeline: &Timeline<'_>, end: &WorkEnd) -> Gallery {
    let mut gallery = Gallery::default();
    for sequence in timeline.calibrations.iter().flat_map(chain::shown) {
        if let Some(jpeg) = recorder.calibration_view(sequence) {
            gallery.add(view_name(sequence), jpeg);
            gallery.scale(view_name(sequence), chain_um(timeline, sequence));
        }
    }
    // Of a focus that failed the sharpest, of another failure the last image, unless it is there already.
    let unfocused = timeline.sweeps.last().is_some_and(|s| s.result.is_none());
    let last = recorder.newest_sequence();
    let there = last.is_some_and(|s| gallery.size(&view_name(s)).is_some());
    let (name, picture) = match (&end.failed, end.work) {
        (Some(_), _) if unfocused => ("sharpest", recorder.sharpest()),
        (Some(_), _) if !there => ("newest", recorder.newest()),
        _ => return gallery,
    };
    if let Some(jpeg) = picture.and_then(|p| p.jpeg()) {
        gallery.add(name, jpeg);
        let active = timeline.active.and_then(|id| timeline.calibration(id));
        gallery.scale(name, active.map(Calibration::um_per_px));
    }
    gallery
}

/// The size of a pixel of a view of a chain, um, where that calibration or one before it tells.
fn chain_um(timeline: &Timeline<'_>, sequence: u64) -> Option<f64> {
    let has = |c: &&Calibrating<'_>| chain::shown(c).contains(&sequence);
    let of = timeline.calibrations.iter().find(has)?.objective;
    timeline.calibration(of).map(Calibration::um_per_px)
}
