//! One open connection: whole questions and answers, one at a time; a stop that waits for neither; and the end of it all
//! when an answer cannot be trusted.

use crate::link::{LineReader, LinkError, Transport, past_noise, shown};
use scopeservo_scope::{ScopeError, visible};
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// A fault of the stage in its own words.
pub(crate) fn device(detail: impl Into<String>) -> ScopeError {
    ScopeError::Device {
        device: "stage",
        detail: detail.into(),
    }
}

/// A command that the stage will not carry out, in its words: nothing moved.
pub(crate) fn refused(detail: impl Into<String>) -> ScopeError {
    ScopeError::Refused {
        device: "stage",
        detail: detail.into(),
    }
}

/// A setting that makes no sense.
pub(crate) fn bad_setting(what: impl Into<String>) -> ScopeError {
    ScopeError::BadSetting { what: what.into() }
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(crate) struct Session {
    transport: Box<dyn Transport>,
    /// Held while bytes are written: how many answers to stops nobody has waited for yet.
    writing: Mutex<u32>,
    /// Held for a whole exchange.
    reader: Mutex<LineReader>,
    /// Why the link was closed.
    closed: Mutex<Option<String>>,
    /// How many stops were asked for.
    stops: AtomicU64,
    stop: StopBytes,
    /// What is written after the stop when the link is closed.
    at_close: Mutex<Vec<u8>>,
    reply_timeout: Duration,
    /// Whether noise around a line is passed over.
    noisy: bool,
    /// What came since something was sent and was no answer.
    unread: Mutex<Unread>,
}

/// How a device is told to stop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct StopBytes {
    pub(crate) bytes: &'static [u8],
    /// Whether it answers, in its turn.
    pub(crate) answered: bool,
}

impl Session {
    pub(crate) fn new(
        transport: Box<dyn Transport>,
        stop: StopBytes,
        max_line_bytes: usize,
        reply_timeout: Duration,
    ) -> Self {
        Self {
            transport,
            writing: Mutex::new(0),
            reader: Mutex::new(LineReader::new(max_line_bytes)),
            closed: Mutex::new(None),
            stops: AtomicU64::new(0),
            stop,
            at_close: Mutex::default(),
            reply_timeout,
            noisy: false,
            unread: Mutex::default(),
        }
    }

    /// The same with a board on a wire that is not free of noise ([`past_noise`]).
    pub(crate) fn passing_noise(self) -> Self {
        Self {
            noisy: true,
            ..self
        }
    }

    /// How many stops were asked for so far. Read before a move is prepared.
    pub(crate) fn stops(&self) -> u64 {
        self.stops.load(Ordering::SeqCst)
    }

    /// Waits for the exchange under way, if there is one, and begins another.
    pub(crate) fn exchange(&self) -> Result<Exchange<'_>, ScopeError> {
        let reader = lock(&self.reader);
        self.check_open()?;
        Ok(Exchange {
            session: self,
            reader,
            owed: 0,
        })
    }

    /// Sends the stop bytes at once, whatever else goes on.
    pub(crate) fn send_stop(&self) -> Result<(), ScopeError> {
        // Counted first: a move that is being prepared sees it or is sent before the stop.
        self.stops.fetch_add(1, Ordering::SeqCst);
        self.check_open()?;
        let written = {
            let mut writing = lock(&self.writing);
            *writing += u32::from(self.stop.answered);
            self.transport.write(self.stop.bytes)
        };
        written.map_err(|e| self.fail(&e))
    }

    fn check_open(&self) -> Result<(), ScopeError> {
        match &*lock(&self.closed) {
            None => Ok(()),
            Some(why) => Err(device(format!(
                "the connection was closed because {why}; see that the stage stands still, then connect again"
            ))),
        }
    }

    /// Tells the device to stop, closes the link and says why.
    fn fail(&self, error: &LinkError) -> ScopeError {
        let unread = lock(&self.unread).shown();
        let why = match (error, &unread) {
            (LinkError::Silence, Some(lines)) => format!("{error}, only {lines}"),
            _ => error.to_string(),
        };
        self.close(&why);
        match (error, unread) {
            (LinkError::Silence, None) => ScopeError::Timeout {
                device: "stage",
                seconds: self.reply_timeout.as_secs_f64(),
            },
            _ => device(why),
        }
    }

    fn close(&self, why: &str) {
        let mut closed = lock(&self.closed);
        if closed.is_none() {
            *closed = Some(why.to_string());
            let _writing = lock(&self.writing);
            // A device whose answers nobody can read must not go on moving; it may be past hearing.
            let _ = self.transport.write(self.stop.bytes);
            let last = lock(&self.at_close);
            if !last.is_empty() {
                let _ = self.transport.write(&last);
            }
            self.transport.close();
        }
    }

    /// At the end of the driver: a stage that nobody watches is told to stop, and so is one that has something left to be told.
    pub(crate) fn abandon(&self, moving: bool) {
        if moving || !lock(&self.at_close).is_empty() {
            self.close("the driver ended");
        } else {
            self.transport.close();
        }
    }
}

/// Lines that were no answers, as they are shown: the last few.
#[derive(Default)]
struct Unread(VecDeque<String>);

impl Unread {
    const MOST: usize = 3;

    fn line(&mut self, line: &str) {
        self.keep(format!("'{}'", visible(line)));
    }

    fn noise(&mut self, line: &[u8]) {
        self.keep(format!("what is not text, '{}'", visible(&shown(line))));
    }

    fn keep(&mut self, shown: String) {
        self.0.push_back(shown);
        if self.0.len() > Self::MOST {
            self.0.pop_front();
        }
    }

    fn shown(&self) -> Option<String> {
        let all: Vec<&str> = self.0.iter().map(String::as_str).collect();
        (!all.is_empty()).then(|| all.join(", "))
    }
}

/// The right to send and to wait for the answer.
pub(crate) struct Exchange<'a> {
    session: &'a Session,
    reader: MutexGuard<'a, LineReader>,
    /// How many answers to stops come before the answer to what was sent last.
    owed: u32,
}

impl Exchange<'_> {
    pub(crate) fn deadline(&self) -> Instant {
        Instant::now() + self.session.reply_timeout
    }

    /// How many answers to stops come before the next answer, each told once.
    pub(crate) fn take_owed(&mut self) -> u32 {
        std::mem::take(&mut self.owed)
    }

    /// The same when nothing was sent: for the one who asked for the stop.
    pub(crate) fn take_owed_now(&mut self) -> u32 {
        let mut writing = lock(&self.session.writing);
        std::mem::take(&mut self.owed) + std::mem::take(&mut *writing)
    }

    /// Sends bytes.
    pub(crate) fn send(&mut self, bytes: &[u8]) -> Result<(), ScopeError> {
        self.send_if(bytes, None)
    }

    /// Sends bytes that start a move, but not when a stop was asked for since `stops` was read.
    pub(crate) fn send_unless_stopped(
        &mut self,
        bytes: &[u8],
        stops: u64,
    ) -> Result<(), ScopeError> {
        self.send_if(bytes, Some(stops))
    }

    fn send_if(&mut self, bytes: &[u8], stops: Option<u64>) -> Result<(), ScopeError> {
        let written = {
            let mut writing = lock(&self.session.writing);
            if stops.is_some_and(|s| s != self.session.stops()) {
                return Err(ScopeError::Interrupted { at: None });
            }
            self.owed += std::mem::take(&mut *writing);
            lock(&self.session.unread).0.clear();
            self.session.transport.write(bytes)
        };
        written.map_err(|e| self.session.fail(&e))
    }

    /// What the device is told, after the stop, if the link is closed from now on: what it must not keep of ours.
    pub(crate) fn at_close(&self, bytes: &[u8]) {
        *lock(&self.session.at_close) = bytes.to_vec();
    }

    pub(crate) fn line_bytes(&mut self, deadline: Instant) -> Result<Vec<u8>, ScopeError> {
        self.reader
            .bytes(&*self.session.transport, deadline)
            .map_err(|e| self.session.fail(&e))
    }

    pub(crate) fn line(&mut self, deadline: Instant) -> Result<String, ScopeError> {
        self.text(deadline).map_err(|e| self.session.fail(&e))
    }

    /// A line if one comes until `deadline`; what came of the next one is kept.
    pub(crate) fn line_if_any(&mut self, deadline: Instant) -> Result<Option<String>, ScopeError> {
        match self.text(deadline) {
            Ok(line) => Ok(Some(line)),
            Err(LinkError::Silence | LinkError::HalfLine { .. }) => Ok(None),
            Err(e) => Err(self.session.fail(&e)),
        }
    }

    fn text(&mut self, deadline: Instant) -> Result<String, LinkError> {
        let transport = &*self.session.transport;
        if !self.session.noisy {
            return self.reader.text(transport, deadline);
        }
        loop {
            let line = self.reader.bytes(transport, deadline)?;
            match past_noise(&line) {
                Some(line) => return Ok(line),
                None if line.is_empty() => return Ok(String::new()),
                None => lock(&self.session.unread).noise(&line),
            }
        }
    }

    /// Keeps a line that is no answer, to be shown if no answer comes.
    pub(crate) fn pass_over(&self, line: &str) {
        if !line.is_empty() {
            lock(&self.session.unread).line(line);
        }
    }

    /// What [`Exchange::pass_over`] has kept since something was sent, for the end of a sentence.
    pub(crate) fn passed_over(&self) -> String {
        match lock(&self.session.unread).shown() {
            Some(lines) => format!("; what came is {lines}"),
            None => String::new(),
        }
    }

    /// An answer that did not come in the time that it may take.
    pub(crate) fn overdue(&self) -> ScopeError {
        self.session.fail(&LinkError::Silence)
    }

    /// Whether bytes have come that neither an answer nor a stop accounts for.
    pub(crate) fn has_stray(&self) -> bool {
        let writing = lock(&self.session.writing);
        self.reader.has_more() && self.owed == 0 && *writing == 0
    }

    /// Whether bytes have come that no answer accounts for.
    pub(crate) fn has_more(&self) -> bool {
        self.reader.has_more()
    }

    /// An answer that makes no sense: from here on nobody knows which answer belongs to what.
    pub(crate) fn nonsense(&self, what: impl std::fmt::Display) -> ScopeError {
        let why = format!("an answer could not be understood: {what}");
        self.session.close(&why);
        device(why)
    }
}
