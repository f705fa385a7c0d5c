//! Where the time went, and how the run was made.

use crate::model::Report;
use crate::text::{escape, fixed, prose, seconds};
use scopeservo_servo::Phase;
use std::fmt::Write as _;

const PHASES: [(Phase, &str, &str); 5] = [
    (Phase::Switch, "switch", "Change of objective"),
    (Phase::Focus, "focus", "Focus"),
    (Phase::Identify, "identify", "Look at which objective is in"),
    (Phase::Calibrate, "calibrate", "Calibration"),
    (Phase::Servo, "servo", "Servo"),
];

pub(crate) fn time(r: &Report<'_>) -> String {
    let total = r.timeline.duration_s;
    if r.timeline.spans.is_empty() || total <= 0.0 {
        return "<p class=\"none\">No part of the run took any time on the instrument's clock.</p>\n".into();
    }
    let mut out = format!(
        "<p class=\"lead\">{} on the instrument's clock",
        seconds(total)
    );
    if r.context.virtual_time {
        out.push_str(
            ", which is simulated: moves and exposures take their time there, computing takes none",
        );
    }
    if let Some(wall) = r.context.wall_time_s {
        let _ = write!(out, "; the program ran for {}", seconds(wall));
    }
    out.push_str(".</p>\n<div class=\"gantt\" role=\"img\" aria-label=\"Parts of the run over time, one line per objective\">\n");
    let legs = r.timeline.spans.last().map_or(0, |s| s.leg + 1);
    for leg in 0..legs {
        let mine = || r.timeline.spans.iter().filter(move |s| s.leg == leg);
        let Some(first) = mine().next() else {
            continue;
        };
        let sum: f64 = mine().map(|s| s.to_s - s.from_s).sum();
        let _ = write!(
            out,
            "<div class=\"leg\"><span>{}</span><div class=\"bar\">",
            escape(&first.objective.0)
        );
        for span in mine() {
            let share = |t: f64| fixed((100.0 * t / total).clamp(0.0, 100.0), 3);
            let (_, class, name) = PHASES[index(span.phase)];
            let _ = write!(
                out,
                "<b class=\"{class}\" style=\"left:{}%;width:{}%\" title=\"{name}, {}\"></b>",
                share(span.from_s),
                share(span.to_s - span.from_s),
                seconds(span.to_s - span.from_s)
            );
        }
        let _ = writeln!(out, "</div><span>{}</span></div>", seconds(sum));
    }
    out.push_str("</div>\n<ul class=\"keys\">\n");
    for (phase, class, name) in PHASES {
        let sum: f64 = r
            .timeline
            .spans
            .iter()
            .filter(|s| s.phase == phase)
            .map(|s| s.to_s - s.from_s)
            .sum();
        // Only somebody who turns a nosepiece by hand is checked, and a calibration has no servo.
        if sum == 0.0 {
            continue;
        }
        let _ = writeln!(
            out,
            "<li><b class=\"{class}\"></b>{name}: {} ({} %)</li>",
            seconds(sum),
            fixed(100.0 * sum / total, 0)
        );
    }
    out.push_str("</ul>\n");
    out
}

fn index(phase: Phase) -> usize {
    PHASES.iter().position(|p| p.0 == phase).unwrap_or(0)
}

pub(crate) fn section(r: &Report<'_>) -> String {
    let mut out = String::from("<dl class=\"made\">\n");
    let mut add = |name: &str, value: &str, code: bool| {
        if !value.is_empty() {
            let value = match code {
                true => format!("<code>{}</code>", escape(value)),
                false => prose(value),
            };
            let _ = writeln!(out, "<div><dt>{name}</dt><dd>{value}</dd></div>");
        }
    };
    let c = r.context;
    add("Date", &c.date, false);
    add("Target", &c.target, false);
    add("Specimen", &c.specimen, false);
    add("Instrument", &c.instrument, false);
    add("Stage at the end", &c.place, false);
    for kept in &c.calibrations {
        let name = format!("Calibration of {}", escape(&kept.objective));
        add(&name, &kept.file, true);
    }
    add("Command", &c.command, true);
    add(
        "Seed",
        &c.seed.map_or(String::new(), |s| s.to_string()),
        true,
    );
    add("Version", &c.version, false);
    if let Some((engine, level)) = r.timeline.engine {
        add("Features", &format!("{engine}, {level}"), false);
    }
    add("Credit", c.credit.as_deref().unwrap_or(""), false);
    out.push_str("</dl>\n");
    if r.truth.is_some() {
        out.push_str(
            "<p>This run was simulated. What is called true on this page was known to the simulation only; the program saw \
             images and stage positions, as on a real microscope.</p>\n",
        );
    }
    if r.truth.is_none() && c.simulated {
        out.push_str(
            "<p>The microscope was a simulated one: no instrument and no slide stand behind these numbers.</p>\n",
        );
    }
    out.push_str("<p>This page is complete in itself: it loads nothing and sends nothing.</p>\n");
    out
}
