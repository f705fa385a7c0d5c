//! The starts as a page with plots, and as numbers for elsewhere.

use crate::start::Record;
use crate::table::{HEAD, rows};
use scopeservo_studies::page::{Page, Plot, around, wilson_95};
use std::fmt::Write as _;

/// Start by start.
pub(crate) fn csv(records: &[Record]) -> String {
    let mut out = String::from(
        "index,specimen,objective,noise,play_um,start_um,answer,end_um,depth_um,claimed_sigma_um,frames,moves,seconds,again_um,again_frames\n",
    );
    let or_empty = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
    for r in records {
        let _ = writeln!(
            out,
            "{},\"{}\",{},{},{},{},{},{},{},{},{},{},{},{},{}",
            r.index,
            r.specimen,
            r.objective,
            r.noise,
            r.play_um,
            r.start_um,
            r.answer,
            r.end_um,
            r.depth_um,
            or_empty(r.claimed_sigma_um),
            r.frames,
            r.moves,
            r.seconds,
            or_empty(r.again.map(|a| a.0)),
            or_empty(r.again.map(|a| a.1 as f64)),
        );
    }
    out
}

/// The page.
pub(crate) fn page(records: &[Record]) -> String {
    let mut page = Page::new("Focus from random starts");
    page.text(
        "Starts lie within 200 µm of the focus, on the twin's three objectives, with specimens of weak and strong stain, shot noise of 0.25 to 1 % of full \
         scale at mid grey and up to 8 µm of backlash in z. The error is the twin's truth, which the program never sees. A focus is right within a quarter \
         of the depth of field. Again: a second focus from some depths off, when the first is known.",
    );
    page.table(&HEAD, &rows(records));
    for objective in ["10x", "20x", "40x"] {
        let of: Vec<&Record> = records
            .iter()
            .filter(|r| r.objective == objective)
            .collect();
        if of.is_empty() {
            continue;
        }
        page.heading(objective);
        page.plots(vec![errors(&of), by_noise(&of), frames(&of), claimed(&of)]);
    }
    page.finish()
}

/// The error against where it began.
fn errors(of: &[&Record]) -> (Plot, String) {
    let depth = of[0].depth_um;
    let mut plot = Plot::new(
        [-205.0, 205.0],
        [-1.0, 1.0],
        "start, µm from the focus (positive: too close)",
        "error, depths of field",
    );
    plot.band([-205.0, 205.0], [-0.25, 0.25]);
    for r in of {
        let error = match r.answer == "focused" {
            true => r.end_um / r.depth_um,
            false => 1.0,
        };
        plot.dot(r.start_um, error, r.is_right());
    }
    let words = format!(
        "Error at the end, by where it began; the band is a quarter of the depth of field ({depth:.1} µm). What found no focus is at the top."
    );
    (plot, words)
}

/// The share that is right, by the camera's noise.
fn by_noise(of: &[&Record]) -> (Plot, String) {
    let mut plot = Plot::new([0.2, 1.05], [80.0, 100.5], "shot noise, %", "right, %");
    for step in 0..4 {
        let (from, to) = (0.25 + 0.1875 * step as f64, 0.4375 + 0.1875 * step as f64);
        let within = |r: &&&Record| (from..=to).contains(&(100.0 * r.noise));
        let all: Vec<_> = of.iter().filter(within).collect();
        let right = all.iter().filter(|r| r.is_right()).count();
        if !all.is_empty() {
            let x = 0.5 * (from + to);
            let share = 100.0 * right as f64 / all.len() as f64;
            plot.upright(
                x,
                wilson_95(right, all.len()).map(|v| 100.0 * v),
                share >= 99.0,
            );
            plot.dot(x, share, share >= 99.0);
        }
    }
    let words = "Share that is right, by noise, with its 95 % interval.";
    (plot, words.into())
}

/// Frames against the way to the focus.
fn frames(of: &[&Record]) -> (Plot, String) {
    let most = of.iter().map(|r| r.frames).max().unwrap_or(1) as f64;
    let mut plot = Plot::new(
        [0.0, 205.0],
        [0.0, 1.05 * most],
        "start, µm from the focus, either side",
        "frames",
    );
    for r in of {
        plot.dot(r.start_um.abs(), r.frames as f64, r.is_right());
    }
    (plot, "Frames that a focus took.".into())
}

/// The error over the deviation that was stated.
fn claimed(of: &[&Record]) -> (Plot, String) {
    let known: Vec<(f64, f64)> = of
        .iter()
        .filter(|r| r.answer == "focused")
        .filter_map(|r| Some((r.claimed_sigma_um?, r.end_um)))
        .collect();
    let most = known.iter().map(|k| k.0).fold(1e-3, f64::max);
    let mut plot = Plot::new(
        [0.0, 1.05 * most],
        around(known.iter().map(|k| k.1), 2.0 * most),
        "stated standard deviation, µm",
        "error, µm",
    );
    for (sigma, off) in &known {
        plot.dot(*sigma, *off, off.abs() <= 2.0 * sigma);
    }
    let within = known.iter().filter(|(s, off)| off.abs() <= 2.0 * s).count();
    let words = format!(
        "Error against what was stated: {:.0} % within two standard deviations (95 % is right).",
        100.0 * within as f64 / known.len().max(1) as f64
    );
    (plot, words)
}
