//! The program `scopeservo`.
//!
//! Exit codes: 0 arrived or found, 3 not found or refused, 2 bad input or usage, 1 fault or interruption. With `--json`
//! the answer is one JSON object on stdout and everything else goes to stderr.

#![expect(
    clippy::print_stderr,
    reason = "a program says on stderr what went wrong"
)]

/// `println!` for a reader that may have gone: a closed pipe ends the program quietly, as `| head` expects.
macro_rules! say {
    ($($arg:tt)*) => {{
        use std::io::Write as _;
        if let Err(error) = writeln!(std::io::stdout(), $($arg)*)
            && error.kind() == std::io::ErrorKind::BrokenPipe
        {
            std::process::exit(0);
        }
    }};
}

mod args;
mod bench;
mod demo;
mod desk;
mod doctor;
mod driver_check;
mod error;
mod init;
mod output;
mod progress;
mod register;
mod scene;
mod stage;
mod store;
mod threads;
mod trial;
mod twin_serve;
mod views;
mod work;

use args::{Cli, Command, DriverCommand, StageCommand, TargetCommand, TwinCommand};
use clap::Parser;
use error::CliError;
use std::process::ExitCode;

/// Something was answered, and it is what was hoped for.
const YES: u8 = 0;
/// Not found, or refused.
const NO: u8 = 3;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let answer = match cli.command {
        Command::Demo(args) => demo::run(&args),
        Command::Register(args) => register::run(&args),
        Command::Init(args) => init::run(&args),
        Command::Doctor(args) => doctor::run(&args),
        Command::Calibrate(args) => work::calibrate(&args),
        Command::Focus(args) => work::focus(&args),
        Command::Stage(StageCommand::Go(args)) => stage::go(&args),
        Command::Target(TargetCommand::Save(args)) => work::save_target(&args),
        Command::Target(TargetCommand::List(args)) => work::list_targets(&args),
        Command::Reposition(args) => work::reposition(&args),
        Command::Driver(DriverCommand::Check(args)) => driver_check::run(&args),
        Command::Twin(TwinCommand::Serve(args)) => twin_serve::run(&args),
    };
    match answer {
        Ok(true) => ExitCode::from(YES),
        Ok(false) => ExitCode::from(NO),
        Err(error) => {
            eprintln!("scopeservo: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}
