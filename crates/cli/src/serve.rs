//! `scopeservo serve`: the instrument at an address, until Ctrl-C.

use crate::answer::Answer;
use crate::args::ServeArgs;
use crate::bar;
use crate::error::{CliError, Code};
use crate::open_instrument::stop_on_interrupt;
use scopeservo_scope::CancelToken;
use scopeservo_server::{Before, Certificate, Limits, Server, Settings};
use scopeservo_setup::{Config, Consent, home_if_needed};
use scopeservo_station::jobs::{CalibrateInput, CalibrateJob};
use scopeservo_station::{MadeCalibration, MemoryJournal, Parts};
use scopeservo_workbench::{Console, Late, Workbench};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tempfile::TempDir;

/// The demonstration's instrument: the place under its view has tissue to look at.
const DEMO: &str = r#"name = "simulated microscope"

[drivers.twin.twin]
seed = 1
real_time = true
centre_um = [0, 0]

[devices]
stage = "twin"
camera = "twin"
nosepiece = "twin"
light = "twin"

[limits]
x_um = [-17000, 17000]
y_um = [-16000, 16000]
z_um = [-3000, 500]

[objective_change]
retract_z_um = -2000
margin_um = 50

[camera]
exposure_ms = 10
"#;

/// How often one who serves looks whether it is to end.
const LOOK: Duration = Duration::from_millis(50);

pub(crate) fn run(args: &ServeArgs, answer: &Answer) -> Result<bool, CliError> {
    // A demonstration lies in a folder that goes with the program.
    let (config, demo) = match args.demo {
        true => {
            let folder = TempDir::new().map_err(|e| CliError::Internal(e.to_string()))?;
            let path = folder.path().join("scopeservo.toml");
            (Config::parse(DEMO, &path)?, Some(folder))
        }
        false => (Config::read(&args.instrument.description.config)?, None),
    };
    let data = config.resolve(&config.data_folder);
    let settings = Settings {
        listen: args.listen,
        names: args.name.clone(),
        tls: certificate(args),
        proxies: args.proxy.clone(),
        limits: Limits::default(),
        demo: args.demo,
        folder: data.join("server"),
    };
    let before = Before::default();
    let consent = Consent {
        home: args.instrument.home,
        ask: before.questions.asker(),
        ask_immersion: before.questions.immersion_asker(),
    };
    let cancel = CancelToken::new();
    let stop = stop_on_interrupt(&cancel, answer);
    let shown = bar::spinner("opening the instrument".into());
    let bench = Workbench::open(config, &consent, cancel.clone(), |unread| {
        answer.or_warn::<()>(Err(unread));
    });
    shown.finish_and_clear();
    let bench = bench?;
    stop.hold(&bench.scope);
    home_if_needed(&bench.scope, &consent)?;
    if let Some(waits) = bench.waits()? {
        answer.warn(Code::Unfinished, waits);
    }
    let server = Server::start(bench, before, &settings)
        .map_err(|error| CliError::Usage(error.to_string()))?;
    say!(answer, "open {}", server.link());
    if let Some(outside) = server.outside() {
        say!(answer, "from other machines: {outside}");
    }
    if let Some(fingerprint) = server.fingerprint() {
        say!(
            answer,
            "the SHA-256 fingerprint of its certificate, to be compared with what a browser shows before you trust it:\n  {fingerprint}"
        );
    }
    say!(answer, "Ctrl-C ends it");
    let server = Arc::new(server);
    if let Some(folder) = &demo {
        teach(&server, folder.path());
    }
    while !cancel.is_cancelled() {
        std::thread::sleep(LOOK);
    }
    end(server);
    drop(demo);
    say!(answer, "ended: nothing moves");
    Ok(true)
}

fn certificate(args: &ServeArgs) -> Option<Certificate> {
    match (&args.tls_cert, &args.tls_key) {
        (Some(certificate), Some(key)) => Some(Certificate::Files {
            certificate: certificate.clone(),
            key: key.clone(),
        }),
        _ => args.tls.then_some(Certificate::Own),
    }
}

/// Whoever teaches it still lets go within so long.
const TEACHING: Duration = Duration::from_secs(20);

/// The last one who has it ends it, and waits for what is under way.
fn end(mut server: Arc<Server>) {
    let since = std::time::Instant::now();
    loop {
        match Arc::try_unwrap(server) {
            Ok(last) => return drop(last),
            Err(_) if since.elapsed() > TEACHING => return,
            Err(shared) => server = shared,
        }
        std::thread::sleep(LOOK);
    }
}

/// The demonstration's objectives are calibrated meanwhile, on a microscope of the same make whose minutes pass in seconds: so nobody waits for
/// that on the first way back.
fn teach(server: &Arc<Server>, folder: &Path) {
    let (server, folder) = (Arc::downgrade(server), folder.join("calibrated"));
    std::thread::spawn(move || {
        // Without it the first way back takes longer, and no more.
        let made = calibrated(&folder).unwrap_or_default();
        if let Some(server) = server.upgrade() {
            server.keep_calibrations(&made);
        }
    });
}

fn calibrated(folder: &Path) -> Result<Vec<MadeCalibration>, CliError> {
    let hurried = DEMO.replace("real_time = true", "real_time = false");
    let config = Config::parse(&hurried, &folder.join("scopeservo.toml"))?;
    let consent = Consent {
        home: true,
        ask: Arc::new(|_, _| false),
        ask_immersion: Arc::new(|_, _| false),
    };
    let bench = Workbench::open(config, &consent, CancelToken::new(), |_| {})?;
    let parts = Parts {
        journal: Arc::new(MemoryJournal::default()),
        ..Parts::default()
    };
    let console = Console::new(&bench.scope, parts, Late::LeftOut, |_| {});
    let session = console.session();
    let internal = |e: scopeservo_station::Refusal| CliError::Internal(e.to_string());
    let lease = session.take_lease("scopeservo", None).map_err(internal)?;
    let job = CalibrateJob::new(CalibrateInput::default());
    let job = session.start(&lease, job).map_err(internal)?;
    Ok(console.follow(job, |_| {})?.made)
}
