//! One connection that lasts: frames as they are drawn, how things stand, and what happens; and what is held to move.

use crate::app::App;
use crate::error::ApiError;
use crate::jog::Way;
use crate::limits::Rates;
use crate::live::{Live, Watching};
use crate::look;
use crate::need::Need;
use crate::people::Caller;
use crate::starting;
use axum::body::Bytes;
use axum::extract::ws::{Message, Utf8Bytes, WebSocket};
use axum::http::StatusCode;
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt as _, StreamExt as _};
use scopeservo_station::{Heard, Listener};
use serde::Deserialize;
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{Instant, MissedTickBehavior, interval, timeout};

/// Who takes nothing for so long is cut off.
const PATIENCE: Duration = Duration::from_secs(10);
/// Who does not draw a frame within so long is sent the next one all the same.
const UNDRAWN: Duration = Duration::from_secs(2);
/// How often it is looked whether a frame may go.
const DRAW: Duration = Duration::from_millis(4);
/// How often a browser is asked whether it is there still: it answers by itself, also while nobody looks at it.
const PING: Duration = Duration::from_secs(5);
/// How things stand is told as often, when nothing changes.
const STANDING: Duration = Duration::from_secs(1);
/// So many messages of one that lasts in a second, and at once.
const SAID_PER_S: f64 = 50.0;
const SAID_AT_ONCE: f64 = 200.0;
/// So many events at once, then frames have their turn.
const EVENTS: usize = 50;
/// So much of what one said waits for its turn; a stop does not.
const WAITING: usize = 256;

/// The way to whoever is connected.
type Ear = SplitSink<WebSocket, Message>;

/// What a browser or a program says.
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum Said {
    Watch { fps: f64 },
    Ack { seq: u64 },
    Alive {},
    Jog(Way),
    JogEnd {},
    From { number: u64 },
    Ping { n: Value },
}

/// The one thing that waits for nothing else.
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
enum Urgent {
    Stop {},
}

/// What came of a connection, in its order.
enum Came {
    Text(Utf8Bytes),
    Pong,
    /// A stop that a device did not take.
    NotStopped(ApiError),
}

impl Said {
    /// What moves, stops and keeps going is always heard.
    fn is_vital(&self) -> bool {
        !matches!(
            self,
            Self::Watch { .. } | Self::From { .. } | Self::Ping { .. }
        )
    }
}

struct Client {
    app: Arc<App>,
    caller: Caller,
    listener: Listener,
    watching: Option<Watching>,
    /// Between two frames.
    gap: Duration,
    /// The frame that is being drawn, and since when.
    sent: Option<(u64, Instant)>,
    last_frame: Instant,
    /// What it may say still, but for what moves, stops, and keeps going.
    rates: Rates,
    /// The stops that there had been when nothing was held last.
    stops: u64,
}

/// Serves one connection until it ends.
pub(crate) async fn serve(app: Arc<App>, caller: Caller, socket: WebSocket) {
    let (mut ear, mouth) = socket.split();
    let listener = app.console.session().listen();
    let next = *app.events.borrow();
    let hello = json!({"type": "hello", "version": env!("CARGO_PKG_VERSION"), "next": next});
    let mut client = Client {
        listener,
        watching: None,
        gap: Duration::ZERO,
        sent: None,
        last_frame: Instant::now(),
        rates: Rates::new(SAID_PER_S, SAID_AT_ONCE),
        stops: app.stops.load(Ordering::SeqCst),
        app,
        caller,
    };
    if tell(&mut ear, hello).await.is_ok() {
        let (said, mut comes) = mpsc::channel(WAITING);
        let reading = tokio::spawn(read(client.app.clone(), client.caller.clone(), mouth, said));
        let _ = client.talk(&mut ear, &mut comes).await;
        reading.abort();
    }
    // Whoever held the stage is gone.
    let (app, key) = (client.app.clone(), client.caller.key.clone());
    let _ = tokio::task::spawn_blocking(move || app.desk.let_go(&key)).await;
}

/// Reads what is said. A stop goes to the devices from here: nothing that is sent to the same one, or waits for a device, keeps it.
async fn read(
    app: Arc<App>,
    caller: Caller,
    mut mouth: SplitStream<WebSocket>,
    said: mpsc::Sender<Came>,
) {
    while let Some(Ok(message)) = mouth.next().await {
        let came = match message {
            Message::Text(text) if serde_json::from_str::<Urgent>(&text).is_ok() => {
                match blocking(&app, &caller, stop).await {
                    Ok(()) => continue,
                    Err(error) => Came::NotStopped(error),
                }
            }
            Message::Text(text) => Came::Text(text),
            Message::Pong(_) => Came::Pong,
            Message::Close(_) => return,
            Message::Binary(_) | Message::Ping(_) => continue,
        };
        if said.send(came).await.is_err() {
            return;
        }
    }
}

/// What may wait for a device does not keep the connection from others.
async fn blocking(
    app: &Arc<App>,
    caller: &Caller,
    what: impl FnOnce(&Arc<App>, &Caller) -> Result<(), ApiError> + Send + 'static,
) -> Result<(), ApiError> {
    let (app, caller) = (app.clone(), caller.clone());
    let done = tokio::task::spawn_blocking(move || what(&app, &caller)).await;
    done.unwrap_or_else(|_| {
        Err(ApiError::fault(
            "a mistake of the program, told on its terminal",
        ))
    })
}

/// The connection has ended.
struct Gone;

async fn send(socket: &mut Ear, message: Message) -> Result<(), Gone> {
    match timeout(PATIENCE, socket.send(message)).await {
        Ok(Ok(())) => Ok(()),
        _ => Err(Gone),
    }
}

async fn tell(socket: &mut Ear, what: Value) -> Result<(), Gone> {
    send(socket, Message::Text(Utf8Bytes::from(what.to_string()))).await
}

impl Client {
    async fn talk(
        &mut self,
        socket: &mut Ear,
        comes: &mut mpsc::Receiver<Came>,
    ) -> Result<(), Gone> {
        let mut standing = self.app.standing.subscribe();
        let mut events = self.app.events.subscribe();
        let mut often = interval(STANDING);
        often.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut ping = interval(PING);
        ping.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut draw = interval(DRAW);
        draw.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                came = comes.recv() => match came {
                    Some(Came::Text(text)) => self.heard(socket, &text).await?,
                    Some(Came::Pong) => self.is_there(),
                    Some(Came::NotStopped(error)) => refuse(socket, error).await?,
                    None => return Err(Gone),
                },
                changed = standing.changed() => {
                    changed.map_err(|_| Gone)?;
                    self.tell_standing(socket).await?;
                }
                _ = ping.tick() => send(socket, Message::Ping(Bytes::new())).await?,
                _ = often.tick() => {
                    self.is_somebody(socket).await?;
                    self.tell_standing(socket).await?;
                }
                changed = events.changed() => {
                    changed.map_err(|_| Gone)?;
                    self.tell_events(socket).await?;
                }
                _ = draw.tick(), if self.watching.is_some() => self.show(socket).await?,
            }
        }
    }

    /// Who logged out, or was taken out, hears nothing more.
    async fn is_somebody(&self, socket: &mut Ear) -> Result<(), Gone> {
        if self.app.people.knows(&self.caller) {
            return Ok(());
        }
        let message = "this session has ended: log in again";
        let ended = ApiError::new(StatusCode::UNAUTHORIZED, "not_logged_in", message);
        refuse(socket, ended).await?;
        Err(Gone)
    }

    async fn tell_standing(&mut self, socket: &mut Ear) -> Result<(), Gone> {
        let state = look::told(&self.app, &self.caller);
        tell(socket, json!({"type": "state", "state": state})).await
    }

    async fn tell_events(&mut self, socket: &mut Ear) -> Result<(), Gone> {
        for _ in 0..EVENTS {
            match self.listener.heard() {
                None => return Ok(()),
                Some(Heard::Missed { events }) => {
                    tell(socket, json!({"type": "missed", "events": events})).await?;
                }
                Some(Heard::Event(record)) => {
                    tell(socket, json!({"type": "event", "record": &*record})).await?;
                }
            }
        }
        // The rest comes after what else waits.
        self.app.events.send_modify(|_| {});
        Ok(())
    }

    /// The newest frame, when the one before was drawn.
    async fn show(&mut self, socket: &mut Ear) -> Result<(), Gone> {
        let Some(watching) = &mut self.watching else {
            return Ok(());
        };
        let is_drawn = self.sent.is_none_or(|(_, since)| since.elapsed() > UNDRAWN);
        if !is_drawn || self.last_frame.elapsed() < self.gap {
            return Ok(());
        }
        if !watching.frames.has_changed().unwrap_or(false) {
            return Ok(());
        }
        let newest = watching.frames.borrow_and_update().clone();
        let Some(encoded) = newest else {
            return Ok(());
        };
        self.sent = Some((encoded.head.seq, Instant::now()));
        self.last_frame = Instant::now();
        send(socket, Message::Binary(encoded.message().into())).await
    }

    async fn heard(&mut self, socket: &mut Ear, text: &str) -> Result<(), Gone> {
        let said: Said = match serde_json::from_str(text) {
            Ok(said) => said,
            Err(error) => return refuse(socket, ApiError::input(error.to_string())).await,
        };
        if !said.is_vital()
            && let Err(wait) = self.rates.take("", Instant::now().into_std())
        {
            let message = "too many messages in so short a time: say less at once";
            return refuse(socket, ApiError::too_many(message, wait)).await;
        }
        match said {
            Said::Watch { fps } => self.watch(fps),
            Said::Ack { seq } => {
                if self.sent.is_some_and(|(sent, _)| sent <= seq) {
                    self.sent = None;
                }
            }
            Said::Alive {} => self.app.seat.renew(&self.caller),
            Said::From { number } => {
                self.listener = self.app.console.session().bus().listen_from(number);
                self.tell_events(socket).await?;
            }
            Said::Ping { n } => tell(socket, json!({"type": "pong", "n": n})).await?,
            Said::JogEnd {} => {
                self.stops = self.app.stops.load(Ordering::SeqCst);
                let let_go = |app: &Arc<App>, caller: &Caller| {
                    app.desk.let_go(&caller.key);
                    Ok(())
                };
                blocking(&self.app, &self.caller, let_go).await.ok();
            }
            // A stop came while it was held: it is let go first, whatever the program there does.
            Said::Jog(_) if self.stops != self.app.stops.load(Ordering::SeqCst) => {
                let message = "a stop came: let go, and hold again";
                return refuse(socket, ApiError::conflict("stopped", message)).await;
            }
            Said::Jog(way) => {
                self.is_somebody(socket).await?;
                let near = self.caller.here || self.app.elsewhere_for().is_some();
                self.caller.near = near;
                let stops = self.stops;
                let begin =
                    move |app: &Arc<App>, caller: &Caller| starting::jog(app, caller, way, stops);
                let begun = match Need::Move.met_by(Some(&self.caller)) {
                    Ok(()) => blocking(&self.app, &self.caller, begin).await,
                    refused => refused,
                };
                if let Err(error) = begun {
                    return refuse(socket, error).await;
                }
            }
        }
        Ok(())
    }

    /// Whoever drives keeps the seat while their job is under way, though they look at something else meanwhile.
    fn is_there(&self) {
        if self.app.desk.under_way().is_some() {
            self.app.seat.renew(&self.caller);
        }
    }

    fn watch(&mut self, fps: f64) {
        self.sent = None;
        self.watching = match fps > 0.0 {
            true => Some(Live::watch(&self.app.live)),
            false => None,
        };
        self.gap = match fps > 0.0 {
            true => Duration::from_secs_f64(1.0 / fps.clamp(0.1, 60.0)).mul_f64(0.9),
            false => Duration::ZERO,
        };
    }
}

/// Everything stands still.
///
/// # Errors
/// What a device answers that does not take the stop.
pub(crate) fn stop(app: &Arc<App>, caller: &Caller) -> Result<(), ApiError> {
    app.stops.fetch_add(1, Ordering::SeqCst);
    let told = app.console.session().stop();
    let _ = app.audit.note(caller, "stopped", Value::Null);
    Ok(told?)
}

async fn refuse(socket: &mut Ear, error: ApiError) -> Result<(), Gone> {
    let what = json!({"type": "refused", "code": error.code, "message": error.message});
    tell(socket, what).await
}
