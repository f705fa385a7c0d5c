//! `scopeservo focus`.

use super::report::{failure, work_page};
use crate::answer::Answer;
use crate::args::FocusArgs;
use crate::error::CliError;
use crate::open_instrument::OpenInstrument;
use crate::progress::Watcher;
use scopeservo_report::{Work, WorkEnd};
use scopeservo_scope::ObjectiveId;
use scopeservo_station::jobs::{FocusJob, FocusOutput};
use scopeservo_workbench::Asked;
use serde_json::json;
use std::time::Instant;

pub(crate) fn focus(args: &FocusArgs, answer: &Answer) -> Result<bool, CliError> {
    let focus = args.focusing.options()?;
    if args.near_z_um.is_some_and(|z| !z.is_finite()) {
        return Err(CliError::Usage("--near-z-um must be a number".into()));
    }
    let opened = OpenInstrument::open(&args.instrument, answer)?;
    opened.check_nothing_waits()?;
    let objective = args.objective.clone().map(ObjectiveId);
    let input = opened.usual().focus(objective, args.near_z_um, focus);
    let asked = Asked {
        inputs: json!(input),
        ..Asked::default()
    };
    run(&opened, FocusJob::new(input), asked, answer)
}

/// Runs the job, from its beginning or from where it was.
pub(super) fn run(
    opened: &OpenInstrument,
    job: FocusJob,
    asked: Asked,
    answer: &Answer,
) -> Result<bool, CliError> {
    let mut watcher = Watcher::new(None);
    let started = Instant::now();
    let ran = opened.run(job, asked, &mut watcher, answer)?;
    if let Ok(output) = &ran.output {
        show(answer, output);
    }
    let end = WorkEnd {
        work: Work::Focus,
        failed: failure(&ran.output),
        before: Vec::new(),
    };
    let page = work_page(opened, &watcher, &end, started);
    ran.end(Some(&page), answer).map(|_| true)
}

fn show(answer: &Answer, FocusOutput { objective, result }: &FocusOutput) {
    answer.put(json!({
        "objective": objective,
        "z_um": result.z_um,
        "sigma_um": result.sigma_um,
        "sharpness": result.sharpness,
        "contrast": result.contrast,
        "samples": result.samples,
    }));
    match result.z_um {
        Some(z) => say!(
            answer,
            "{objective} is in focus at z = {z:.2} um{} (sharpness {:.4}, {:.1} times the least seen, {} images)",
            result
                .sigma_um
                .map_or(String::new(), |sigma| format!(" +-{sigma:.2}")),
            result.sharpness,
            result.contrast,
            result.samples
        ),
        None => say!(
            answer,
            "{objective}: this stage has no z axis; focus by hand"
        ),
    }
}
