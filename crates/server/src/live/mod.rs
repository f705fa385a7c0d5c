//! The live view: the newest frame, whoever grabbed it, encoded once for all who watch.

mod encoded;
mod parts;

pub(crate) use encoded::{About, Encoded, jpeg};
pub(crate) use parts::parts;

use crate::lock;
use serde_json::{Value, json};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;
use tokio::sync::watch;

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
    live: Arc<Live>,
    pub(crate) frames: watch::Receiver<Option<Arc<Encoded>>>,
}

impl Drop for Watching {
    fn drop(&mut self) {
        self.live.watching.fetch_sub(1, Ordering::SeqCst);
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
    pub(crate) fn watch(live: &Arc<Self>) -> Watching {
        live.watching.fetch_add(1, Ordering::SeqCst);
        Watching {
            live: live.clone(),
            frames: live.newest.subscribe(),
        }
    }

    pub(crate) fn is_watched(&self) -> bool {
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

    /// The camera does not do what it should.
    pub(crate) fn is_troubled(&self, why: String) {
        lock(&self.camera).trouble = Some(why);
    }

    pub(crate) fn show(&self, encoded: Encoded) {
        *lock(&self.camera) = Camera {
            last: Some(Instant::now()),
            trouble: None,
        };
        self.newest.send_replace(Some(Arc::new(encoded)));
    }
}
