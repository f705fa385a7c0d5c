//! The program `scopeservo`.
//!
//! Exit codes: 0 arrived or found, 3 not found or refused, 2 bad input or usage, 1 fault or interruption. With `--json` the answer is
//! one JSON object on stdout, however the command ends, and everything else goes to stderr.

#![warn(clippy::too_many_lines)]

#[macro_use]
mod answer;
mod args;
mod asking;
mod bar;
mod beginning;
mod bench;
mod calibrations;
mod colour;
mod commands;
mod console;
mod demo;
mod doctor;
mod driver_check;
mod error;
mod hands;
mod images;
mod init;
mod interview;
mod library;
mod manual;
mod nearby;
mod open_instrument;
mod output;
mod patient_clock;
mod progress;
mod register;
mod runs;
mod scene;
#[cfg(feature = "serve")]
mod serve;
mod served;
mod stage;
mod targets;
mod threads;
mod twin_serve;
mod views;

use answer::Answer;
use args::{
    Cli, Command, DriverCommand, LibraryCommand, RunCommand, StageCommand, TargetCommand,
    TwinCommand,
};
use clap::Parser;
use error::CliError;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) if error.use_stderr() => {
            let (error, json) = args::misused(&error);
            return Answer::new(json).end(Err(error)).into();
        }
        // Help or the version, which were asked for. Who does not read them does not need them.
        Err(error) => {
            let _ = error.print();
            return ExitCode::SUCCESS;
        }
    };
    let answer = Answer::new(cli.command.wants_json());
    // A mistake of the program's own is an ending too.
    let ended = catch_unwind(AssertUnwindSafe(|| run(cli.command, &answer)));
    let mistake =
        || CliError::Internal("the program made a mistake, named above; please report it".into());
    answer.end(ended.unwrap_or_else(|_| Err(mistake()))).into()
}

/// Whether it answered, and what was hoped for.
fn run(command: Command, answer: &Answer) -> Result<bool, CliError> {
    if !command.takes_threads() {
        threads::take_threads(None)?;
    }
    let signalled = answer.clone();
    ctrlc::set_handler(move || signalled.interrupt())
        .map_err(|e| CliError::Internal(format!("Ctrl-C could not be provided for: {e}")))?;
    if let Some(done) = served::run(&command, answer) {
        return done;
    }
    match command {
        Command::Demo(args) => demo::run(&args, answer),
        Command::Register(args) => register::run(&args, answer),
        Command::Init(args) => init::run(&args, answer),
        Command::Status(args) => hands::status(&args, answer),
        Command::Snap(args) => hands::snap(&args, answer),
        Command::Objective(args) => hands::objective(&args, answer),
        Command::Completions(args) => manual::completions(&args, answer),
        Command::Man(args) => manual::pages(&args, answer),
        Command::Doctor(args) => doctor::run(&args, answer),
        Command::Calibrate(args) => commands::calibrate(&args, answer),
        Command::Focus(args) => commands::focus(&args, answer),
        Command::Grid(args) => commands::grid(&args, answer),
        Command::Level(args) => commands::level(&args, answer),
        Command::Check(args) => commands::check(&args, answer),
        Command::Calibrations(args) => calibrations::run(&args, answer),
        Command::Stage(StageCommand::Go(args)) => stage::go(&args, answer),
        Command::Target(TargetCommand::Save(args)) => commands::save_target(&args, answer),
        Command::Target(TargetCommand::List(args)) => targets::list_targets(&args, answer),
        Command::Target(TargetCommand::Show(args)) => targets::show_target(&args, answer),
        Command::Target(TargetCommand::Rename(args)) => targets::rename_target(&args, answer),
        Command::Target(TargetCommand::Remove(args)) => targets::remove_targets(&args, answer),
        Command::Target(TargetCommand::Note(args)) => targets::note_target(&args, answer),
        Command::Target(TargetCommand::Restore(args)) => targets::restore_target(&args, answer),
        Command::Target(TargetCommand::Purge(args)) => targets::purge_targets(&args, answer),
        Command::Run(RunCommand::List(args)) => runs::list(&args, answer),
        Command::Run(RunCommand::Show(args)) => runs::show(&args, answer),
        Command::Run(RunCommand::Pin(args)) => runs::pin(&args, answer),
        Command::Library(LibraryCommand::Check(args)) => library::check(&args, answer),
        Command::Library(LibraryCommand::Backup(args)) => library::back_up(&args, answer),
        Command::Library(LibraryCommand::Restore(args)) => library::restore(&args, answer),
        Command::Library(LibraryCommand::Export(args)) => library::export(&args, answer),
        Command::Library(LibraryCommand::Rebuild(args)) => library::rebuild(&args, answer),
        Command::Target(TargetCommand::Export(args)) => targets::export_target(&args, answer),
        Command::Target(TargetCommand::Import(args)) => targets::import_target(&args, answer),
        Command::Reposition(args) => commands::reposition(&args, answer),
        #[cfg(feature = "serve")]
        Command::Serve(args) => serve::run(&args, answer),
        Command::Resume(args) => commands::resume(&args, answer),
        Command::Abandon(args) => commands::abandon(&args, answer),
        Command::Driver(DriverCommand::Check(args)) => driver_check::run(&args, answer),
        Command::Twin(TwinCommand::Serve(args)) => twin_serve::run(&args),
    }
}
