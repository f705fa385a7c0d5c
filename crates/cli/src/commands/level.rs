//! `scopeservo level`.

use super::known_calibrations;
use super::report::{failure, work_page};
use crate::answer::Answer;
use crate::args::LevelArgs;
use crate::error::CliError;
use crate::open_instrument::OpenInstrument;
use crate::progress::Watcher;
use scopeservo_report::{Work, WorkEnd};
use scopeservo_scope::{ObjectiveId, PositiveZ, um_in_words};
use scopeservo_servo::{Known, LevelOptions, LevelReport, Levelled, Tilt, TiltReport};
use scopeservo_station::jobs::{LevelJob, LevelOutput};
use scopeservo_workbench::Asked;
use serde_json::json;
use std::time::Instant;

pub(crate) fn level(args: &LevelArgs, answer: &Answer) -> Result<bool, CliError> {
    let focus = args.focusing.options()?;
    if !(args.lever_mm >= 10.0 && args.lever_mm <= 1000.0) {
        let what = "--lever-mm must be at least 10 and at most 1000".into();
        return Err(CliError::Usage(what));
    }
    let opened = OpenInstrument::open(&args.instrument, answer)?;
    opened.check_nothing_waits()?;
    let level = LevelOptions {
        apply: args.apply,
        focus,
        lever_mm: args.lever_mm,
        ..LevelOptions::default()
    };
    let objective = args.objective.clone().map(ObjectiveId);
    let known = known_calibrations(&opened, answer);
    let input = opened.usual().level(objective, args.no_focus, level, known);
    let asked = Asked {
        inputs: json!(input),
        ..Asked::default()
    };
    run(&opened, LevelJob::new(input), asked, answer)
}

/// Runs the job, from its beginning or from where it was.
pub(super) fn run(
    opened: &OpenInstrument,
    job: LevelJob,
    asked: Asked,
    answer: &Answer,
) -> Result<bool, CliError> {
    let wanted = asked.inputs["level"]["apply"] == true;
    let mut watcher = Watcher::new(None);
    let started = Instant::now();
    let ran = opened.run(job, asked, &mut watcher, answer)?;
    if let Ok(output) = &ran.output {
        show(answer, output, wanted);
    }
    let end = WorkEnd {
        work: Work::Level,
        failed: failure(&ran.output),
        before: Vec::new(),
    };
    let page = work_page(opened, &watcher, &end, started);
    let LevelOutput { report } = ran.end(Some(&page), answer)?;
    Ok(match in_the_end(&report).is_level() {
        // It was not seen.
        None => false,
        Some(is_level) => is_level || !wanted || report.levelled.is_some_and(|l| l.level),
    })
}

fn in_the_end(report: &LevelReport) -> &TiltReport {
    let after = report.levelled.as_ref().map(|l| &l.after);
    after.unwrap_or(&report.before)
}

fn show(answer: &Answer, LevelOutput { report }: &LevelOutput, wanted: bool) {
    let left = in_the_end(report);
    let hand = by_hand(left).filter(|_| report.levelled.is_none());
    answer.put(json!({
        "objective": report.before.objective,
        "seen": report.before,
        "level": left.is_level(),
        "levelled": report.levelled,
        "by_hand": hand,
    }));
    show_tilt(answer, &report.before, "");
    if let Some(levelled) = &report.levelled {
        show_levelled(answer, levelled);
    } else if let (true, Some(hand)) = (left.is_level() == Some(false), hand) {
        let can = match (report.can_tip, wanted) {
            (false, _) => "this stage has no axis that tips; ",
            (true, _) => "--apply levels it, or ",
        };
        say!(answer, "  {can}{hand}");
    }
}

fn plus_minus(known: &Known, digits: usize) -> String {
    format!("{:+.digits$} +- {:.digits$}", known.value, known.sigma)
}

fn show_tilt(answer: &Answer, report: &TiltReport, then: &str) {
    let id = &report.objective;
    let Some(tilt) = &report.tilt else {
        say!(
            answer,
            "{id}{then}: the data show no tilt: {} of {} parts of the view have a focus of their own. Go to a place with tissue all over",
            report.heights.len(),
            report.blocks
        );
        return;
    };
    let [x, y] = &tilt.slope_um_per_mm;
    let verdict = match (tilt.shown, report.is_level()) {
        (false, _) => "no tilt that the data show",
        (true, Some(true)) => "level within a quarter of the depth of field",
        _ => "tilted",
    };
    say!(
        answer,
        "{id}{then}: {verdict}; the focus rises by {} um per mm to the right and {} downwards in the image, {:.3} +- {:.3} deg at the steepest",
        plus_minus(x, 2),
        plus_minus(y, 2),
        tilt.angle_deg.value,
        tilt.angle_deg.sigma
    );
    if let Some(stage) = &tilt.stage {
        let [x, y] = &stage.slope_um_per_mm;
        say!(
            answer,
            "  along the stage's x by {} um per mm, along y by {}: {} deg about x, {} deg about y",
            plus_minus(x, 2),
            plus_minus(y, 2),
            plus_minus(&stage.about_x_deg, 3),
            plus_minus(&stage.about_y_deg, 3)
        );
    }
    say!(
        answer,
        "  a corner is {:.2} +- {:.2} um out of focus when the middle is sharp; the depth of field is {:.2} um",
        tilt.corner_um.value,
        tilt.corner_um.sigma,
        report.depth_of_field_um
    );
    say!(
        answer,
        "  seen in {} of {} parts of the view, which lie {} about the plane ({:.0} % of their heights explained, {} images)",
        tilt.used,
        report.blocks,
        um_in_words(tilt.scatter_um, 2),
        100.0 * tilt.goodness.max(0.0),
        report.frames
    );
}

fn show_levelled(answer: &Answer, levelled: &Levelled) {
    show_tilt(answer, &levelled.after, " after levelling");
    let axes = ["rx", "ry"].into_iter();
    let turned: Vec<String> = axes
        .zip(levelled.turned_deg)
        .filter_map(|(axis, deg)| Some(format!("{axis} by {:+.4} deg", deg?)))
        .collect();
    say!(
        answer,
        "  turned {} in {} corrections{}",
        turned.join(", "),
        levelled.rounds,
        match levelled.level {
            true => "",
            false => "; what is left is half of the tilt or less",
        }
    );
}

/// Which side of the slide to lift, by how much.
fn by_hand(report: &TiltReport) -> Option<String> {
    let tilt: &Tilt = report.tilt.as_ref().filter(|t| t.shown)?;
    // Where z must be larger to have it in focus, it lies farther away where positive z brings the two closer.
    let sign = match report.positive_z {
        PositiveZ::Closer => 1.0,
        PositiveZ::Apart => -1.0,
    };
    let farther = tilt.slope_um_per_mm.map(|k| sign * k.value);
    let way = |value: f64, ways: [&str; 2]| ways[usize::from(value < 0.0)].to_owned();
    let mut sides = Vec::new();
    for (k, ways) in [(0, ["right", "left"]), (1, ["lower", "upper"])] {
        let sigma = tilt.slope_um_per_mm[k].sigma;
        if farther[k].abs() > 2.0 * sigma {
            let side = way(farther[k], ways);
            sides.push(format!(
                "by {:.1} um per mm on its {side} side",
                farther[k].abs()
            ));
        }
    }
    (!sides.is_empty()).then(|| {
        format!(
            "by hand: bring the slide nearer to the objective, as the image shows it, {}",
            sides.join(" and ")
        )
    })
}
