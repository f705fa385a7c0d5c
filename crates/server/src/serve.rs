//! The server's threads: connections, the live view, a look at how things stand, and what happens.

use crate::app::{App, Demo};
use crate::audit::Audit;
use crate::door::Door;
use crate::grabbing;
use crate::limits::{Limits, Rates};
use crate::listening::{Listening, outward};
use crate::look;
use crate::names::Names;
use crate::people::People;
use crate::routes::router;
use crate::seat::Seat;
use crate::standing::Standing;
use crate::tls::{Certificate, Tls, TlsError};
use scopeservo_library::Calibrations as _;
use scopeservo_scope::{Instrument, Length};
use scopeservo_station::{Bus, MadeCalibration, Parts, Questions};
use scopeservo_workbench::{Console, Late, Workbench};
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::{Semaphore, watch};
use tokio_rustls::TlsAcceptor;

/// So many connections that last.
const SOCKETS: usize = 64;
/// Threads of the network; those that wait for devices are others.
const THREADS: usize = 2;
/// How long connections have to end.
const ENDING: Duration = Duration::from_secs(2);

/// How to serve.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Where to listen, port 0 for any that is free: at a loopback address, or by TLS, or for a proxy.
    pub listen: SocketAddr,
    /// Other names, with a port or without, under which browsers may ask for it: as others know this computer, or a proxy in front of it.
    pub names: Vec<String>,
    /// By TLS, with that certificate.
    pub tls: Option<Certificate>,
    /// Machines whose word counts for whom they ask. Without TLS no other machine is heard.
    pub proxies: Vec<IpAddr>,
    /// How much is taken of one who asks.
    pub limits: Limits,
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
        "{0} can be reached from other machines, and what is sent there can be read on the way: add --tls, or --proxy with the address of a proxy that speaks TLS for it, or listen at a loopback address like 127.0.0.1:7070"
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
    /// TLS cannot be spoken.
    #[error(transparent)]
    Tls(#[from] TlsError),
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
    fingerprint: Option<String>,
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
        let is_private = settings.listen.ip().is_loopback() || settings.tls.is_some();
        if !is_private && settings.proxies.is_empty() {
            return Err(ServeError::NotLoopback(settings.listen));
        }
        let tls = settings.tls.as_ref().map(|whose| {
            let names = names_of(settings);
            Tls::with(whose, &settings.folder, &names, SystemTime::now())
        });
        let tls = tls.transpose()?;
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(THREADS)
            .enable_all()
            .build()?;
        let bind = |address: SocketAddr| {
            let taken = runtime.block_on(TcpListener::bind(address));
            taken.map_err(|source| ServeError::Address { address, source })
        };
        let listener = bind(settings.listen)?;
        let address = listener.local_addr()?;
        // The command line at this computer comes without TLS, by loopback.
        let inside = match tls {
            None => None,
            Some(_) => Some(bind((Ipv4Addr::LOCALHOST, 0).into())?),
        };
        let mut at = reached_here(address);
        let mut ports = vec![address.port()];
        if let Some(inside) = &inside {
            at = inside.local_addr()?;
            ports.push(at.port());
        }
        let names = Names::of(&ports, &settings.names, tls.is_some());
        let app = Arc::new(app(bench, before, settings, names)?);
        app.learn_calibrated();
        app.learn_left();
        let door = match settings.demo {
            true => None,
            false => Some(Door::open(&settings.folder, at, app.people.terminal())?),
        };
        let threads = spawn(&app)?;
        let listening =
            Listening::new(router(&app), &settings.proxies, settings.limits.connections);
        if let Some(inside) = inside {
            runtime.spawn(listening.clone().accept(inside, None));
        }
        let acceptor = tls
            .as_ref()
            .map(|tls| TlsAcceptor::from(tls.config.clone()));
        runtime.spawn(listening.accept(listener, acceptor));
        Ok(Self {
            app,
            address,
            fingerprint: tls.map(|tls| tls.fingerprint),
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
        let at = self.url(reached_here(self.address));
        match self.app.people.key() {
            Some(key) => format!("{at}#key={key}"),
            None => at,
        }
    }

    /// What somebody at another machine opens, where others reach it.
    pub fn outside(&self) -> Option<String> {
        let ip = outside_ip(self.address.ip())?;
        let by_tls = self.fingerprint.is_some();
        by_tls.then(|| self.url(SocketAddr::new(ip, self.address.port())))
    }

    /// The SHA-256 checksum of the certificate, as browsers show it.
    pub fn fingerprint(&self) -> Option<&str> {
        self.fingerprint.as_deref()
    }

    fn url(&self, at: SocketAddr) -> String {
        match self.fingerprint {
            Some(_) => format!("https://{at}/"),
            None => format!("http://{at}/"),
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

/// Where this computer itself reaches it.
fn reached_here(address: SocketAddr) -> SocketAddr {
    match address.ip().is_unspecified() {
        true => (Ipv4Addr::LOCALHOST, address.port()).into(),
        false => address,
    }
}

/// By which address others reach it.
fn outside_ip(listen: IpAddr) -> Option<IpAddr> {
    match listen.is_unspecified() {
        true => outward().ok().filter(|ip| !ip.is_loopback()),
        false => Some(listen).filter(|ip| !ip.is_loopback()),
    }
}

/// What a certificate of ours is for.
fn names_of(settings: &Settings) -> Vec<String> {
    let mut names = ["localhost", "127.0.0.1", "::1"]
        .map(str::to_owned)
        .to_vec();
    names.extend(outside_ip(settings.listen.ip()).map(|ip| ip.to_string()));
    // Without the port, and the brackets of IPv6.
    names.extend(settings.names.iter().map(|name| {
        match name.strip_prefix('[') {
            Some(rest) => rest.split(']').next().unwrap_or_default().to_owned(),
            None => name
                .split(':')
                .next()
                .unwrap_or_default()
                .to_ascii_lowercase(),
        }
    }));
    names
}

/// What all connections share, of an instrument.
pub(crate) fn app(
    bench: Workbench,
    before: Before,
    settings: &Settings,
    names: Names,
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
        picture: Mutex::default(),
        patience: settings.limits.picture_patience,
        coming: Semaphore::new(crate::pictures::COMING),
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
        calibrated: Mutex::default(),
        left: Mutex::default(),
        present: Mutex::default(),
        names,
        demo,
        stops: AtomicU64::new(0),
        revision: AtomicU64::new(0),
        elsewhere: Mutex::new(None),
        rates: Mutex::new(Rates::new(
            settings.limits.requests_per_s,
            settings.limits.requests_at_once,
        )),
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
