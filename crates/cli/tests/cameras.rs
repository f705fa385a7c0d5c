//! The simulated microscope seen through cameras of our own: over the web, as a stream and image by image, and through a folder
//! that another program fills. Stage and nosepiece are reached over the driver protocol.

#![expect(clippy::print_stdout, reason = "a test may tell what it measured")]

mod common;

use common::{code, json, scopeservo, stderr};
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use scopeservo_drivers::emulator::camera::{CameraEmulator, EmulatedCamera, Sending, View};
use scopeservo_protocol::{Offer, listen};
use scopeservo_scope::{Clock, Devices, SystemClock};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Twin};
use std::fs;
use std::net::TcpListener;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

const DELAY: Duration = Duration::from_millis(80);

/// Drawing in real time takes a processor: one microscope at a time.
static ONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A microscope in real time: its twin, the address of its stage and nosepiece, and what its camera sees as JPEG.
fn bench() -> (Twin, String, View) {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let mut config = Config::realistic();
    (config.camera.width, config.camera.height) = (400, 300);
    config.optics.retain(|o| o.id.0 == "20x");
    let twin = Twin::new(config, Arc::new(Tissue::new(5)), 5, clock.clone()).unwrap();
    let camera = twin.camera();
    let view: View = Arc::new(move || {
        let frame = camera.grab().unwrap();
        let size = [frame.width, frame.height].map(|v| u32::try_from(v).unwrap());
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, 95)
            .encode(&frame.rgb8(), size[0], size[1], ExtendedColorType::Rgb8)
            .unwrap();
        bytes
    });
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let offer = Offer {
        name: "stage of the simulated microscope".into(),
        devices: Devices {
            camera: None,
            ..twin.devices()
        },
    };
    std::thread::spawn(move || listen(&listener, &offer, None, &|_| {}));
    (twin, address, view)
}

fn emulated(view: View, delay: Duration) -> CameraEmulator {
    CameraEmulator::serve(EmulatedCamera {
        view,
        period: Duration::from_millis(30),
        delay,
        sending: Sending::Chunked,
        login: None,
    })
    .unwrap()
}

fn describe(here: &Path, address: &str, camera: &str) {
    let text = format!(
        "name = \"bench\"\n[drivers.scope]\ntcp = \"{address}\"\n{camera}\n[devices]\nstage = \"scope\"\n\
         nosepiece = \"scope\"\ncamera = \"eye\"\n"
    );
    fs::write(here.join("scopeservo.toml"), text).unwrap();
}

/// A view is saved, the slide moved, and the view brought back.
fn works(here: &Path, twin: &Twin) {
    let saved = scopeservo(here, &["target", "save", "spot", "--focus", "--json"]);
    assert_eq!(code(&saved), 0, "{}", stderr(&saved));
    twin.centre_specimen([45.0, -30.0], 1.5);
    // Few views: this instrument's time is real.
    let two_step = ["calibrate", "--no-focus", "--method", "two-step", "--json"];
    let made = scopeservo(here, &two_step);
    assert_eq!(code(&made), 0, "{}", stderr(&made));
    let back = scopeservo(here, &["reposition", "spot", "--json"]);
    assert_eq!(code(&back), 0, "{}", stderr(&back));
    let back = json(&back);
    assert_eq!(back["verdict"], "arrived", "{back}");
    assert!(back["estimated_error_um"].as_f64().unwrap() < 1.5, "{back}");
    println!(
        "{}: back within {} um by its own measurement, {} moves, {} s",
        std::thread::current().name().unwrap_or_default(),
        back["estimated_error_um"],
        back["moves"],
        back["seconds"]
    );
}

#[test]
fn a_camera_that_streams_over_the_web_brings_the_view_back() {
    let _alone = alone();
    let (twin, address, view) = bench();
    let dir = tempfile::tempdir().unwrap();
    let emulator = emulated(view, DELAY);
    let camera = format!(
        "[drivers.eye.mjpeg.settings]\nurl = \"{}/stream\"\nlatency_ms = 250\nexposure.now_ms = 10",
        emulator.url()
    );
    describe(dir.path(), &address, &camera);
    let checked = scopeservo(dir.path(), &["doctor", "--allow-motion", "--json"]);
    assert_eq!(code(&checked), 0, "{}", json(&checked));
    works(dir.path(), &twin);
}

#[test]
fn too_short_a_latency_is_found_out_before_anything_leans_on_it() {
    let _alone = alone();
    let (_twin, address, view) = bench();
    let dir = tempfile::tempdir().unwrap();
    let emulator = emulated(view, Duration::from_millis(600));
    let camera = format!(
        "[drivers.eye.mjpeg.settings]\nurl = \"{}/stream\"\nlatency_ms = 100\nexposure.now_ms = 10",
        emulator.url()
    );
    describe(dir.path(), &address, &camera);
    let checked = scopeservo(dir.path(), &["doctor", "--allow-motion", "--json"]);
    assert_eq!(code(&checked), 3, "{}", stderr(&checked));
    let checked = json(&checked);
    let found = checked["findings"].as_array().unwrap();
    let stale = found
        .iter()
        .find(|f| f["name"] == "a grab after a move shows the new place")
        .unwrap();
    assert_eq!(stale["ok"], false, "{checked}");
}

#[test]
fn a_camera_that_is_asked_for_each_picture_brings_the_view_back() {
    let _alone = alone();
    let (twin, address, view) = bench();
    let dir = tempfile::tempdir().unwrap();
    let emulator = emulated(view, DELAY);
    let camera = format!(
        "[drivers.eye.snapshot.settings]\nurl = \"{}/shot\"\nstale_ms = 120\nexposure.now_ms = 10",
        emulator.url()
    );
    describe(dir.path(), &address, &camera);
    works(dir.path(), &twin);
}

#[test]
fn a_folder_that_another_program_fills_brings_the_view_back() {
    let _alone = alone();
    let (twin, address, view) = bench();
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("live");
    fs::create_dir(&folder).unwrap();
    let over = AtomicBool::new(false);
    std::thread::scope(|s| {
        s.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                // Another program writes as it likes: in place.
                fs::write(folder.join("live.jpg"), view()).unwrap();
                std::thread::sleep(Duration::from_millis(100));
            }
        });
        let camera = "[drivers.eye.folder]\npath = \"live\"\norder = \"newest\"\nlatency_ms = 100\nexposure_ms = 10";
        describe(dir.path(), &address, camera);
        let worked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            works(dir.path(), &twin);
        }));
        over.store(true, Ordering::Relaxed);
        worked.unwrap();
    });
}
