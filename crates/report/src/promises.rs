//! Moves by the camera: how far beside its expected place each of them ended, in standard deviations of what was expected.

use crate::svg::{Attr, Canvas, Mark, Scale, WIDTH, equal_panel};
use crate::text::{deg, um};
use crate::told::Magnification;
use scopeservo_servo::{PoseError, Promised};
use std::fmt::Write as _;

/// Rings are drawn at these; a move is contradicted beyond the last, a pixel of the view granted.
const RINGS: [f64; 3] = [1.0, 2.0, 4.0];
/// The figure reaches so far; what lies beyond is drawn at its edge.
const REACH: f64 = 5.0;
/// More moves than this are not told one by one.
const TOLD: usize = 4;

/// The figure and its words; `None` where no move was made, or none told what it was to do.
pub(crate) fn figure(m: &Magnification<'_>) -> Option<(String, String)> {
    let mut points: Vec<[f64; 2]> = Vec::new();
    let mut told: Vec<String> = Vec::new();
    let mut before = None;
    for i in &m.iterations {
        let off_m = |p: &Promised| [0, 1].map(|k| i.error.t_m[k] - p.error.t_m[k]);
        let shown = |p: &&Promised| p.sigma_m > 0.0 && off_m(p).iter().all(|v| v.is_finite());
        if let Some(promised) = i.promised.filter(shown) {
            let off_m = off_m(promised);
            points.push(off_m.map(|v| v / promised.sigma_m));
            told.push(words(
                i.iteration,
                before,
                promised,
                off_m,
                i.error.theta_rad,
            ));
        }
        before = Some(i.error);
    }
    if points.is_empty() {
        return None;
    }
    let (kept, beyond): (Vec<_>, Vec<_>) = points
        .iter()
        .partition(|p| f64::hypot(p[0], p[1]) <= RINGS[2]);
    let reach = Scale::exact(-REACH, REACH);
    let p = equal_panel(reach, reach, WIDTH - 52.0, 188.0);
    let label = format!(
        "{} of {} moves ended within 4 standard deviations of where they were to end, at {}",
        kept.len(),
        points.len(),
        m.objective
    );
    let mut c = Canvas::new(272.0, &label);
    p.axes(&mut c, "standard deviations, x", "y");
    let ([x, y], [edge, _]) = (p.at(0.0, 0.0), p.at(1.0, 0.0));
    for ring in RINGS {
        c.raw(&format!(
            "<circle class=\"ring ideal\" cx=\"{}\" cy=\"{}\" r=\"{}\"/>",
            Attr(x),
            Attr(y),
            Attr(ring * (edge - x))
        ));
    }
    p.marks(&mut c, "ink", Mark::Dot, &kept);
    let beyond = beyond.iter().map(|q| {
        let by = REACH / f64::hypot(q[0], q[1]).max(REACH);
        q.map(|v| v * by)
    });
    p.marks(&mut c, "theta", Mark::Triangle, &beyond.collect::<Vec<_>>());
    let mut caption = String::from(
        "Where moves ended, from where they were to end; rings at 1, 2 and 4 standard deviations of what was expected (stage, calibration and \
         measurement together).",
    );
    for text in told.iter().take(TOLD) {
        caption.push_str(text);
    }
    if told.len() > TOLD {
        let _ = write!(caption, " And {} more.", told.len() - TOLD);
    }
    Some((c.finish(), caption))
}

/// One move in a sentence.
fn words(
    iteration: usize,
    before: Option<&PoseError>,
    promised: &Promised,
    off_m: [f64; 2],
    seen_rad: f64,
) -> String {
    let long = before.map_or("The move that led here".into(), |before| {
        let way_m = [0, 1].map(|k| before.t_m[k] - promised.error.t_m[k]);
        let turn_deg = (before.theta_rad - promised.error.theta_rad).to_degrees();
        format!(
            "Move {iteration}, {} and {} long,",
            um(1e6 * f64::hypot(way_m[0], way_m[1])),
            deg(turn_deg.abs())
        )
    });
    format!(
        " {long} ended {} and {} beside (expected within {} and {}).",
        um(1e6 * f64::hypot(off_m[0], off_m[1])),
        deg((seen_rad - promised.error.theta_rad).to_degrees().abs()),
        um(1e6 * promised.sigma_m),
        deg(promised.sigma_rad.to_degrees())
    )
}
