//! `scopeservo check`.

use super::known_calibrations;
use crate::answer::Answer;
use crate::args::CheckArgs;
use crate::colour::{self, Hope};
use crate::error::CliError;
use crate::open_instrument::OpenInstrument;
use crate::output::{change_in_words, changes_in_words};
use crate::progress::Watcher;
use scopeservo_scope::{ObjectiveId, um_in_words};
use scopeservo_servo::{Broken, Changing, SelfTestReport, SelfTestVerdict, Together};
use scopeservo_station::jobs::{CheckJob, CheckOutput, Checked};
use scopeservo_workbench::Asked;
use serde_json::{Value, json};

pub(crate) fn check(args: &CheckArgs, answer: &Answer) -> Result<bool, CliError> {
    let focus = args.focusing.options()?;
    let opened = OpenInstrument::open(&args.instrument, answer)?;
    opened.check_nothing_waits()?;
    let named: Vec<ObjectiveId> = args.objective.iter().cloned().map(ObjectiveId).collect();
    let wanted = |id: &ObjectiveId| named.is_empty() || named.contains(id);
    let mut is_damaged = false;
    for objective in opened.scope.gate().objectives() {
        let kept = opened.calibration_of(objective);
        if kept.is_err() && wanted(&objective.id) {
            // One that was asked for by its name is the answer; else it does not keep the others away, and all are not good.
            if named.contains(&objective.id) {
                kept?;
            }
            is_damaged = true;
        }
    }
    let mut calibrations = known_calibrations(&opened, answer);
    for id in &named {
        opened.scope.objective(id)?;
        if calibrations.iter().all(|c| c.objective != *id) {
            let what =
                format!("no calibration of {id} is kept: `scopeservo calibrate --objective {id}`");
            return Err(CliError::Usage(what));
        }
    }
    calibrations.retain(|c| wanted(&c.objective));
    if calibrations.is_empty() {
        let what = "no calibration of this instrument and camera is kept: `scopeservo calibrate`";
        return Err(CliError::Usage(what.into()));
    }
    let focus = (!args.no_focus).then_some(focus);
    let input = opened.usual().check(calibrations, focus);
    let asked = Asked {
        inputs: json!(input),
        ..Asked::default()
    };
    run(&opened, CheckJob::new(input), asked, is_damaged, answer)
}

/// Runs the job, from its beginning or from where it was. Where a calibration is damaged not all are good.
pub(super) fn run(
    opened: &OpenInstrument,
    job: CheckJob,
    asked: Asked,
    is_damaged: bool,
    answer: &Answer,
) -> Result<bool, CliError> {
    let ran = opened.run(job, asked, &mut Watcher::new(None), answer)?;
    let is_good = |output: &CheckOutput| output.all_good() && !is_damaged;
    if let Ok(output) = &ran.output {
        show(answer, output, is_good(output));
    }
    Ok(is_good(&ran.end(None, answer)?))
}

fn show(answer: &Answer, output: &CheckOutput, is_good: bool) {
    let all: Vec<Value> = output.checked.iter().map(entry).collect();
    answer.put(json!({
        "checked": all,
        "together": output.together,
        "ok": is_good,
    }));
    for checked in &output.checked {
        match checked {
            Checked::Told(report) => show_one(answer, report),
            Checked::Unclear {
                objective, message, ..
            } => say!(answer, "{objective}: not told: {message}"),
        }
    }
    if let Some(words) = together(output) {
        say!(answer, "{words}");
    }
}

/// The keys of one objective.
fn entry(checked: &Checked) -> Value {
    match checked {
        Checked::Told(report) => json!(report),
        Checked::Unclear {
            objective,
            code,
            message,
        } => json!({
            "objective": objective,
            "verdict": "unclear",
            "code": code,
            "message": message,
        }),
    }
}

fn show_one(answer: &Answer, report: &SelfTestReport) {
    let (verdict, hope) = match report.verdict {
        SelfTestVerdict::Good => ("good", Hope::Held),
        SelfTestVerdict::Drifted => ("drifted, calibrate soon", Hope::Partly),
        SelfTestVerdict::Replace => ("replace, calibrate", Hope::Failed),
    };
    let verdict = colour::verdict(verdict, hope);
    // What it would miss by counts only where it was seen for sure.
    let off_um = match report.verdict {
        SelfTestVerdict::Good => report.expected_error_um,
        _ => report.expected_error_um.hypot(report.misses_um),
    };
    say!(
        answer,
        "{}: {verdict}: {}; one move is expected to end {} off",
        report.objective,
        changed(report),
        um_in_words(off_um, 2)
    );
}

fn changed(report: &SelfTestReport) -> String {
    match report.broken {
        Some(Broken::OtherHand) => {
            "the image is mirrored against the stage otherwise than it says".into()
        }
        Some(Broken::CentreLost) => {
            "the view was lost however little the stage turned: the axis of rotation lies elsewhere, or the rotation does not do what it says"
                .into()
        }
        None => changes_in_words(&report.changes),
    }
}

/// Which objective disagrees, and what to do.
fn together(output: &CheckOutput) -> Option<String> {
    let of = |id: &ObjectiveId| {
        let all = output.checked.iter().filter_map(|c| match c {
            Checked::Told(report) => Some(&**report),
            Checked::Unclear { .. } => None,
        });
        let mut those = all.filter(|report| report.objective == *id);
        those
            .next()
            .map_or(String::new(), |report| match report.broken {
                Some(_) => changed(report),
                None => {
                    let sure: Vec<String> =
                        report.sure_changes().iter().map(change_in_words).collect();
                    sure.join(", ")
                }
            })
    };
    Some(match &output.together {
        Together::None => return None,
        Together::Alone { objective } => format!(
            "{objective} alone disagrees: {}. `scopeservo calibrate --objective {objective}`",
            of(objective)
        ),
        Together::Alike { what } => {
            let why = match what.as_slice() {
                [Changing::AngleDeg] => "the camera was turned",
                [Changing::ScalePercent] => "the camera was binned or changed, or the stage's unit",
                _ => "the camera was turned and binned or changed, or the stage's unit changed",
            };
            format!("all are off by the same: {why}. `scopeservo calibrate`")
        }
        Together::Some { objectives } => {
            let each: Vec<String> = objectives
                .iter()
                .map(|id| {
                    format!(
                        "{id} disagrees: {}. `scopeservo calibrate --objective {id}`",
                        of(id)
                    )
                })
                .collect();
            each.join("\n")
        }
    })
}
