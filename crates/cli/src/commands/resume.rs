//! `scopeservo resume` and `scopeservo abandon`: what becomes of a job whose program was killed.

use super::{calibrate, check, focus, grid, level, reposition, save_target};
use crate::answer::Answer;
use crate::args::{AbandonArgs, ResumeArgs};
use crate::commands::library_of;
use crate::error::{CliError, Code};
use crate::open_instrument::OpenInstrument;
use crate::views::try_out;
use scopeservo_library::{Database, Journal as _, LibraryError, Targets as _};
use scopeservo_setup::{Config, Held};
use scopeservo_station::jobs::AnyJob;
use scopeservo_workbench::{self as workbench, Asked};
use serde_json::json;

pub(crate) fn resume(args: &ResumeArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.instrument.description, answer)?;
    let config = Config::read(&args.instrument.description.config)?;
    if library.journal(&config.name)?.is_none() {
        return Err(CliError::Usage(
            "no job was under way when a program ended: there is nothing to go on with".into(),
        ));
    }
    try_out(&args.report.out)?;
    let opened = OpenInstrument::open(&args.instrument, answer)?;
    let Some(left) = opened.left()? else {
        return Err(CliError::Usage("another program went on with it".into()));
    };
    let cannot = |why: String| {
        CliError::CannotResume(format!("{} cannot go on: {why}", workbench::what(&left)))
    };
    if let Some(why) = workbench::contradiction(&left, &opened.scope) {
        return Err(cannot(why));
    }
    say!(
        answer,
        "going on: {}",
        workbench::standing(&left, &opened.scope)
    );
    let asked = Asked {
        inputs: left.head.inputs.clone(),
        target: left.head.target.clone(),
        resumed: true,
    };
    let state = left.step.as_ref().map(|step| step.state.clone());
    let Some(state) = state else {
        return Err(cannot("it had not begun. Give its command again".into()));
    };
    let name = left.head.inputs["name"].as_str().unwrap_or_default();
    let stored = AnyJob::stored(&left.head.job, state.to_string().as_bytes());
    let mut job = stored.map_err(|e| cannot(e.to_string()))?;
    if let Some(id) = job.target_id() {
        let kept = library.target(name)?;
        if kept.id != id {
            return Err(cannot(
                "its target is not the one that it was begun with".into(),
            ));
        }
        job = job.with_target(kept.target);
    }
    match job {
        AnyJob::Focus(job) => focus::run(&opened, *job, asked, answer),
        AnyJob::Calibrate(job) => calibrate::run(&opened, *job, asked, &args.report.out, answer),
        AnyJob::Grid(job) => grid::run(&opened, *job, asked, answer),
        AnyJob::Level(job) => level::run(&opened, *job, asked, answer),
        AnyJob::Check(job) => check::run(&opened, *job, asked, false, answer),
        AnyJob::SaveTarget(job) => match library.target(name) {
            Ok(kept) if opened.was_kept_by(&kept, &job) => {
                save_target::was_kept(&opened, name, answer)
            }
            Ok(_) => Err(cannot(format!(
                "another target is called '{name}' now. Rename that one first, or abandon it"
            ))),
            Err(_) => save_target::run(&opened, name, *job, asked, answer),
        },
        AnyJob::Reposition(job) => {
            reposition::run(&opened, name, *job, asked, &args.report.out, answer)
        }
        AnyJob::Identify(_) | AnyJob::Doctor(_) => {
            Err(cannot("no command of this program does that".into()))
        }
    }
}

pub(crate) fn abandon(args: &AbandonArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.kept.description, answer)?;
    let config = Config::read(&args.kept.description.config)?;
    // One that is at work is no business of ours.
    let _held = Held::data(&config)?;
    let left = match library.journal(&config.name) {
        Ok(left) => left,
        Err(damaged) => return set_aside(&library, &config.name, damaged, answer),
    };
    library.end_journal(&config.name)?;
    let what = left.as_ref().map(workbench::what);
    answer.put(json!({"abandoned": what}));
    match what {
        Some(what) => say!(
            answer,
            "{what} is ended. The stage stands where it was left"
        ),
        None => say!(answer, "no job was under way"),
    }
    Ok(true)
}

/// Nobody can go on with a journal that cannot be read, and whoever wants to know what it was has it still.
fn set_aside(
    library: &Database,
    instrument: &str,
    damaged: LibraryError,
    answer: &Answer,
) -> Result<bool, CliError> {
    answer.warn(Code::Damaged, damaged);
    let aside = library.set_journal_aside(instrument)?;
    let path = aside.as_ref().map(|path| path.to_string_lossy());
    answer.put(json!({"abandoned": null, "set_aside": path}));
    say!(
        answer,
        "put aside as {}: nothing waits any longer. The stage stands where it was left",
        path.unwrap_or_default()
    );
    Ok(true)
}
