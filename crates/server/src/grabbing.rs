//! Frames for the live view: those that jobs grab, and others while none is at work.

use crate::app::App;
use crate::live::{About, Encoded};
use crate::lock;
use scopeservo_protocol::Place;
use scopeservo_scope::Frame;
use scopeservo_station::Listener;
use serde_json::json;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Not more often than this.
const FASTEST: Duration = Duration::from_millis(33);
/// Nobody watches: so long until that is looked at again.
const IDLE: Duration = Duration::from_millis(30);
/// After a camera that does not answer.
const TROUBLED: Duration = Duration::from_millis(500);

/// A frame that waits to be encoded: the newest, as one that nobody will see is not.
#[derive(Default)]
struct Slot {
    waits: Mutex<Option<(Arc<Frame>, About, Instant)>>,
    came: Condvar,
}

/// Shows what jobs grab, and grabs by itself while none is at work, until the server ends. The next one is grabbed while one is encoded.
pub(crate) fn run(app: &Arc<App>) {
    let slot = Slot::default();
    std::thread::scope(|threads| {
        threads.spawn(|| encode(app, &slot));
        grab(app, &slot);
    });
}

fn encode(app: &App, slot: &Slot) {
    while !app.ends.load(Ordering::SeqCst) {
        let waits = lock(&slot.waits);
        let none = |waits: &mut Option<_>| waits.is_none();
        let waited = slot.came.wait_timeout_while(waits, IDLE, none);
        let frame = waited.unwrap_or_else(PoisonError::into_inner).0.take();
        if let Some((frame, about, since)) = frame {
            match Encoded::of(&frame, about, since) {
                Ok(encoded) => app.live.show(encoded),
                Err(why) => app.live.is_troubled(why),
            }
        }
    }
}

fn grab(app: &App, slot: &Slot) {
    let mut listener = app.console.session().listen();
    let mut sequence = 0;
    while !app.ends.load(Ordering::SeqCst) {
        if !app.live.is_watched() {
            std::thread::sleep(IDLE);
            continue;
        }
        let began = Instant::now();
        let Some((frame, role)) = next(app, &mut listener) else {
            continue;
        };
        let since = Instant::now();
        sequence += 1;
        *lock(&slot.waits) = Some((frame, about(app, role, sequence), since));
        slot.came.notify_one();
        let left = FASTEST.saturating_sub(began.elapsed());
        std::thread::sleep(left);
    }
}

/// What is told with a frame, of what is known now.
fn about(app: &App, role: String, seq: u64) -> About {
    let standing = app.standing.borrow().clone();
    About {
        seq,
        role,
        um_per_px: standing.objective.as_ref().and_then(|id| app.um_per_px(id)),
        objective: standing.objective.as_ref().map(|id| id.0.clone()),
        at: standing.at.as_ref().map(Place::from),
    }
}

/// The next frame and what it is for; `None` when there is none now.
fn next(app: &App, listener: &mut Listener) -> Option<(Arc<Frame>, String)> {
    if let Some(shown) = listener.frame() {
        let role = json!(shown.role);
        let role = role.as_str().unwrap_or("live").to_owned();
        return Some((shown.frame, role));
    }
    // While a procedure is at work the camera is its own.
    let is_taken = app.desk.under_way().is_some_and(|job| !job.is_by_hand());
    if is_taken {
        std::thread::sleep(IDLE);
        return None;
    }
    match app.bench.scope.camera().grab() {
        Ok(frame) => Some((Arc::new(frame), "live".into())),
        Err(error) => {
            app.live.is_troubled(error.to_string());
            std::thread::sleep(TROUBLED);
            None
        }
    }
}
