//! Instruments of others, installed from their public packages: the same commands on them. `SCOPESERVO_PYTHON` names a Python that
//! has `python/` of this project and `python/tests/requirements.txt`; they are run with `--ignored`.

#![expect(clippy::print_stdout, reason = "what was measured is told")]

mod common;

use common::served::{Served, free_port, serve, serve_twin};
use common::{ok, stderr};
use scopeservo_protocol::Driver;
use scopeservo_scope::{Axis, Clock, Motion, Stage, StagePose, SystemClock};
use scopeservo_twin::specimen::{Specimen, Tissue};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

fn python() -> PathBuf {
    std::env::var_os("SCOPESERVO_PYTHON")
        .expect("SCOPESERVO_PYTHON names a Python with the drivers' libraries")
        .into()
}

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

const THEIR_NOSEPIECE: &str = "nosepiece = \"them\"\n";

/// A description; `more` begins with the nosepiece.
fn describe(folder: &Path, address: &str, more: &str) {
    let text = format!(
        "name = \"third party\"\n[drivers.them]\ntcp = \"{address}\"\n\
         [devices]\nstage = \"them\"\ncamera = \"them\"\n{more}"
    );
    fs::write(folder.join("scopeservo.toml"), text).unwrap();
}

fn stage(address: &str) -> Box<dyn Stage> {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let driver = Driver::connect(address, None).unwrap();
    driver.devices(&clock).unwrap().stage.unwrap()
}

fn place(address: &str) -> [f64; 2] {
    let at = stage(address).position().unwrap();
    [Axis::X, Axis::Y].map(|axis| at.si(axis).unwrap() * 1e6)
}

/// Moves away by so many um.
fn move_by(address: &str, by: [f64; 2]) {
    let stage = stage(address);
    let at = stage.position().unwrap();
    let to = [Axis::X, Axis::Y]
        .into_iter()
        .zip(by)
        .fold(StagePose::default(), |to, (axis, um)| {
            to.with_si(axis, at.si(axis).unwrap() + um * 1e-6)
        });
    stage.start_move(&to).unwrap();
    while stage.poll().unwrap() == Motion::Moving {
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Saves, moves away, comes back; returns how far off, um, the stage itself says it is.
fn there_and_back(folder: &Path, address: &str, by: [f64; 2]) -> f64 {
    let saved = place(address);
    move_by(address, by);
    let back = ok(folder, &["reposition", "spot", "--lambda", "0.5", "--json"]);
    assert_eq!(back["verdict"], "arrived", "{back}");
    let now = place(address);
    let off = f64::hypot(now[0] - saved[0], now[1] - saved[1]);
    println!(
        "{address}: back within {off:.3} um of the saved place, {} moves",
        back["moves"]
    );
    off
}

#[test]
#[ignore = "needs a Python with the packages of python/tests/requirements.txt: SCOPESERVO_PYTHON"]
fn micro_managers_beads_are_found_again() {
    let python = python();
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let them = serve(
        &python,
        &["-m", "scopeservo_driver.pymmcore", "--demo", "beads"],
        here,
    );
    describe(here, &them.address, THEIR_NOSEPIECE);
    assert_eq!(ok(here, &["doctor", "--json"])["ok"], true);
    let focus = ok(here, &["focus", "--json"]);
    assert!(
        focus["z_um"].as_f64().unwrap().abs() < 1.0,
        "the beads lie at z = 0: {focus}"
    );
    let made = ok(here, &["calibrate", "--json"]);
    let um_per_px = made["calibrations"][0]["calibration"]["um_per_px"]
        .as_f64()
        .unwrap();
    assert!((um_per_px - 1.0).abs() < 0.01, "{made}");
    ok(here, &["target", "save", "spot", "--json"]);
    let off = there_and_back(here, &them.address, [170.0, -95.0]);
    assert!(off < 1.5, "{off}");
}

#[test]
#[ignore = "needs a Python with the packages of python/tests/requirements.txt: SCOPESERVO_PYTHON"]
fn micro_managers_sample_is_found_again_across_two_objectives() {
    let python = python();
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let them = serve(
        &python,
        &["-m", "scopeservo_driver.pymmcore", "--demo", "sample"],
        here,
    );
    describe(
        here,
        &them.address,
        &format!("{THEIR_NOSEPIECE}[objective_change]\nretract_z_um = -90\nmargin_um = 0\n"),
    );
    assert_eq!(ok(here, &["doctor", "--json"])["ok"], true);
    let made = ok(here, &["calibrate", "--no-focus", "--json"]);
    for (made, um_per_px) in made["calibrations"]
        .as_array()
        .unwrap()
        .iter()
        .zip([1.0, 0.5, 0.25])
    {
        let measured = made["calibration"]["um_per_px"].as_f64().unwrap();
        assert!((measured / um_per_px - 1.0).abs() < 0.01, "{made}");
    }
    ok(
        here,
        &["target", "save", "spot", "--objective", "20x", "--json"],
    );
    let off = there_and_back(here, &them.address, [60.0, -40.0]);
    assert!(off < 0.75, "{off}");
}

/// A colour image of tissue for others to look at.
fn specimen(path: &Path, size: usize) {
    let half = size as f64 / 4.0;
    let patch = Tissue::new(9)
        .patch(1, [-half, half], [-half, half], 2)
        .expect("tissue is everywhere");
    let row = |r: usize| &patch.rgb[3 * ((r + 1) * patch.width + 1)..][..3 * size];
    let pixels: Vec<u8> = (0..size).flat_map(|r| row(r).iter().copied()).collect();
    image::RgbImage::from_raw(size as u32, size as u32, pixels)
        .expect("sizes agree")
        .save(path)
        .unwrap();
}

/// The same with python-microscope's simulated stage and camera, however they are reached.
fn drive_stage_aware_camera(here: &Path, them: &Served, nosepiece: &str) {
    describe(here, &them.address, nosepiece);
    assert_eq!(ok(here, &["doctor", "--json"])["ok"], true);
    let made = ok(here, &["calibrate", "--no-focus", "--json"]);
    let um_per_px = made["calibrations"][0]["calibration"]["um_per_px"]
        .as_f64()
        .unwrap();
    assert!((um_per_px - 1.0).abs() < 0.01, "{made}");
    ok(here, &["target", "save", "spot", "--json"]);
    let off = there_and_back(here, &them.address, [140.0, 90.0]);
    assert!(off < 1.5, "{off}");
    // It clips at its limits without a word: ours catch that, and nothing moves.
    let stage = stage(&them.address);
    let x = stage.info().axis(Axis::X).copied().unwrap();
    let before = stage.position().unwrap();
    let beyond = StagePose::default().with_si(Axis::X, x.max + 50e-6);
    assert!(stage.start_move(&beyond).is_err());
    assert_eq!(stage.position().unwrap(), before);
}

#[test]
#[ignore = "needs a Python with the packages of python/tests/requirements.txt: SCOPESERVO_PYTHON"]
fn python_microscopes_stage_aware_camera_is_driven_within_its_limits() {
    let python = python();
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    specimen(&here.join("specimen.png"), 2400);
    let args = [
        "-m",
        "scopeservo_driver.microscope",
        "--image",
        "specimen.png",
    ];
    drive_stage_aware_camera(here, &serve(&python, &args, here), THEIR_NOSEPIECE);
}

/// python-microscope's own device server; ended by a signal, so that it ends its devices.
#[cfg(unix)]
struct DeviceServer(Child);

#[cfg(unix)]
impl Drop for DeviceServer {
    fn drop(&mut self) {
        let _ = Command::new("kill").arg(self.0.id().to_string()).status();
        let _ = self.0.wait();
    }
}

#[cfg(unix)]
#[test]
#[ignore = "needs a Python with the packages of python/tests/requirements.txt: SCOPESERVO_PYTHON"]
fn and_so_it_is_behind_its_device_server() {
    let python = python();
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    specimen(&here.join("specimen.png"), 2400);
    let port = free_port();
    let setup = format!(
        "from microscope.device_server import device\n\
         from microscope.simulators.stage_aware_camera import simulated_setup_from_image\n\
         DEVICES = [device(simulated_setup_from_image, '127.0.0.1', {port}, conf={{'filepath': 'specimen.png'}})]\n"
    );
    fs::write(here.join("devices.py"), setup).unwrap();
    let server = Command::new(&python)
        .current_dir(here)
        .args(["-m", "microscope.device_server", "devices.py"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let _server = DeviceServer(server);
    let start = std::time::Instant::now();
    while std::net::TcpStream::connect(("127.0.0.1", port)).is_err() {
        assert!(
            start.elapsed() < Duration::from_secs(30),
            "no device server"
        );
        std::thread::sleep(Duration::from_millis(100));
    }
    let uri = |device: &str| format!("PYRO:{device}@127.0.0.1:{port}");
    let (stage, camera) = (uri("stage"), uri("camera"));
    let args = [
        "-m",
        "scopeservo_driver.microscope",
        "--stage",
        &stage,
        "--camera",
        &camera,
        "--exposure-ms",
        "1",
        "1000",
        "--positive-z",
        "apart",
    ];
    let one = "nosepiece = \"none\"\n[[objective]]\nid = \"10x\"\nmagnification = 100\nnumerical_aperture = 0.25\num_per_px = 1.0\n";
    drive_stage_aware_camera(here, &serve(&python, &args, here), one);
}

#[test]
#[ignore = "needs a Python with the packages of python/tests/requirements.txt: SCOPESERVO_PYTHON"]
fn camera_stage_mapping_measures_the_twin_as_we_do() {
    let python = python();
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let twin = serve_twin(here, &["--seed", "5"]);
    describe(
        here,
        &twin.address,
        &format!("{THEIR_NOSEPIECE}[objective_change]\nretract_z_um = -2000\nmargin_um = 0\n"),
    );
    let ours = ok(here, &["calibrate", "--objective", "10x", "--json"]);
    let ours = &ours["calibrations"][0]["calibration"]["full"];
    let number = |v: &serde_json::Value| v.as_f64().unwrap();
    // Micrometres of the stage per pixel of (column, row).
    let [[a, b], [c, d]] =
        [0, 1].map(|r| [0, 1].map(|k| number(&ours["stage_from_pixel"][r][k]) * 1e6));
    let (host, port) = twin.address.split_once(':').unwrap();
    let script = repository().join("python/tests/stage_mapping.py");
    let theirs = Command::new(&python)
        .args([script.to_str().unwrap(), host, port, "10x", "4"])
        .output()
        .unwrap();
    assert!(theirs.status.success(), "{}", stderr(&theirs));
    let runs: Vec<[[f64; 2]; 2]> = serde_json::from_slice(&theirs.stdout).unwrap();
    // Theirs takes (row, column) to the stage as a row vector.
    let ours = [[b, d], [a, c]];
    let n = runs.len() as f64;
    let mut worst: f64 = 0.0;
    for (i, row) in ours.iter().enumerate() {
        for (j, &value) in row.iter().enumerate() {
            let mean = runs.iter().map(|m| m[i][j]).sum::<f64>() / n;
            let variance = runs.iter().map(|m| (m[i][j] - mean).powi(2)).sum::<f64>() / (n - 1.0);
            println!(
                "{i}{j}: ours {value:+.5}, theirs {mean:+.5} +- {:.5} um/px",
                variance.sqrt()
            );
            worst = worst.max((mean - value).abs());
        }
    }
    // Of 2.2 um per pixel. Ours is known to 0.0004 to 0.0007 and theirs scatters by as much.
    assert!(worst < 0.004, "{worst}");
}

#[test]
#[ignore = "needs a Python with the packages of python/tests/requirements.txt: SCOPESERVO_PYTHON"]
fn the_driver_of_the_python_packages_page_passes_its_own_check() {
    let python = python();
    let dir = tempfile::tempdir().unwrap();
    let page = fs::read_to_string(repository().join("python/README.md")).unwrap();
    let (_, code) = page.split_once("```python\n").expect("a driver");
    let (code, after) = code.split_once("```").expect("its end");
    // As the page says.
    assert!(after.contains("scopeservo driver check -- python3 my_driver.py"));
    fs::write(dir.path().join("my_driver.py"), code).unwrap();
    let args = [
        "driver",
        "check",
        "--json",
        "--",
        python.to_str().unwrap(),
        "my_driver.py",
    ];
    let checked = ok(dir.path(), &args);
    assert_eq!(checked["ok"], true, "{checked}");
}
