//! The live view: the newest frame, whoever grabbed it, encoded once for all who watch.

mod encoded;
mod parts;

pub(crate) use encoded::Encoded;
pub(crate) use parts::parts;

use crate::app::App;
use crate::lock;
use scopeservo_scope::Frame;
use scopeservo_station::Listener;
use serde_json::{Value, json};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Not more often than this.
const FASTEST: Duration = Duration::from_millis(33);
/// Nobody watches: so long until that is looked at again.
const IDLE: Duration = Duration::from_millis(30);
/// After a camera that does not answer.
const TROUBLED: Duration = Duration::from_millis(500);

/// The newest frame and who watches.
pub(crate) struct Live {
    newest: watch::Sender<Option<Arc<Encoded>>>,
    watching: AtomicUsize,
    camera: Mutex<Camera>,
}

/// How the camera does.
#[derive(Default)]
struct Camera {
    last: Option<Instant>,
    trouble: Option<String>,
}

/// One who watches, as long as it is kept.
pub(crate) struct Watching {
    app: Arc<App>,
    pub(crate) frames: watch::Receiver<Option<Arc<Encoded>>>,
}

impl Drop for Watching {
    fn drop(&mut self) {
        self.app.live.watching.fetch_sub(1, Ordering::SeqCst);
    }
}

impl Default for Live {
    fn default() -> Self {
        Self {
            newest: watch::channel(None).0,
            watching: AtomicUsize::new(0),
            camera: Mutex::default(),
        }
    }
}

impl Live {
    /// From now on frames are grabbed and encoded.
    pub(crate) fn watch(app: &Arc<App>) -> Watching {
        app.live.watching.fetch_add(1, Ordering::SeqCst);
        Watching {
            app: app.clone(),
            frames: app.live.newest.subscribe(),
        }
    }

    fn is_watched(&self) -> bool {
        self.watching.load(Ordering::SeqCst) > 0
    }

    /// How the camera does, for the state.
    pub(crate) fn camera(&self) -> Value {
        let camera = lock(&self.camera);
        json!({
            "age_s": camera.last.map(|last| last.elapsed().as_secs_f64()),
            "trouble": camera.trouble,
        })
    }

    fn show(&self, encoded: Encoded) {
        *lock(&self.camera) = Camera {
            last: Some(Instant::now()),
            trouble: None,
        };
        self.newest.send_replace(Some(Arc::new(encoded)));
    }
}

/// Shows what jobs grab, and grabs by itself while none is at work, until the server ends.
pub(crate) fn run(app: &Arc<App>) {
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
        sequence += 1;
        match Encoded::of(app, &frame, role, sequence, began) {
            Ok(encoded) => app.live.show(encoded),
            Err(why) => lock(&app.live.camera).trouble = Some(why),
        }
        let left = FASTEST.saturating_sub(began.elapsed());
        std::thread::sleep(left);
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
            lock(&app.live.camera).trouble = Some(error.to_string());
            std::thread::sleep(TROUBLED);
            None
        }
    }
}
