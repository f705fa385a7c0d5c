//! What all connections share.

use crate::audit::Audit;
use crate::desk::Desk;
use crate::error::ApiError;
use crate::limits::Rates;
use crate::live::Live;
use crate::names::Names;
use crate::need::Need;
use crate::people::{Caller, People};
use crate::seat::Seat;
use crate::standing::Standing;
use scopeservo_scope::ObjectiveId;
use scopeservo_workbench::{Console, Workbench};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};

/// The server's state.
pub(crate) struct App {
    pub(crate) bench: Arc<Workbench>,
    pub(crate) console: Console,
    pub(crate) desk: Desk,
    pub(crate) seat: Seat,
    pub(crate) people: People,
    pub(crate) audit: Audit,
    pub(crate) live: Arc<Live>,
    /// How things stand, renewed several times a second.
    pub(crate) standing: watch::Sender<Arc<Standing>>,
    /// The number of the event that comes next.
    pub(crate) events: watch::Sender<u64>,
    /// What lies on the stage, as somebody said.
    pub(crate) slide: Mutex<Option<String>>,
    /// Objectives that are calibrated, with the size of a pixel, um.
    pub(crate) calibrated: Mutex<BTreeMap<ObjectiveId, f64>>,
    /// What a killed program left, in a sentence.
    pub(crate) left: Mutex<Option<String>>,
    /// Who has connections that last, by session or token: their names, and how many.
    pub(crate) present: Mutex<BTreeMap<String, (String, usize)>>,
    /// By which names browsers may know us.
    pub(crate) names: Names,
    /// A demonstration, whose slide can be taken out and put back.
    pub(crate) demo: Option<Demo>,
    /// Counts the stops: what was held when one came is to be let go first.
    pub(crate) stops: AtomicU64,
    /// Counts what changed of what is kept.
    pub(crate) revision: AtomicU64,
    /// Until when somebody at another machine may move the instrument.
    pub(crate) elsewhere: Mutex<Option<Instant>>,
    /// How much each may ask still.
    pub(crate) rates: Mutex<Rates>,
    /// Connections that last.
    pub(crate) sockets: Arc<Semaphore>,
    /// The server ends.
    pub(crate) ends: AtomicBool,
}

/// What is there of a demonstration beside its instrument.
pub(crate) struct Demo {
    /// Whether the slide lies where it lay at first.
    pub(crate) is_moved: AtomicBool,
    /// The picture that somebody brought and that lies there now.
    pub(crate) picture: Mutex<Option<String>>,
    /// So long a picture may take to come.
    pub(crate) patience: Duration,
    /// Pictures that come.
    pub(crate) coming: Semaphore,
    /// How often it was taken out.
    pub(crate) times: Mutex<u64>,
}

/// Each slide is put back up to so far from where it lay, um, and turned by up to so much, deg.
const SHIFT_UM: f64 = 90.0;
const TURN_DEG: f64 = 6.0;

/// So many connections that last of one session or token: some stay for the others.
const SOCKETS_OF_ONE: usize = 48;

/// A connection that lasts, and whose.
pub(crate) struct Present {
    _place: OwnedSemaphorePermit,
    app: Arc<App>,
    key: String,
}

impl Drop for Present {
    fn drop(&mut self) {
        let mut present = crate::lock(&self.app.present);
        if let Some((_, count)) = present.get_mut(&self.key) {
            *count -= 1;
            if *count == 0 {
                present.remove(&self.key);
            }
        }
    }
}

impl App {
    /// A place for one more connection that lasts.
    ///
    /// # Errors
    /// `too_many`.
    pub(crate) fn socket_place(self: &Arc<Self>, caller: &Caller) -> Result<Present, ApiError> {
        let wait = Duration::from_secs(5);
        let too_many = |message: &str| ApiError::too_many(message, wait);
        let place = self.sockets.clone().try_acquire_owned();
        let place = place.map_err(|_| too_many("too many connections: close some"))?;
        let mut present = crate::lock(&self.present);
        let of_one = present.entry(caller.key.clone());
        let (_, count) = of_one.or_insert_with(|| (caller.user.clone(), 0));
        if *count >= SOCKETS_OF_ONE {
            return Err(too_many("you have too many connections: close some"));
        }
        *count += 1;
        Ok(Present {
            _place: place,
            app: self.clone(),
            key: caller.key.clone(),
        })
    }

    /// Who has the page open, or a program that listens: each once.
    pub(crate) fn who_is_there(&self) -> Vec<String> {
        let present = crate::lock(&self.present);
        let names: BTreeSet<&String> = present.values().map(|(user, _)| user).collect();
        names.into_iter().cloned().collect()
    }

    /// Reads what a killed program left: asked when that may have changed, as it reads files.
    pub(crate) fn learn_left(&self) {
        let left = self.bench.waits().unwrap_or_else(|e| Some(e.to_string()));
        *crate::lock(&self.left) = left;
    }

    /// Why this one could start no job that moves the instrument now.
    pub(crate) fn bars(&self, caller: &Caller) -> Result<(), ApiError> {
        Need::Move.met_by(Some(caller))?;
        self.desk.is_free()?;
        self.seat.is_free_for(caller)?;
        match crate::lock(&self.left).as_deref() {
            None => Ok(()),
            Some(left) => Err(ApiError::unfinished(left)),
        }
    }

    /// Something that is kept has changed.
    pub(crate) fn has_changed(&self) {
        self.revision.fetch_add(1, Ordering::SeqCst);
    }

    /// How long somebody at another machine may move the instrument still.
    pub(crate) fn elsewhere_for(&self) -> Option<Duration> {
        let until = *crate::lock(&self.elsewhere);
        until.and_then(|until| until.checked_duration_since(Instant::now()))
    }

    /// The demonstration's slide is taken out and put back, a little elsewhere and turned.
    ///
    /// # Errors
    /// `no_demo`, on a real instrument.
    pub(crate) fn move_demo_slide(&self) -> Result<(), ApiError> {
        let (Some(demo), Some(twin)) = (&self.demo, &self.bench.twin) else {
            let message = "only a demonstration's slide is moved by a button";
            return Err(ApiError::conflict("no_demo", message));
        };
        let mut times = crate::lock(&demo.times);
        *times += 1;
        // Each time elsewhere, and the same ones in the same order.
        let turn = 2.4 * *times as f64;
        let (s, c) = turn.sin_cos();
        let info = self.bench.scope.camera().info();
        let middle = [info.width, info.height].map(|n| (n as f64 - 1.0) / 2.0);
        let about_um = twin.truth_now().specimen(middle);
        twin.remount(
            about_um,
            [SHIFT_UM * c, SHIFT_UM * s],
            TURN_DEG * (turn * 0.7).sin(),
            false,
        );
        demo.is_moved.store(true, Ordering::SeqCst);
        Ok(())
    }
}
