//! One program at a time drives an instrument.

use scopeservo_scope::CancelToken;
use scopeservo_setup::{Config, Consent, Held, Opened, SetupError, open};
use std::io::Read;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;

const DEVICES: &str = "[devices]\nstage = \"main\"\ncamera = \"main\"\nnosepiece = \"main\"\n\
    [objective_change]\nanywhere = true\n";

fn opened(driver: &str, folder: &Path) -> Result<Opened, SetupError> {
    let text = format!("name = \"bench\"\n{driver}\n{DEVICES}");
    let config = Config::parse(&text, &folder.join("scopeservo.toml"))?;
    let consent = Consent {
        home: false,
        ask: Arc::new(|_, _| false),
        ask_immersion: Arc::new(|_, _| false),
    };
    open(&config, &consent, CancelToken::new())
}

#[test]
fn two_descriptions_of_one_device_are_one_instrument() {
    // Nobody answers there: what is asked is whether the device is taken, before it is called.
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    drop(listener);
    let held = Held::driver(&[], Some(&format!("localhost:{port}"))).unwrap();
    let driver = format!("[drivers.main]\ntcp = \"127.0.0.1:{port}\"");
    let elsewhere = tempfile::tempdir().unwrap();
    for folder in [Path::new(""), elsewhere.path()] {
        let error = opened(&driver, folder).err().unwrap();
        let process = Some(std::process::id());
        assert!(
            matches!(&error, SetupError::InUse { what, process: p } if what == "drivers.main" && *p == process),
            "{error}"
        );
        let said = error.to_string();
        assert!(
            said.contains(&format!("process {}", std::process::id())),
            "{said}"
        );
    }
    drop(held);
    let error = opened(&driver, elsewhere.path()).err().unwrap();
    assert!(matches!(error, SetupError::Driver(_)), "{error}");
}

#[test]
fn a_program_is_taken_by_where_it_lies_with_its_arguments() {
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("driver.sh");
    std::fs::write(&program, "").unwrap();
    let words = |port: &str| {
        [
            program.display().to_string(),
            "--port".into(),
            port.to_owned(),
        ]
    };
    let _held = Held::driver(&words("/dev/ttyUSB0"), None).unwrap();
    Held::driver(&words("/dev/ttyUSB1"), None).unwrap();
    let detour = format!("{}/./driver.sh", folder.path().display());
    let same = Held::driver(&[detour, "--port".into(), "/dev/ttyUSB0".into()], None);
    assert!(matches!(same, Err(SetupError::InUse { .. })), "{same:?}");
    // The same, as a description says it.
    let driver = "[drivers.main]\nprogram = [\"./driver.sh\", \"--port\", \"/dev/ttyUSB0\"]";
    let error = opened(driver, folder.path()).err().unwrap();
    assert!(matches!(error, SetupError::InUse { .. }), "{error}");
}

#[test]
fn simulated_microscopes_are_each_programs_own() {
    let twin = "[drivers.main.twin]\nobjectives = [\"10x\"]";
    let first = opened(twin, Path::new("")).unwrap();
    opened(twin, Path::new("")).unwrap();
    drop(first);
}

/// The name of the variable that makes [`a_lock_is_gone_with_the_process_that_held_it`] hold it.
const HOLD: &str = "SCOPESERVO_TEST_HOLD";

#[test]
fn a_lock_is_gone_with_the_process_that_held_it() {
    if let Ok(address) = std::env::var(HOLD) {
        // The other process: it holds until it is killed.
        let _held = Held::driver(&[], Some(&address)).unwrap();
        drop(std::io::Write::write_all(&mut std::io::stderr(), b"!"));
        loop {
            std::thread::park();
        }
    }
    let address = format!("device-{}.invalid:1", std::process::id());
    let mut other = Command::new(std::env::current_exe().unwrap())
        .args([
            "a_lock_is_gone_with_the_process_that_held_it",
            "--nocapture",
        ])
        .env(HOLD, &address)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut held = [0];
    other
        .stderr
        .as_mut()
        .unwrap()
        .read_exact(&mut held)
        .unwrap();
    let taken = Held::driver(&[], Some(&address));
    let process = Some(other.id());
    assert!(
        matches!(&taken, Err(SetupError::InUse { process: p, .. }) if *p == process),
        "{taken:?}"
    );
    other.kill().unwrap();
    other.wait().unwrap();
    Held::driver(&[], Some(&address)).unwrap();
}
