//! The G-code driver against firmware that others have simulated: OctoPrint's Virtual Marlin. `SCOPESERVO_OCTOPRINT` names a Python of an
//! environment of its own that has `python/tests/octoprint_requirements.txt`; it is run with `--ignored`.

mod common;

use common::{pose, tcp, wait};
use scopeservo_drivers::gcode::{GcodeSettings, GcodeStage};
use scopeservo_scope::{Axis, Motion, ScopeError, Stage};
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// The peer, ended with the test.
struct Peer(Child);

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Virtual Marlin with these settings of its own, and where it listens.
fn marlin(settings: &[&str]) -> (Peer, String) {
    let python = std::env::var_os("SCOPESERVO_OCTOPRINT");
    let python = python.expect("SCOPESERVO_OCTOPRINT names a Python with OctoPrint");
    let free = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = free.local_addr().unwrap().to_string();
    drop(free);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../python/tests/virtual_marlin.py");
    let set = settings.iter().flat_map(|s| ["--set", s]);
    let mut peer = Command::new(python)
        .arg(script)
        .args(["--listen", &address])
        .args(set)
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(peer.stderr.take().unwrap());
    let peer = Peer(peer);
    let mut line = String::new();
    while !line.contains("listening on") {
        line.clear();
        let more = said.read_line(&mut line).unwrap();
        assert!(more > 0, "it ended before it listened");
    }
    // What it says later must not fill the pipe.
    std::thread::spawn(move || std::io::copy(&mut said, &mut std::io::sink()));
    (peer, address)
}

/// As Marlin says where it is.
const MARLINS: &str = r#"m114FormatString="X:{x:.2f} Y:{y:.2f} Z:{z:.2f} E:{e[current]:.2f} Count X:{a} Y:{b} Z:{c}""#;

fn connect(address: &str) -> Result<GcodeStage, ScopeError> {
    let settings = r#"{
        "kinematics": "specimen_xy_on_top", "positive_z": "apart", "speed_um_per_s": 20000, "needs_homing": false,
        "boot_ms": 10000, "reply_timeout_ms": 5000,
        "axes": [
            {"axis": "x", "letter": "X", "min_um": -10000, "max_um": 10000, "steps_per_mm": 100, "repeatability_um": 10},
            {"axis": "y", "letter": "Y", "min_um": -10000, "max_um": 10000, "steps_per_mm": 100, "repeatability_um": 10}
        ]
    }"#;
    let settings: GcodeSettings = serde_json::from_str(settings).unwrap();
    GcodeStage::connect(tcp(address), &settings)
}

#[test]
#[ignore = "needs a Python with python/tests/octoprint_requirements.txt: SCOPESERVO_OCTOPRINT"]
fn virtual_marlin_is_driven_and_asks_again_for_what_it_did_not_get() {
    let (_peer, address) = marlin(&[
        MARLINS,
        "sendBusy=true",
        "busyInterval=0.2",
        r#"simulated_errors=["20:resend", "30:checksum_mismatch", "40:resend"]"#,
    ]);
    let stage = connect(&address).unwrap();
    assert!(stage.info().name.contains("Virtual Marlin"));
    for k in 0..12 {
        let mm = f64::from(k % 4) - 1.5;
        let to = pose(Axis::X, mm * 1e-3).with_si(Axis::Y, -0.5 * mm * 1e-3);
        stage.start_move(&to).unwrap();
        assert_eq!(wait(&stage), Motion::Settled);
        let at = stage.position().unwrap();
        for axis in [Axis::X, Axis::Y] {
            let off = at.si(axis).unwrap() - to.si(axis).unwrap();
            assert!(off.abs() < 10e-6, "{axis}: {off}");
        }
    }
    // It would take any place, and say ok.
    let before = stage.position().unwrap();
    let far = stage.start_move(&pose(Axis::X, 99.999));
    assert!(matches!(far, Err(ScopeError::OutsideLimits { .. })));
    assert_eq!(stage.position().unwrap(), before);
    stage.stop().unwrap();
}

#[test]
#[ignore = "needs a Python with python/tests/octoprint_requirements.txt: SCOPESERVO_OCTOPRINT"]
fn positions_of_virtual_marlins_own_form_are_refused_and_shown() {
    for (set, shown) in [
        (vec![], "Count: A:0 B:0 C:0'"),
        (
            vec![r#"m114FormatString="X:{x} Y:{y} Z:{z} E:{e[current]}""#],
            "'X:0.0 Y:0.0 Z:0.0 E:0.0'",
        ),
        (
            vec![r#"m114FormatString="X={x} Y={y}""#],
            "'ok X=0.0 Y=0.0'",
        ),
    ] {
        let (_peer, address) = marlin(&set);
        let said = connect(&address).err().unwrap().to_string();
        assert!(said.contains(shown), "{shown}: {said}");
    }
}
