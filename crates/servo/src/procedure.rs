//! Step machines: the common shape of everything that takes time.

use crate::{ErrorKind, ServoError, Sink};
use scopeservo_scope::Instrument;

/// What a step achieved.
#[derive(Debug, Clone, PartialEq)]
pub enum Progress<T> {
    /// There is more to do.
    Continue,
    /// Finished, with the result.
    Done(T),
}

/// A procedure whose state is a plain value. Between two steps it can be serialised, stored, and continued by another
/// process on the same instrument.
pub trait Procedure {
    /// What it ends with.
    type Output;
    /// Does the next small piece of work: at most a few moves and frames.
    ///
    /// # Errors
    /// Instrument faults and interruptions. What the method itself can answer ("not found") is an output, not an error.
    fn step(
        &mut self,
        scope: &Instrument,
        sink: &mut dyn Sink,
    ) -> Result<Progress<Self::Output>, ServoError>;
}

/// What the images have not shown leaves a stage that can go home; a stop or a fault leaves it where it is. What fails on the way is told
/// instead.
pub(crate) fn home_after_an_answer<T>(
    ended: Result<T, ServoError>,
    go_home: impl FnOnce() -> Result<(), ServoError>,
) -> Result<T, ServoError> {
    match ended {
        Err(error) if error.kind() == ErrorKind::Answer => go_home().and(Err(error)),
        ended => ended,
    }
}

/// What a procedure that looks for the focus, or for what needs one, leaves when it fails: a stage that does not stand nearer to the
/// specimen than the command found it. After a stop that somebody asked for nothing moves.
pub(crate) fn withdrawn<T>(
    scope: &Instrument,
    ended: Result<T, ServoError>,
) -> Result<T, ServoError> {
    let Err(error) = ended else { return ended };
    let stopped = error.kind() == ErrorKind::Interruption;
    match stopped || matches!(error, ServoError::StaysNear { .. }) {
        true => Err(error),
        false => match scope.withdraw() {
            Ok(()) => Err(error),
            Err(why) if why.kind() == scopeservo_scope::ErrorKind::Interrupted => Err(why.into()),
            // The same trouble as before is told once.
            Err(why) if matches!(&error, ServoError::Scope(e) if *e == why) => Err(error),
            Err(why) => Err(ServoError::StaysNear {
                error: Box::new(error),
                why,
            }),
        },
    }
}

/// Steps until done.
///
/// # Errors
/// Those of the steps.
pub fn run<P: Procedure>(
    procedure: &mut P,
    scope: &Instrument,
    sink: &mut dyn Sink,
) -> Result<P::Output, ServoError> {
    loop {
        if let Progress::Done(output) = procedure.step(scope, sink)? {
            return Ok(output);
        }
    }
}
