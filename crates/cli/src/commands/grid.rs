//! `scopeservo grid`.

use super::known_calibrations;
use crate::answer::Answer;
use crate::args::GridArgs;
use crate::error::CliError;
use crate::open_instrument::OpenInstrument;
use crate::progress::Watcher;
use scopeservo_registration::Term;
use scopeservo_scope::{ObjectiveId, um_in_words};
use scopeservo_servo::{Compared, Comparison, GridOptions, GridReport, Known, Quantity};
use scopeservo_station::jobs::{GridJob, GridOutput};
use scopeservo_workbench::Asked;
use serde_json::json;

pub(crate) fn grid(args: &GridArgs, answer: &Answer) -> Result<bool, CliError> {
    let focus = args.focusing.options()?;
    for (flag, um, most) in [
        ("--pitch-um", args.pitch_um, 10_000.0),
        ("--reach-um", args.reach_um, 50_000.0),
    ] {
        if !(um > 0.0 && um <= most) {
            let what = format!("{flag} must be above 0 and at most {most}");
            return Err(CliError::Usage(what));
        }
    }
    let opened = OpenInstrument::open(&args.instrument, answer)?;
    opened.check_nothing_waits()?;
    let grid = GridOptions {
        pitch_um: args.pitch_um,
        reach_um: args.reach_um,
        ..GridOptions::default()
    };
    let focus = (!args.no_focus).then_some(focus);
    let objective = args.objective.clone().map(ObjectiveId);
    let known = known_calibrations(&opened, answer);
    let input = opened.usual().grid(objective, focus, grid, known);
    let asked = Asked {
        inputs: json!(input),
        ..Asked::default()
    };
    run(&opened, GridJob::new(input), asked, answer)
}

/// Runs the job, from its beginning or from where it was.
pub(super) fn run(
    opened: &OpenInstrument,
    job: GridJob,
    asked: Asked,
    answer: &Answer,
) -> Result<bool, CliError> {
    let ran = opened.run(job, asked, &mut Watcher::new(None), answer)?;
    if let Ok(output) = &ran.output {
        show(answer, output);
    }
    let output = ran.end(None, answer)?;
    Ok(output.comparison.is_none_or(|c| c.agrees))
}

fn show(answer: &Answer, GridOutput { report, comparison }: &GridOutput) {
    answer.put(json!({
        "objective": report.objective(),
        "grid": report,
        "comparison": comparison,
        "agrees": comparison.as_ref().map(|c| c.agrees),
    }));
    show_optics(answer, report);
    show_stage(answer, report);
    match comparison {
        Some(comparison) => show_comparison(answer, report, comparison),
        None => say!(
            answer,
            "{}: there is no calibration to compare with",
            report.objective()
        ),
    }
}

fn plus_minus(known: &Known, factor: f64, digits: usize) -> String {
    format!(
        "{:.digits$} +- {:.digits$}",
        factor * known.value,
        factor * known.sigma
    )
}

/// A term in percent, and whether it is there.
fn term(t: &Term) -> String {
    let known = format!("{:+.4} +- {:.4} %", 100.0 * t.value, 100.0 * t.sigma);
    match (t.seen, t.sigma > 0.0) {
        (true, _) => known,
        (false, true) => format!("{known}, not seen"),
        (false, false) => "too few cells to tell".into(),
    }
}

fn show_optics(answer: &Answer, report: &GridReport) {
    let id = report.objective();
    say!(
        answer,
        "{id} on a grid of {} um: {} cells, each seen to {:.3} px, {} left out; {} views",
        report.pitch_um,
        report.nodes,
        report.sigma_px,
        report.left_out,
        report.views
    );
    let [x, y] = &report.um_per_px;
    say!(
        answer,
        "  a pixel is {} um wide and {} um high, its sides {} deg off a right angle",
        plus_minus(x, 1.0, 6),
        plus_minus(y, 1.0, 6),
        plus_minus(&report.skew_deg, 1.0, 4)
    );
    match &report.reading {
        Some(r) => say!(
            answer,
            "  kx {}, ky {} pixels per metre, camera turned {} deg against the stage",
            plus_minus(&r.kx_px_per_m, 1.0, 0),
            plus_minus(&r.ky_px_per_m, 1.0, 0),
            plus_minus(&r.phi_deg, 1.0, 4)
        ),
        None => say!(
            answer,
            "  the image is mirrored against the stage; its x lies at {} deg in the stage's axes",
            plus_minus(&report.image_x_deg, 1.0, 4)
        ),
    }
    say!(
        answer,
        "  distortion at the corner: {}; tilt of the field, scale at the corner along x: {}, along y: {}",
        term(&report.distortion),
        term(&report.keystone[0]),
        term(&report.keystone[1])
    );
}

fn show_stage(answer: &Answer, report: &GridReport) {
    if let Some([x, y]) = &report.rotation_centre_um {
        say!(
            answer,
            "  the view lies {}, {} mm from the axis of rotation",
            plus_minus(x, 1e-3, 3),
            plus_minus(y, 1e-3, 3)
        );
    }
    let stage = &report.stage;
    let rotation = stage.rotation.as_ref();
    say!(
        answer,
        "  the stage goes {} % too far along x, {} % along y{}; its axes are {} deg off a right angle; arrivals scatter by {}",
        plus_minus(&stage.x, 100.0, 4),
        plus_minus(&stage.y, 100.0, 4),
        rotation.map_or(String::new(), |r| format!(
            ", and turns {} % too far",
            plus_minus(r, 100.0, 2)
        )),
        plus_minus(&stage.square_deg, 1.0, 4),
        um_in_words(stage.scatter_um, 2)
    );
}

fn show_comparison(answer: &Answer, report: &GridReport, comparison: &Comparison) {
    let id = report.objective();
    if !comparison.same_hand {
        say!(
            answer,
            "{id}: the calibration disagrees: it is a mirror image of what the grid shows"
        );
        return;
    }
    let wrong: Vec<&Compared> = comparison.compared.iter().filter(|c| !c.agrees).collect();
    if wrong.is_empty() {
        let worst = comparison
            .compared
            .iter()
            .map(|c| c.off_sigmas)
            .fold(0.0, f64::max);
        say!(
            answer,
            "{id}: the calibration agrees, to {worst:.1} standard deviations"
        );
        return;
    }
    let wrong: Vec<String> = wrong.into_iter().map(difference).collect();
    say!(
        answer,
        "{id}: the calibration disagrees: {}",
        wrong.join(", ")
    );
}

/// By how much, in its own unit or in percent.
fn difference(c: &Compared) -> String {
    let share = 100.0 * c.difference / c.grid.value;
    let (what, by) = match c.quantity {
        Quantity::KxPxPerM => ("kx", format!("{share:+.3} %")),
        Quantity::KyPxPerM => ("ky", format!("{share:+.3} %")),
        Quantity::XUmPerPx => ("the width of a pixel", format!("{share:+.3} %")),
        Quantity::YUmPerPx => ("the height of a pixel", format!("{share:+.3} %")),
        Quantity::PhiDeg => ("the camera's angle", format!("{:+.4} deg", c.difference)),
        Quantity::ImageXDeg => ("the direction of x", format!("{:+.4} deg", c.difference)),
        Quantity::SkewDeg => ("the skew", format!("{:+.4} deg", c.difference)),
        Quantity::CentreXUm => (
            "the axis of rotation along x",
            format!("{:+.1} um", c.difference),
        ),
        Quantity::CentreYUm => (
            "the axis of rotation along y",
            format!("{:+.1} um", c.difference),
        ),
    };
    format!("{what} by {by} ({:.1} standard deviations)", c.off_sigmas)
}
