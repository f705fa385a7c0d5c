//! Runs in which one thing of the instrument is broken. The twin's truth judges, which the run never sees.

mod any_time;
mod kinds;
mod page;
mod random;
mod run;

use crate::many::{EACH, Many, is_named};
use crate::scene::Known;
use crate::whole::Saves;
use clap::ValueEnum;
use run::Record;
use scopeservo_studies::rounds::{Outcome, rounds};
use std::fs;

/// When something breaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum When {
    /// At the start, or when the target was seen first, as each kind says.
    Fixed,
    /// At a moment drawn over the whole run: during focus, change of the objective, step or evidence.
    Random,
    /// The same in the last eighth of it, where a run makes sure.
    Late,
}

/// Makes the runs, their table and their page; returns how many ended as none may.
pub(crate) fn study(
    many: &Many<'_>,
    (when, named): (When, &[String]),
    known: &[Known],
) -> Outcome<usize> {
    match when {
        When::Fixed => {}
        When::Random => return random::study(many, ("random", 1.0), named, known),
        When::Late => return random::study(many, ("late", 0.125), named, known),
    }
    let kinds = kinds::all();
    let of = |index: u64| &kinds[(index / EACH) as usize];
    let saves = Saves::default();
    let one =
        |index: u64, trace: bool| run::run(of(index), index, (index % EACH, &saves), known, trace);
    if let Some(index) = many.only {
        println!("{}", serde_json::to_string_pretty(&one(index, true)?)?);
        return Ok(0);
    }
    let asked = kinds
        .iter()
        .enumerate()
        .filter(|(_, k)| is_named(k.name, named));
    let numbers = many.numbers(asked.map(|(k, _)| k));
    let path = many.out.join("faults.jsonl");
    let records = rounds(
        &path,
        &numbers,
        many.threads,
        |r: &Record| r.index,
        |k| one(k, false),
    )?;
    let wrong = page::print(&kinds, &records);
    fs::write(many.out.join("faults.html"), page::page(&kinds, &records))?;
    Ok(wrong)
}
