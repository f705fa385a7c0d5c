//! The server's threads: connections, the live view, a look at how things stand, and what happens.

use crate::app::{App, Demo};
use crate::audit::Audit;
use crate::door::Door;
use crate::grabbing;
use crate::look;
use crate::names::Names;
use crate::people::People;
use crate::routes::router;
use crate::seat::Seat;
use crate::standing::Standing;
use axum::Router;
use axum::extract::ConnectInfo;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use scopeservo_library::Calibrations as _;
use scopeservo_scope::{Instrument, Length};
use scopeservo_station::{Bus, MadeCalibration, Parts, Questions};
use scopeservo_workbench::{Console, Late, Workbench};
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::{Semaphore, watch};

/// So many connections at once; one more is closed as it comes.
const CONNECTIONS: usize = 256;
/// Of them so many that last.
const SOCKETS: usize = 64;
/// Who does not say what is wanted within so long is cut off.
const HEAD: Duration = Duration::from_secs(10);
/// Threads of the network; those that wait for devices are others.
const THREADS: usize = 2;
/// How long connections have to end.
const ENDING: Duration = Duration::from_secs(2);

/// How to serve.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Where to listen: a loopback address, port 0 for any that is free.
    pub listen: SocketAddr,
    /// Other names, with a port or without, under which browsers may ask for it: those of a proxy in front of it.
    pub names: Vec<String>,
    /// A demonstration: one user, nothing kept of users, and a slide that can be taken out and put back.
    pub demo: bool,
    /// Where users and the log of who moved what are kept; nothing is in a demonstration.
    pub folder: PathBuf,
}

/// Why it cannot be served.
#[derive(Debug, Error)]
pub enum ServeError {
    /// An address that others can reach.
    #[error(
        "{0} can be reached from other machines, and what is sent there can be read on the way: listen at a loopback address like 127.0.0.1:7070, and let a proxy with TLS on this machine pass on what comes from outside"
    )]
    NotLoopback(SocketAddr),
    /// The address cannot be had.
    #[error("{address} cannot be had: {source}. Name another with --listen, or end what is there")]
    Address {
        /// Which.
        address: SocketAddr,
        /// What the system says.
        source: io::Error,
    },
    /// The system lacks something.
    #[error("the server cannot begin: {0}")]
    System(#[from] io::Error),
    /// Nobody could come in.
    #[error(
        "the users cannot be read ({path}): {why}. Bring the file back, or move it away to begin anew"
    )]
    People {
        /// The file.
        path: PathBuf,
        /// Why.
        why: String,
    },
}

/// What is made before the instrument is opened, as opening it may need to ask people.
pub struct Before {
    /// Where all is told.
    pub bus: Bus,
    /// Who is asked.
    pub questions: Questions,
}

impl Default for Before {
    fn default() -> Self {
        let bus = Bus::default();
        Self {
            questions: Questions::new(bus.clone()),
            bus,
        }
    }
}

/// An instrument that is served. When it is dropped connections end, jobs are stopped, and the instrument is let go.
pub struct Server {
    app: Arc<App>,
    address: SocketAddr,
    runtime: Option<Runtime>,
    threads: Vec<JoinHandle<()>>,
    _door: Option<Door>,
}

impl Server {
    /// Serves an instrument.
    ///
    /// # Errors
    /// [`ServeError`].
    pub fn start(
        bench: Workbench,
        before: Before,
        settings: &Settings,
    ) -> Result<Self, ServeError> {
        if !settings.listen.ip().is_loopback() {
            return Err(ServeError::NotLoopback(settings.listen));
        }
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(THREADS)
            .enable_all()
            .build()?;
        let taken = runtime.block_on(TcpListener::bind(settings.listen));
        let listener = taken.map_err(|source| ServeError::Address {
            address: settings.listen,
            source,
        })?;
        let address = listener.local_addr()?;
        let app = Arc::new(app(bench, before, settings, address)?);
        app.learn_calibrated();
        let door = match settings.demo {
            true => None,
            false => Some(Door::open(
                &settings.folder,
                address,
                app.people.terminal(),
            )?),
        };
        let threads = spawn(&app)?;
        runtime.spawn(accept(listener, router(&app)));
        Ok(Self {
            app,
            address,
            runtime: Some(runtime),
            threads,
            _door: door,
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What somebody at this machine opens: with the key that lets the first one in, where nobody is known yet.
    pub fn link(&self) -> String {
        match self.app.people.key() {
            Some(key) => format!("http://{}/#key={key}", self.address),
            None => format!("http://{}/", self.address),
        }
    }

    /// Keeps calibrations that were made elsewhere, of an instrument that is the same: a simulated one. What cannot be kept is made again.
    pub fn keep_calibrations(&self, made: &[MadeCalibration]) {
        let bench = &self.app.bench;
        for made in made {
            let z = made.focus_z_um.map(Length::from_um);
            let name = &bench.config.name;
            let calibration = &made.calibration;
            let _ = bench
                .library
                .keep_calibration(name, calibration, z, made.residual_px);
        }
        self.app.learn_calibrated();
    }

    /// The instrument.
    pub fn scope(&self) -> &Arc<Instrument> {
        &self.app.bench.scope
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.app.ends.store(true, Ordering::SeqCst);
        if let Some(entry) = self.app.desk.under_way() {
            // Its thread tells what the device says.
            let _ = entry.handle.stop();
        }
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(ENDING);
        }
        // What a job came to is kept before the program goes.
        while self.app.desk.under_way().is_some() {
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

fn app(
    bench: Workbench,
    before: Before,
    settings: &Settings,
    address: SocketAddr,
) -> Result<App, ServeError> {
    let file = settings.folder.join("people.json");
    let people = People::open(file.clone(), settings.demo);
    let people = people.map_err(|why| ServeError::People { path: file, why })?;
    let bench = Arc::new(bench);
    let parts = Parts {
        bus: before.bus,
        questions: before.questions,
        journal: bench.journal.clone(),
        ..Parts::default()
    };
    let (events, _) = watch::channel(0);
    let (tell, keeper) = (events.clone(), bench.keeper());
    let console = Console::new(&bench.scope, parts, Late::LeftOut, move |record| {
        keeper(record);
        tell.send_replace(record.number + 1);
    });
    let seat = Seat::new(console.session().clone());
    let log = (!settings.demo).then(|| settings.folder.join("moved.jsonl"));
    let demo = settings.demo.then(|| Demo {
        is_moved: AtomicBool::new(false),
        times: Mutex::new(0),
    });
    Ok(App {
        console,
        desk: Default::default(),
        seat,
        people,
        audit: Audit::new(log),
        live: Arc::default(),
        standing: watch::channel(Arc::new(Standing::unknown())).0,
        events,
        slide: Mutex::new(None),
        told: Default::default(),
        calibrated: Mutex::default(),
        names: Names::of(address, &settings.names),
        demo,
        stops: AtomicU64::new(0),
        revision: AtomicU64::new(0),
        elsewhere: Mutex::new(None),
        sockets: Arc::new(Semaphore::new(SOCKETS)),
        ends: AtomicBool::new(false),
        bench,
    })
}

/// The threads that wait for devices.
fn spawn(app: &Arc<App>) -> io::Result<Vec<JoinHandle<()>>> {
    type Run = fn(&Arc<App>);
    let threads: [(&str, Run); 3] = [
        ("standing", look::keep_looking),
        ("held", look::keep_ending),
        ("live", grabbing::run),
    ];
    let begun = threads.into_iter().map(|(name, run)| {
        let app = app.clone();
        let thread = std::thread::Builder::new().name(name.into());
        thread.spawn(move || run(&app))
    });
    begun.collect()
}

/// Takes connections as they come, so many at once.
async fn accept(listener: TcpListener, router: Router) {
    let places = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let (stream, peer) = match listener.accept().await {
            Ok(taken) => taken,
            // Too many files, or one who went before: the next one may do better.
            Err(_) => {
                tokio::time::sleep(Duration::from_millis(50)).await;
                continue;
            }
        };
        let Ok(place) = places.clone().try_acquire_owned() else {
            continue;
        };
        let _ = stream.set_nodelay(true);
        let router = router.clone().layer(axum::Extension(ConnectInfo(peer)));
        tokio::spawn(async move {
            let served = http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(HEAD)
                .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
                .with_upgrades();
            // Whoever hangs up in the middle is gone.
            let _ = served.await;
            drop(place);
        });
    }
}
