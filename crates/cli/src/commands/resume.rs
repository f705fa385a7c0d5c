//! `scopeservo resume` and `scopeservo abandon`: what becomes of a job whose program was killed.

use super::{calibrate, focus, reposition, save_target};
use crate::answer::Answer;
use crate::args::{AbandonArgs, ResumeArgs};
use crate::commands::library_of;
use crate::desk::Desk;
use crate::error::CliError;
use crate::journal::{self, Asked};
use crate::views::try_out;
use scopeservo_library::{Journal as _, Targets as _};
use scopeservo_setup::Config;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

pub(crate) fn resume(args: &ResumeArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.instrument.description)?;
    let config = Config::read(&args.instrument.description.config)?;
    if library.journal(&config.name)?.is_none() {
        return Err(CliError::Usage(
            "no job was under way when a program ended: there is nothing to go on with".into(),
        ));
    }
    try_out(&args.out)?;
    let desk = Desk::open(&args.instrument, answer)?;
    let Some(left) = desk.left()? else {
        return Err(CliError::Usage("another program went on with it".into()));
    };
    let cannot = |why: String| {
        CliError::CannotResume(format!("{} cannot go on: {why}", journal::what(&left)))
    };
    if let Some(why) = journal::contradiction(&left, &desk.scope) {
        return Err(cannot(why));
    }
    say!(
        answer,
        "going on: {}",
        journal::standing(&left, &desk.scope)
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
    let name = || {
        left.head.inputs["name"]
            .as_str()
            .unwrap_or_default()
            .to_owned()
    };
    match left.head.job.as_str() {
        "focus" => focus::run(&desk, read(state).map_err(cannot)?, asked, answer),
        "calibrate" => calibrate::run(&desk, read(state).map_err(cannot)?, asked, answer),
        "save_target" => {
            save_target::run(&desk, &name(), read(state).map_err(cannot)?, asked, answer)
        }
        "reposition" => {
            let job: scopeservo_station::jobs::RepositionJob = read(state).map_err(cannot)?;
            let kept = library.target(&name())?;
            if kept.id != job.target_id() {
                return Err(cannot(
                    "its target is not the one that it was begun with".into(),
                ));
            }
            let job = job.with_target(kept.target);
            reposition::run(&desk, &name(), job, asked, &args.out, answer)
        }
        other => Err(cannot(format!("this version knows no {other}"))),
    }
}

fn read<T: DeserializeOwned>(state: Value) -> Result<T, String> {
    serde_json::from_value(state).map_err(|e| format!("its state cannot be read: {e}"))
}

pub(crate) fn abandon(args: &AbandonArgs, answer: &Answer) -> Result<bool, CliError> {
    let library = library_of(&args.description)?;
    let config = Config::read(&args.description.config)?;
    // One that cannot be read is ended as well.
    let left = answer.or_warn(library.journal(&config.name)).flatten();
    library.end_journal(&config.name)?;
    let what = left.as_ref().map(journal::what);
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
