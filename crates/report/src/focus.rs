//! The focus sweeps.

use crate::model::Report;
use crate::svg::{Attr, Canvas, Mark, Panel, Scale};
use crate::text::{count, escape, fixed};
use crate::told::Sweep;
use scopeservo_servo::{FocusSweep, SweepEnd};
use std::fmt::Write as _;

pub(crate) fn section(r: &Report<'_>) -> String {
    let swept: Vec<_> = r
        .timeline
        .sweeps
        .iter()
        .filter(|s| !s.samples.is_empty())
        .collect();
    if swept.is_empty() {
        return "<p class=\"none\">No focus sweep was made: the run did not come to it, or the stage has no height to change.</p>\n"
            .into();
    }
    let mut out = String::from(
        "<p class=\"lead\">Sharpness (size of fine detail over the mean brightness, the noise taken off) at every focus position that was tried; the \
         ring is where the focus was taken.</p>\n<div class=\"plots\">\n",
    );
    for sweep in swept {
        out.push_str(&figure(sweep));
    }
    out.push_str("</div>\n");
    out
}

fn figure(sweep: &Sweep<'_>) -> String {
    let objective = sweep.objective.map_or("", |o| &o.0);
    let mut c = Canvas::new(
        220.0,
        &format!("Sharpness against focus position at {objective}"),
    );
    // In thousandths: short labels.
    let mut points: Vec<_> = sweep.samples.iter().map(|s| [s[0], s[1] * 1e3]).collect();
    // A search goes to and fro: the curve is told by position.
    points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let p = Panel::wide(
        24.0,
        156.0,
        Scale::linear(points.iter().map(|s| s[0])),
        Scale::linear(points.iter().map(|s| s[1]).chain([0.0])),
    );
    p.axes(&mut c, "focus position z, µm", "sharpness × 1000");
    p.line(&mut c, "faint", &points);
    p.marks(&mut c, "focus", Mark::Dot, &points);
    let caption = match sweep.result {
        Some(f) => {
            if let Some(z) = f.z_um {
                let [x, y] = p.at(z, f.sharpness * 1e3);
                let _ = write!(
                    ChosenAt(&mut c),
                    "<path class=\"line ideal\" d=\"M{0} {1}V{2}\"/>",
                    Attr(x),
                    Attr(p.top),
                    Attr(p.top + p.height)
                );
                c.mark("ink", Mark::Ring, x, y);
            }
            format!(
                "focus at {}{}; sharpness varies by a factor of {} over {}.",
                f.z_um.map_or("–".into(), |z| format!("{} µm", fixed(z, 2))),
                f.sigma_um
                    .map_or(String::new(), |s| format!(" (±{})", fixed(s, 2))),
                fixed(f.contrast, 2),
                count(f.samples, "frame")
            )
        }
        None => format!("no peak in {}, so no focus.", count(points.len(), "frame")),
    };
    format!(
        "<figure>{}<figcaption><b>{}</b>: {caption}{}</figcaption></figure>\n",
        c.finish(),
        escape(objective),
        sweep.in_motion.map_or(String::new(), in_motion)
    )
}

/// The coarse scan in motion, and why it was none.
fn in_motion(sweep: &FocusSweep) -> String {
    let why = match sweep.end {
        SweepEnd::Found => "",
        SweepEnd::NoFaster => {
            return " A coarse scan in motion would have saved no time: it was made at rest."
                .into();
        }
        SweepEnd::Refused => {
            return " The stage does not move as slowly as it is told: the coarse scan was made at rest."
                .into();
        }
        SweepEnd::Unknown => "; the heights of too few are known, so it was made again at rest",
        SweepEnd::NoPeak => "; no peak was seen, so it was made again at rest",
    };
    format!(
        " Coarse scan in motion at {} µm/s: {}, of which {} count{why}.",
        fixed(sweep.um_per_s, 0),
        count(sweep.frames, "frame"),
        sweep.counted
    )
}

/// Lets `write!` reach a canvas.
struct ChosenAt<'a>(&'a mut Canvas);

impl std::fmt::Write for ChosenAt<'_> {
    fn write_str(&mut self, s: &str) -> std::fmt::Result {
        self.0.raw(s);
        Ok(())
    }
}
