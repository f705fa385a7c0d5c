//! `run list`, `show` and `pin`: what was done, without an instrument.

use crate::answer::Answer;
use crate::args::{RunListArgs, RunPinArgs, RunShowArgs};
use crate::commands::library_of;
use crate::error::CliError;
use scopeservo_library::{LibraryError, RunQuery, RunRow, keep_new};
use serde_json::{Value, json};

/// How a run came out, in a few words.
pub(crate) fn outcome(run: &RunRow) -> String {
    let word = match (&run.verdict, &run.ended) {
        (Some(verdict), _) => verdict.replace('_', " "),
        (None, Some(_)) => "ended".into(),
        (None, None) => "not ended".into(),
    };
    match &run.message {
        Some(message) => format!("{word}: {message}"),
        None => word,
    }
}

pub(crate) fn list(args: &RunListArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    let runs = library.runs(&RunQuery {
        limit: args.limit,
        before: args.before.as_deref(),
        target: args.target.as_deref(),
    })?;
    answer.put(json!({"runs": runs}));
    if runs.is_empty() {
        say!(answer, "no run is kept");
    }
    for run in &runs {
        let about = run
            .target
            .as_ref()
            .map_or(String::new(), |name| format!(" of {name}"));
        let pinned = if run.pinned { ", pinned" } else { "" };
        say!(answer, "{}{about}{pinned}", run.id);
        say!(answer, "    {}", outcome(run));
    }
    Ok(true)
}

pub(crate) fn show(args: &RunShowArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    let run = library.run(&args.id)?;
    let (inputs, said) = library.run_said(&args.id)?;
    answer.put(json!(run));
    answer.put(json!({"inputs": inputs, "answer": said}));
    say!(answer, "{}", run.id);
    say!(
        answer,
        "  {} on {}, begun {}",
        run.job.replace('_', " "),
        run.instrument,
        run.began
    );
    for (what, value) in [
        ("target", &run.target),
        ("slide", &run.slide),
        ("by", &run.user),
    ] {
        if let Some(value) = value {
            say!(answer, "  {what:10} {value}");
        }
    }
    say!(answer, "  {}", outcome(&run));
    if let Some(file) = &args.report {
        let from = library.run_file(&args.id, "report.html")?;
        let from = from.ok_or_else(|| {
            CliError::Usage(format!(
                "the run '{}' has no report, or it had to make room",
                args.id
            ))
        })?;
        let page = scopeservo_files::read(&from, u64::MAX).map_err(|e| LibraryError::Read {
            path: from.clone(),
            what: e.to_string(),
        })?;
        keep_new(file, &page)?;
        say!(answer, "  its report is in {}", file.display());
    }
    if args.events {
        let events = library.run_events(&args.id)?;
        let value = |line: &String| serde_json::from_str::<Value>(line).unwrap_or_default();
        answer.put(json!({"events": events.iter().map(value).collect::<Vec<_>>()}));
        for event in &events {
            say!(answer, "{event}");
        }
    }
    Ok(true)
}

pub(crate) fn pin(args: &RunPinArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    library.pin_run(&args.id, !args.off)?;
    answer.put(json!({"id": args.id, "pinned": !args.off}));
    match args.off {
        false => say!(
            answer,
            "the report of {} stays, whatever room it takes",
            args.id
        ),
        true => say!(
            answer,
            "the report of {} goes when it is among the oldest and room is needed",
            args.id
        ),
    }
    Ok(true)
}
