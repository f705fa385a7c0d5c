//! One check, and how it is run.

use crate::{Instrument, ScopeError};

/// The result of one check.
#[derive(Debug, Clone, PartialEq)]
pub struct Check {
    /// What was checked.
    pub name: &'static str,
    /// `Ok`, or what did not hold.
    pub outcome: Result<(), String>,
}

pub(super) fn run(name: &'static str, check: impl FnOnce() -> Result<(), String>) -> Check {
    Check {
        name,
        outcome: check(),
    }
}

pub(super) fn said(error: ScopeError) -> String {
    error.to_string()
}

pub(super) fn ensure(holds: bool, sentence: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(sentence()) }
}

/// Runs a check that moves the stage; whatever comes of it, the stage is stopped and brought back.
pub(super) fn run_and_return(
    scope: &Instrument,
    name: &'static str,
    check: impl FnOnce() -> Result<(), String>,
) -> Check {
    let home = scope.gate().position();
    let outcome = check();
    let back = || -> Result<(), ScopeError> {
        scope.gate().stop()?;
        // What was told to stop may take a moment to stand.
        scope.stand_still()?;
        scope.move_to(&home?)?;
        Ok(())
    };
    let outcome = match (outcome, back()) {
        (Ok(()), Err(error)) => Err(format!("the stage did not come back: {error}")),
        (outcome, _) => outcome,
    };
    Check { name, outcome }
}
