//! The rounds as a page: every number of every round against the truth, in its standard deviations.

use crate::record::Record;
use std::fmt::Write as _;

const NAMES: [&str; 6] = ["map 11", "map 12", "map 21", "map 22", "eta 1", "eta 2"];
const WIDTH: f64 = 720.0;
const ROW: f64 = 46.0;
const LEFT: f64 = 90.0;
/// Standard deviations to either side.
const REACH: f64 = 4.5;

/// A page of its own, without scripts.
pub(crate) fn page(title: &str, records: &[Record]) -> String {
    let made: Vec<&Record> = records.iter().filter(|r| r.refused.is_none()).collect();
    let mut out = format!(
        "<!doctype html><meta charset=utf-8><meta name=viewport content=\"width=device-width\"><title>Calibration: {title}</title>\
         <style>body{{font:16px/1.5 system-ui,sans-serif;max-width:46rem;margin:2rem auto;padding:0 1rem}}svg{{width:100%;height:auto}}\
         text{{font:12px system-ui}}</style><h1>Calibration: {title}</h1><p>{} rounds, {} calibrated. Each dot is a number of one round less the \
         truth, in the standard deviations that the calibration states. Of true ones 95 % lie within the band.</p>",
        records.len(),
        made.len()
    );
    let mut objectives: Vec<&str> = made.iter().map(|r| r.objective.as_str()).collect();
    objectives.sort_unstable();
    objectives.dedup();
    for objective in objectives {
        let of: Vec<&&Record> = made.iter().filter(|r| r.objective == objective).collect();
        let _ = write!(out, "<h2>{objective}</h2>{}", dots(&of));
    }
    out
}

fn dots(records: &[&&Record]) -> String {
    let x = |pull: f64| {
        LEFT + (pull.clamp(-REACH, REACH) + REACH) / (2.0 * REACH) * (WIDTH - LEFT - 10.0)
    };
    let height = ROW * NAMES.len() as f64 + 24.0;
    let mut out = format!(
        "<svg viewBox=\"0 0 {WIDTH} {height}\" role=img aria-label=\"errors in standard deviations\"><rect x={:.1} y=0 width={:.1} height={:.1} fill=\"#e8f1ea\"/>",
        x(-1.96),
        x(1.96) - x(-1.96),
        height - 24.0
    );
    for sigma in -4..=4 {
        let at = x(f64::from(sigma));
        let _ = write!(
            out,
            "<line x1={at:.1} x2={at:.1} y1=0 y2={:.1} stroke=\"#ccc\"/><text x={at:.1} y={:.1} text-anchor=middle>{sigma}</text>",
            height - 24.0,
            height - 6.0
        );
    }
    for (k, name) in NAMES.iter().enumerate() {
        let middle = ROW * (k as f64 + 0.5);
        let _ = write!(out, "<text x=4 y={:.1}>{name}</text>", middle + 4.0);
        for r in records {
            let Some(pull) = r.pulls().get(k).copied() else {
                continue;
            };
            // Spread by the round, so that dots do not hide each other.
            let y = middle + ((r.index * 7 % 19) as f64 - 9.0) * ROW / 26.0;
            let colour = if pull.abs() < 1.96 {
                "#2a6b45"
            } else {
                "#b3361e"
            };
            let _ = write!(
                out,
                "<circle cx={:.1} cy={y:.1} r=2.4 fill=\"{colour}\" fill-opacity=.7 />",
                x(pull)
            );
        }
    }
    out.push_str("</svg>");
    out
}
