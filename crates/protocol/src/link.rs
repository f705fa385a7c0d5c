//! The connection to a driver: numbered requests, replies in any order, time-outs, and the end of it.

use crate::child;
use crate::message::{Call, Code, Request};
use crate::visible::make_visible;
use crate::wire::{self, Object};
use scopeservo_scope::ScopeError;
use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::process::Child;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How long a driver that another program started may take for its answer to `bye`.
const FAREWELL: Duration = Duration::from_secs(2);

/// A reply that came.
pub(crate) struct Reply {
    pub(crate) object: Object,
    pub(crate) bytes: Vec<u8>,
    /// When its line had been read.
    pub(crate) at: Instant,
}

/// What went wrong with one request.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum CallError {
    /// The driver refused.
    Said {
        code: Code,
        message: String,
        nonce: Option<String>,
    },
    /// There is no connection any more.
    Lost(String),
}

struct Waiting {
    /// Bytes that the reply may announce.
    bytes: usize,
    answer: SyncSender<Result<Reply, String>>,
}

struct State {
    waiting: HashMap<u64, Waiting>,
    /// Why there is no connection any more.
    lost: Option<String>,
}

/// What the connection is made of.
enum End {
    Child(Child),
    Tcp(TcpStream),
}

struct Shared {
    state: Mutex<State>,
    /// `None` once closed, which the driver sees as the end of its input.
    out: Mutex<Option<Box<dyn Write + Send>>>,
    end: Mutex<Option<End>>,
    next: AtomicU64,
    /// Told when the driver says nothing any more.
    silent: Mutex<Option<Receiver<()>>>,
    /// Waits for the driver's end, and ends it when that does not come.
    reaper: Mutex<Option<std::thread::JoinHandle<()>>>,
}

/// How long a reply is waited for.
pub(crate) struct Wait<'a> {
    /// After this, and each time that so much has passed again, it is asked whether the driver is there.
    pub(crate) late: Duration,
    /// After this it is given up.
    pub(crate) at_most: Duration,
    /// Asks something else that it must answer.
    pub(crate) is_there: &'a dyn Fn(),
    /// What it left unanswered before, for people.
    pub(crate) before: &'static str,
}

impl Wait<'_> {
    pub(crate) fn within(time: Duration) -> Self {
        Self {
            late: time,
            at_most: time,
            is_there: &|| (),
            before: "",
        }
    }
}

/// A connection to a driver. Cheap to clone; dropping the last one says goodbye.
#[derive(Clone)]
pub(crate) struct Link {
    shared: Arc<Shared>,
    /// Counts the clones outside of the reading thread.
    _goodbye: Arc<Goodbye>,
}

struct Goodbye(Arc<Shared>);

impl Drop for Goodbye {
    fn drop(&mut self) {
        self.0.close("it was closed");
        // Our own end must not come before: a driver that hangs would be left with the device.
        let reaper = lock(&self.0.reaper).take();
        if let Some(reaper) = reaper {
            let _ = reaper.join();
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // No panic leaves these half written.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Link {
    pub(crate) fn child(mut child: Child) -> std::io::Result<Self> {
        let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(std::io::Error::other(
                "the driver's streams are not connected",
            ));
        };
        Ok(Self::start(
            Box::new(output),
            Box::new(input),
            End::Child(child),
        ))
    }

    pub(crate) fn tcp(stream: TcpStream) -> std::io::Result<Self> {
        stream.set_nodelay(true)?;
        // A peer that reads nothing must not keep a writer for ever.
        stream.set_write_timeout(Some(Duration::from_secs(2)))?;
        let (input, output) = (stream.try_clone()?, stream.try_clone()?);
        Ok(Self::start(
            Box::new(output),
            Box::new(input),
            End::Tcp(stream),
        ))
    }

    fn start(from: Box<dyn Read + Send>, to: Box<dyn Write + Send>, end: End) -> Self {
        let (fall_silent, silent) = sync_channel(1);
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                waiting: HashMap::new(),
                lost: None,
            }),
            out: Mutex::new(Some(to)),
            end: Mutex::new(Some(end)),
            next: AtomicU64::new(1),
            silent: Mutex::new(Some(silent)),
            reaper: Mutex::new(None),
        });
        let reading = shared.clone();
        std::thread::spawn(move || {
            let stream = &mut BufReader::new(from);
            let reason = reading.read(stream);
            reading.close(&reason);
            // What it still says is for nobody, but it must be able to say it: the answer to `bye`, a frame.
            let _ = std::io::copy(stream, &mut std::io::sink());
            let _ = fall_silent.send(());
        });
        Self {
            _goodbye: Arc::new(Goodbye(shared.clone())),
            shared,
        }
    }

    /// Asks, and waits for the reply for as long as the page says.
    ///
    /// A driver that does not answer in time is stopped and disconnected.
    pub(crate) fn ask(&self, call: Call, within: Duration) -> Result<Reply, CallError> {
        let wait = Wait::within(within);
        self.ask_while(call, 0, &wait)
    }

    /// As [`Link::ask`], for as long as `wait` says. `bytes` is what the reply may bring.
    pub(crate) fn ask_while(
        &self,
        call: Call,
        bytes: usize,
        wait: &Wait<'_>,
    ) -> Result<Reply, CallError> {
        let shared = &*self.shared;
        let (answer, reply) = sync_channel(1);
        let name = name_of(&call);
        let written = shared.write(call, Waiting { bytes, answer });
        if let Err(error) = written.map_err(CallError::Lost)? {
            shared.close(&format!("nothing can be written to it: {error}"));
        }
        let start = Instant::now();
        let reply = loop {
            let left = wait.at_most.saturating_sub(start.elapsed());
            match reply.recv_timeout(left.min(wait.late)) {
                Ok(Ok(reply)) => break reply,
                Ok(Err(reason)) => return Err(CallError::Lost(reason)),
                // Where the driver is gone this ends the connection, and the next turn of the loop tells why.
                Err(RecvTimeoutError::Timeout) if start.elapsed() < wait.at_most => {
                    (wait.is_there)();
                }
                Err(RecvTimeoutError::Timeout) => {
                    let seconds = wait.at_most.as_secs_f64();
                    shared.close(&format!(
                        "it did not answer {}'{name}' within {seconds} s",
                        wait.before
                    ));
                    return Err(CallError::Lost(shared.reason()));
                }
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(CallError::Lost(shared.reason()));
                }
            }
        };
        match reply.object.get("error") {
            None => Ok(reply),
            Some(code) => {
                let text = |key: &str| Some(reply.object.get(key)?.as_str()?.to_owned());
                Err(CallError::Said {
                    // A word that is no code is a refusal of some kind.
                    code: serde_json::from_value(code.clone()).unwrap_or(Code::Refused),
                    message: text("message").unwrap_or_else(|| format!("{code} to '{name}'")),
                    nonce: text("nonce"),
                })
            }
        }
    }

    /// Ends the connection without a word, as a pulled plug does.
    pub(crate) fn cut(&self) {
        self.shared.end("it was cut off", false);
    }

    /// Ends the connection because of what the driver said.
    pub(crate) fn break_off(&self, reason: &str) -> ScopeError {
        self.shared.close(reason);
        self.lost("driver")
    }

    pub(crate) fn lost(&self, device: &'static str) -> ScopeError {
        ScopeError::Lost {
            device,
            detail: self.shared.reason(),
        }
    }
}

fn name_of(call: &Call) -> String {
    let json = serde_json::to_value(call).unwrap_or_default();
    json["call"].as_str().unwrap_or("?").to_owned()
}

impl Shared {
    /// Writes a request, whose answer is waited for from then on; or the reason why the driver is gone. Numbers rise in the order in which they
    /// are written, whoever asks at the same time: a driver refuses one that does not, were it a stop.
    fn write(&self, call: Call, waiting: Waiting) -> Result<std::io::Result<()>, String> {
        let mut out = lock(&self.out);
        let id = self.next.fetch_add(1, Ordering::SeqCst);
        {
            let mut state = lock(&self.state);
            if let Some(reason) = &state.lost {
                return Err(reason.clone());
            }
            state.waiting.insert(id, waiting);
        }
        Ok(match &mut *out {
            Some(out) => wire::write(out, &Request { id, call }, &[]),
            None => Err(std::io::ErrorKind::BrokenPipe.into()),
        })
    }

    fn reason(&self) -> String {
        let state = lock(&self.state);
        state.lost.clone().unwrap_or_else(|| "it was closed".into())
    }

    /// Hands out replies until there are no more, and tells why.
    fn read(&self, stream: &mut impl BufRead) -> String {
        loop {
            let mut object = match wire::read_line(stream) {
                Ok(Some(object)) => object,
                Ok(None) => return "it ended".into(),
                Err(error) => return error.to_string(),
            };
            let at = Instant::now();
            make_visible(&mut object);
            let id = object.get("id").and_then(serde_json::Value::as_u64);
            let waiting = id.and_then(|id| lock(&self.state).waiting.remove(&id));
            let Some(waiting) = waiting else {
                return "it sent a reply that nobody asked for".into();
            };
            let ok = object.get("ok") == Some(&serde_json::Value::Bool(true));
            let count = match object.get("bytes") {
                None => 0,
                Some(count) => match count.as_u64() {
                    Some(count) if ok && count == waiting.bytes as u64 => waiting.bytes,
                    _ => {
                        let reason = format!(
                            "it announced {count} bytes where {} were agreed on",
                            waiting.bytes
                        );
                        let _ = waiting.answer.send(Err(reason.clone()));
                        return reason;
                    }
                },
            };
            let answer = match ok || object.contains_key("error") {
                true => wire::read_bytes(stream, count).map_err(|e| e.to_string()),
                false => Err("it sent a reply with neither ok nor error".into()),
            };
            let (answer, reason) = match answer {
                Ok(bytes) => (Ok(Reply { object, bytes, at }), None),
                Err(reason) => (Err(reason.clone()), Some(reason)),
            };
            // Whoever asked may have given up.
            let _ = waiting.answer.send(answer);
            if let Some(reason) = reason {
                return reason;
            }
        }
    }

    /// Stops everything at the other end and ends the connection. The first reason stays.
    fn close(&self, reason: &str) {
        self.end(reason, true);
    }

    fn end(&self, reason: &str, farewell: bool) {
        let waiting = {
            let mut state = lock(&self.state);
            if state.lost.is_some() {
                return;
            }
            state.lost = Some(reason.to_owned());
            std::mem::take(&mut state.waiting)
        };
        for (_, waiting) in waiting {
            let _ = waiting.answer.try_send(Err(reason.to_owned()));
        }
        // What cannot be stopped by asking is stopped by the end of its input.
        let mut out = lock(&self.out).take();
        if let Some(out) = out.as_mut().filter(|_| farewell) {
            let id = self.next.fetch_add(2, Ordering::SeqCst);
            for (id, call) in [(id, Call::Stop), (id + 1, Call::Bye)] {
                let _ = wire::write(out, &Request { id, call }, &[]);
            }
        }
        drop(out);
        let silent = lock(&self.silent).take();
        let reaper = match lock(&self.end).take() {
            Some(End::Child(child)) => std::thread::spawn(move || child::end(child)),
            Some(End::Tcp(stream)) => std::thread::spawn(move || {
                if farewell {
                    // The end of its input, as for a program: it answers `bye` and goes.
                    let _ = stream.shutdown(Shutdown::Write);
                    let _ = silent.map(|silent| silent.recv_timeout(FAREWELL));
                }
                let _ = stream.shutdown(Shutdown::Both);
            }),
            None => return,
        };
        *lock(&self.reaper) = Some(reaper);
    }
}
