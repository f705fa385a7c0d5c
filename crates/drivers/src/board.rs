//! Meeting a board that may only just be starting, as most do when somebody connects: a session with it once it has said so.

use crate::link::Transport;
use crate::session::{Exchange, Session, StopBytes};
use scopeservo_scope::ScopeError;
use std::time::{Duration, Instant};

/// How a board is met.
pub(crate) struct Board {
    /// How it is told to stop. It answers to that, in its turn.
    pub(crate) stop: &'static [u8],
    pub(crate) max_line_bytes: usize,
    pub(crate) reply_timeout_ms: u64,
    /// How long its start may take. One that ran already says nothing for so long.
    pub(crate) boot_ms: u64,
    /// For how long it says nothing more once it has started; not waited for where that is nothing.
    pub(crate) quiet: Duration,
}

impl Board {
    /// Opens the session and passes over what the board says while it starts; `is_start` knows the line that tells of it.
    ///
    /// # Errors
    /// Those of the link.
    pub(crate) fn open(
        self,
        transport: Box<dyn Transport>,
        is_start: impl Fn(&str) -> bool,
    ) -> Result<Session, ScopeError> {
        let ms = Duration::from_millis;
        let stop = StopBytes {
            bytes: self.stop,
            answered: true,
        };
        let timeout = ms(self.reply_timeout_ms);
        let session = Session::new(transport, stop, self.max_line_bytes, timeout).passing_noise();
        let give_up = Instant::now() + ms(self.boot_ms);
        wait_for_start(&mut session.exchange()?, give_up, self.quiet, is_start)?;
        Ok(session)
    }
}

fn wait_for_start(
    ex: &mut Exchange<'_>,
    give_up: Instant,
    quiet: Duration,
    is_start: impl Fn(&str) -> bool,
) -> Result<(), ScopeError> {
    let mut started = false;
    while Instant::now() < give_up && !(started && quiet.is_zero()) {
        let deadline = match started {
            true => give_up.min(Instant::now() + quiet),
            false => give_up,
        };
        match ex.line_if_any(deadline)? {
            Some(line) => started |= is_start(&line),
            None if started => return Ok(()),
            None => {}
        }
    }
    Ok(())
}
