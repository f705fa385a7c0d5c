//! The answer of a command: gathered while it works, and told whatever becomes of it.
//!
//! People read lines on stdout as they come; programs (`--json`) read one object there at the end. What went wrong without ending the
//! command is a warning: on stderr at once, and in the object. A reader who has gone changes nothing: not the work, not the exit code.

use crate::bar::beside;
use crate::error::{CliError, Code};
use serde_json::{Map, Value, json};
use std::fmt;
use std::io::{self, ErrorKind, Write};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::time::Duration;

/// Version of the keys in the object. Keys are stable: they are added to, never renamed.
pub(crate) const SCHEMA: u32 = 1;
/// Something was answered, and it is what was hoped for.
const YES: u8 = 0;
/// Not found, refused, or a check does not hold.
const NO: u8 = 3;
/// A fault, and an answer that could not be told.
const FAULT: u8 = 1;
/// So long one who leaves at once tries to say so: somebody may hang in a write that nobody reads.
const PATIENCE: Duration = Duration::from_secs(2);

/// `eprintln!` for a reader that may have gone: then nobody is left to be told.
macro_rules! tell {
    ($($arg:tt)*) => {{
        use std::io::Write as _;
        // Made before: nothing is drawn while it is written, and what draws would wait for itself.
        let line = format!($($arg)*);
        let _ = crate::bar::beside(|| writeln!(std::io::stderr(), "{line}"));
    }};
}

/// A line of the answer for people, by [`Answer::say`].
macro_rules! say {
    ($answer:expr, $($arg:tt)*) => {
        $answer.say(format_args!($($arg)*))
    };
}

/// What Ctrl-C does.
type Hook = Box<dyn FnMut() + Send>;

/// The answer that gathers. Clones share it: Ctrl-C comes on a thread of its own.
#[derive(Clone)]
pub(crate) struct Answer {
    json: bool,
    state: Arc<Mutex<State>>,
    hook: Arc<Mutex<Option<Hook>>>,
}

#[derive(Default)]
struct State {
    object: Map<String, Value>,
    warnings: Vec<Value>,
    /// Nobody reads the lines any more, or they cannot be written.
    unread: bool,
    /// The exit code, once all is told.
    ended: Option<u8>,
}

impl Answer {
    pub(crate) fn new(json: bool) -> Self {
        Self {
            json,
            state: Arc::default(),
            hook: Arc::default(),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A line for people; nothing under `--json`.
    pub(crate) fn say(&self, line: fmt::Arguments<'_>) {
        let mut state = self.state();
        if self.json || state.unread {
            return;
        }
        if let Err(error) = beside(|| print(&line.to_string())) {
            state.unread = true;
            if error.kind() != ErrorKind::BrokenPipe {
                tell!(
                    "scopeservo: warning: the answer cannot be written to stdout: {error}. The work goes on"
                );
            }
        }
    }

    /// A key of the object, or several: those of `keys`, a JSON object.
    pub(crate) fn put(&self, keys: Value) {
        if let Value::Object(keys) = keys {
            self.state().object.extend(keys);
        }
    }

    /// One more entry in the list under `key`.
    pub(crate) fn push(&self, key: &str, entry: Value) {
        let mut state = self.state();
        let list = state.object.entry(key).or_insert_with(|| json!([]));
        if let Value::Array(list) = list {
            list.push(entry);
        }
    }

    /// Something that went wrong and does not end the command.
    pub(crate) fn warn(&self, code: Code, message: impl fmt::Display) {
        let message = message.to_string();
        tell!("scopeservo: warning: {message}");
        let warning = json!({"code": code, "message": message});
        self.state().warnings.push(warning);
    }

    /// What there is; what there is not is told as a warning.
    pub(crate) fn or_warn<T>(&self, tried: Result<T, impl Into<CliError>>) -> Option<T> {
        tried
            .map_err(Into::into)
            .inspect_err(|error| self.warn(error.code(), error.words()))
            .ok()
    }

    /// The object as it stands.
    pub(crate) fn object(&self) -> Value {
        self.state().object(None)
    }

    /// The same with the error that ended the command.
    pub(crate) fn object_with(&self, error: &CliError) -> Value {
        self.state().object(Some(error))
    }

    /// Tells how the command ended, once. Returns the exit code.
    pub(crate) fn end(&self, ended: Result<bool, CliError>) -> u8 {
        let mut state = self.state();
        if let Some(code) = state.ended {
            return code;
        }
        let (mut code, error) = match ended {
            Ok(true) => (YES, None),
            Ok(false) => (NO, None),
            Err(error) => (error.code().exit(), Some(error)),
        };
        if let Some(error) = &error {
            tell!("scopeservo: {}", error.words());
        }
        if self.json
            && let Err(error) = beside(|| print(&state.object(error.as_ref()).to_string()))
            && error.kind() != ErrorKind::BrokenPipe
        {
            tell!("scopeservo: the answer could not be written to stdout: {error}");
            code = FAULT;
        }
        state.ended = Some(code);
        code
    }

    /// From now on Ctrl-C does this. Before, it ends the program: nothing moves that would have to be stopped.
    pub(crate) fn on_interrupt(&self, hook: impl FnMut() + Send + 'static) {
        *self.hook.lock().unwrap_or_else(PoisonError::into_inner) = Some(Box::new(hook));
    }

    /// Ctrl-C was pressed, or a signal asks to end.
    pub(crate) fn interrupt(&self) {
        match &mut *self.hook.lock().unwrap_or_else(PoisonError::into_inner) {
            Some(hook) => hook(),
            None => self.leave(CliError::Interrupted),
        }
    }

    /// Ends the program here and now, whatever other threads do, and says so.
    pub(crate) fn leave(&self, error: CliError) -> ! {
        let (answer, (tell, told)) = (self.clone(), mpsc::channel());
        std::thread::spawn(move || tell.send(answer.end(Err(error))));
        let code = told.recv_timeout(PATIENCE).unwrap_or(FAULT);
        std::process::exit(code.into())
    }
}

impl State {
    fn object(&self, error: Option<&CliError>) -> Value {
        let mut object = self.object.clone();
        object.insert("schema".into(), json!(SCHEMA));
        object.insert("warnings".into(), json!(self.warnings));
        if let Some(error) = error {
            let error = json!({"code": error.code(), "message": error.words()});
            object.insert("error".into(), error);
        }
        object.into()
    }
}

/// Writes a line to stdout, through every buffer.
fn print(line: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    out.write_all(format!("{line}\n").as_bytes())?;
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_reached_stands_beside_the_error() {
        let answer = Answer::new(true);
        answer.put(json!({"calibrations": []}));
        answer.push("calibrations", json!({"objective": "10x"}));
        answer.warn(Code::NotKept, "the disk is full");
        let object = answer.state().object(Some(&CliError::Interrupted));
        assert_eq!(object["schema"], 1);
        assert_eq!(object["calibrations"][0]["objective"], "10x");
        assert_eq!(object["warnings"][0]["code"], "not_kept");
        assert_eq!(object["error"]["code"], "interrupted");
        // Without an error the key is not there.
        assert!(answer.object().get("error").is_none());
    }

    #[test]
    fn the_first_end_counts() {
        let answer = Answer::new(false);
        assert_eq!(answer.end(Ok(false)), 3);
        assert_eq!(answer.clone().end(Err(CliError::Interrupted)), 3);
    }
}
