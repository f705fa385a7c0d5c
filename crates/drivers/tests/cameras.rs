//! Cameras on the web against an emulated one that delays, buffers, fails and disconnects.

mod common;

use common::Random;
use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use scopeservo_drivers::camera::http::{Login, decode_head};
use scopeservo_drivers::camera::multipart::Parts;
use scopeservo_drivers::camera::picture;
use scopeservo_drivers::camera::{
    ExposureSettings, MjpegSettings, SnapshotCamera, SnapshotSettings, mjpeg_camera,
};
use scopeservo_drivers::emulator::camera::{
    CameraEmulator, CameraFault, EmulatedCamera, Sending, View,
};
use scopeservo_scope::{Camera, ScopeError, SystemClock};
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

const DELAY: Duration = Duration::from_millis(30);
/// Longer than the emulator's delay, and what an image takes on its way on a loaded machine.
const LATENCY_MS: f64 = 100.0;
const TIMEOUT_MS: f64 = 400.0;

/// A grey that says which moment an image shows.
struct World(Arc<AtomicU8>);

impl World {
    fn new() -> (Self, View) {
        let shade = Arc::new(AtomicU8::new(0));
        let seen = shade.clone();
        let view: View = Arc::new(move || {
            let pixels = vec![seen.load(Ordering::SeqCst); 32 * 16];
            let mut bytes = Vec::new();
            JpegEncoder::new_with_quality(&mut bytes, 90)
                .encode(&pixels, 32, 16, ExtendedColorType::L8)
                .unwrap();
            bytes
        });
        (Self(shade), view)
    }
    fn set(&self, shade: u8) {
        self.0.store(shade, Ordering::SeqCst);
    }
}

fn emulated(view: View, sending: Sending) -> EmulatedCamera {
    EmulatedCamera {
        view,
        period: Duration::from_millis(8),
        delay: DELAY,
        sending,
        login: None,
    }
}

fn exposure() -> ExposureSettings {
    ExposureSettings {
        now_ms: 10.0,
        set_url: None,
        shortest_ms: None,
        longest_ms: None,
    }
}

fn clock() -> Arc<SystemClock> {
    Arc::new(SystemClock::new())
}

fn stream_settings(emulator: &CameraEmulator) -> MjpegSettings {
    MjpegSettings {
        url: format!("{}/stream", emulator.url()),
        latency_ms: LATENCY_MS,
        timeout_ms: TIMEOUT_MS,
        exposure: exposure(),
    }
}

fn shot_settings(emulator: &CameraEmulator) -> SnapshotSettings {
    SnapshotSettings {
        url: format!("{}/shot", emulator.url()),
        stale_ms: LATENCY_MS,
        timeout_ms: TIMEOUT_MS,
        exposure: exposure(),
    }
}

fn stream(emulator: &CameraEmulator) -> Result<Box<dyn Camera>, ScopeError> {
    let camera = mjpeg_camera(&stream_settings(emulator), None, clock())?;
    Ok(Box::new(camera))
}

fn shots(emulator: &CameraEmulator) -> Result<Box<dyn Camera>, ScopeError> {
    let camera = SnapshotCamera::connect(&shot_settings(emulator), None, clock())?;
    Ok(Box::new(camera))
}

type Opens = fn(&CameraEmulator) -> Result<Box<dyn Camera>, ScopeError>;
const BOTH: [(&str, Opens); 2] = [("stream", stream), ("shots", shots)];

/// Every grab shows the world as it is when it is asked for.
fn is_fresh(camera: &dyn Camera, world: &World) {
    let mut last = None;
    for shade in (0..250).step_by(25) {
        world.set(shade);
        let frame = camera.grab().unwrap();
        let seen = frame.rgb8()[0];
        assert!(seen.abs_diff(shade) <= 3, "{seen} for {shade}");
        assert!(last < Some(frame.sequence));
        last = Some(frame.sequence);
        assert_eq!((frame.width, frame.height), (32, 16));
    }
}

#[test]
fn pictures_are_fresh_however_the_camera_sends_them() {
    for sending in [Sending::Sized, Sending::Unsized, Sending::Chunked] {
        let (world, view) = World::new();
        let emulator = CameraEmulator::serve(emulated(view, sending)).unwrap();
        is_fresh(&*stream(&emulator).unwrap(), &world);
        is_fresh(&*shots(&emulator).unwrap(), &world);
    }
}

/// A part with a length.
fn sized(delimiter: &str, length: impl std::fmt::Display, picture: &[u8]) -> Vec<u8> {
    let head =
        format!("--{delimiter}\r\nContent-Type: image/jpeg\r\nContent-Length: {length}\r\n\r\n");
    [head.as_bytes(), picture, b"\r\n"].concat()
}

/// A part of a stream, of an image.
type Part = fn(&[u8]) -> Vec<u8>;

#[test]
fn streams_are_read_as_browsers_read_them() {
    const TOLD: &str = "HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame";
    let kinds: [(&str, Part); 9] = [
        ("HTTP/1.1 200 OK\r\nConnection: close", |p| {
            sized("frame", p.len(), p)
        }),
        (
            "HTTP/1.0 200\r\nno header\r\ncontent-type:multipart/x-mixed-replace;boundary=Stream",
            |p| sized("myboundary", p.len(), p),
        ),
        (
            "HTTP/1.1 200 OK\r\nContent-Length: 0\r\nContent-Type: multipart/x-mixed-replace; boundary=\"--frame\"",
            |p| sized("frame", p.len(), p),
        ),
        (TOLD, |p| sized("frame", 0, p)),
        (TOLD, |p| sized("frame", format!("{} bytes", p.len()), p)),
        (TOLD, |p| sized("frame", p.len() - 2, p)),
        (TOLD, |p| sized("frame", p.len() + 2, p)),
        (TOLD, |p| {
            let head = "--frame\nX-Tags\nContent-Type: image/jpeg\n\n";
            [head.as_bytes(), p, b"\n\n\n"].concat()
        }),
        (TOLD, |p| {
            let filled = [p, &[0xff; 8]].concat();
            sized("frame", filled.len(), &filled)
        }),
    ];
    for (head, part) in kinds {
        let (world, view) = World::new();
        let sending = Sending::Own { head, part };
        let emulator = CameraEmulator::serve(emulated(view, sending)).unwrap();
        let camera = stream(&emulator).unwrap_or_else(|e| panic!("{head}: {e}"));
        for shade in [0, 100, 200] {
            world.set(shade);
            let seen = camera.grab().unwrap_or_else(|e| panic!("{head}: {e}"));
            assert!(seen.rgb8()[0].abs_diff(shade) <= 3, "{head}");
        }
    }
    let (_world, view) = World::new();
    let head = "HTTP/1.1 200 OK\r\nContent-Type: text/html";
    let sending = Sending::Own {
        head,
        part: |_| b"<html>".to_vec(),
    };
    let emulator = CameraEmulator::serve(emulated(view, sending)).unwrap();
    let page = stream(&emulator).err().unwrap().to_string();
    assert!(page.contains("'text/html'"), "{page}");
}

#[test]
fn without_the_latency_the_emulated_cameras_do_show_old_pictures() {
    let (world, view) = World::new();
    let emulator = CameraEmulator::serve(emulated(view, Sending::Sized)).unwrap();
    let mut streams = stream_settings(&emulator);
    streams.latency_ms = 1.0;
    streams.exposure.now_ms = 1.0;
    let mut shots = shot_settings(&emulator);
    shots.stale_ms = 0.0;
    let cameras: [Box<dyn Camera>; 2] = [
        Box::new(mjpeg_camera(&streams, None, clock()).unwrap()),
        Box::new(SnapshotCamera::connect(&shots, None, clock()).unwrap()),
    ];
    for camera in cameras {
        let stale = (0..10).filter(|k| {
            world.set(k * 25);
            camera.grab().unwrap().rgb8()[0].abs_diff(k * 25) > 3
        });
        assert!(stale.count() > 0);
    }
}

#[test]
fn every_fault_is_told_in_time_and_the_camera_comes_back() {
    let faults = [
        CameraFault::Unplugged,
        CameraFault::Silence,
        CameraFault::HalfPictures,
        CameraFault::Garbage,
        CameraFault::Huge,
        CameraFault::Endless,
    ];
    std::thread::scope(|s| {
        for (kind, open) in BOTH {
            // In a stream a length that cannot be is passed over.
            let told = |f: &CameraFault| kind != "stream" || *f != CameraFault::Huge;
            for fault in faults.into_iter().filter(told) {
                s.spawn(move || is_told_and_comes_back(kind, open, fault));
            }
        }
    });
}

fn is_told_and_comes_back(kind: &str, open: Opens, fault: CameraFault) {
    let (world, view) = World::new();
    let emulator = CameraEmulator::serve(emulated(view, Sending::Sized)).unwrap();
    let camera = open(&emulator).unwrap();
    emulator.fault(fault);
    let started = Instant::now();
    let answer = camera.grab();
    let took = started.elapsed();
    assert!(
        matches!(
            answer,
            Err(ScopeError::Lost { .. } | ScopeError::Timeout { .. } | ScopeError::Device { .. })
        ),
        "{kind} {fault:?}: {answer:?}"
    );
    // The time for one answer, or its two halves, and whatever a busy machine adds.
    assert!(took < Duration::from_secs(30), "{kind} {fault:?}: {took:?}");
    // Opening it is told as well.
    assert!(open(&emulator).is_err(), "{kind} {fault:?}");
    emulator.fault(CameraFault::None);
    // What was on its way when the fault ended may still be bad.
    let back = (0..5).any(|_| camera.grab().is_ok());
    assert!(back, "{kind} {fault:?}");
    is_fresh(&*camera, &world);
}

#[test]
fn a_length_that_cannot_be_is_passed_over_in_a_stream() {
    let (world, view) = World::new();
    let emulator = CameraEmulator::serve(emulated(view, Sending::Sized)).unwrap();
    let camera = stream(&emulator).unwrap();
    emulator.fault(CameraFault::Huge);
    is_fresh(&*camera, &world);
}

#[test]
fn one_byte_at_a_time_is_a_picture_too() {
    let (world, view) = World::new();
    let emulator = CameraEmulator::serve(emulated(view, Sending::Unsized)).unwrap();
    emulator.fault(CameraFault::ByteByByte);
    is_fresh(&*stream(&emulator).unwrap(), &world);
    is_fresh(&*shots(&emulator).unwrap(), &world);
}

#[test]
fn the_exposure_is_set_over_its_address() {
    let (_, view) = World::new();
    let emulator = CameraEmulator::serve(emulated(view, Sending::Sized)).unwrap();
    let mut settings = stream_settings(&emulator);
    settings.exposure.set_url = Some(format!("{}/exposure?ms={{ms}}", emulator.url()));
    let said = |settings: &MjpegSettings| {
        let opened = mjpeg_camera(settings, None, clock());
        opened.err().unwrap().to_string()
    };
    let alone = said(&settings);
    assert!(alone.contains("belong together"), "{alone}");
    settings.exposure.shortest_ms = Some(0.5);
    settings.exposure.longest_ms = Some(100.0);
    let camera = mjpeg_camera(&settings, None, clock()).unwrap();
    let ms = Duration::from_millis;
    assert_eq!(camera.exposure(), Ok(ms(10)));
    assert_eq!(camera.set_exposure(ms(25)), Ok(ms(25)));
    assert!((emulator.exposure_ms() - 25.0).abs() < 1e-9);
    assert_eq!(camera.grab().unwrap().exposure, ms(25));
    assert!(camera.set_exposure(ms(200)).is_err());
    assert!((emulator.exposure_ms() - 25.0).abs() < 1e-9);
    // Refused by the camera: nothing is claimed.
    settings.exposure.set_url = Some(format!("{}/exposure?ms=about{{ms}}", emulator.url()));
    let camera = mjpeg_camera(&settings, None, clock()).unwrap();
    let refused = camera.set_exposure(ms(20)).unwrap_err().to_string();
    assert!(refused.contains("400"), "{refused}");
    assert_eq!(camera.exposure(), Ok(ms(10)));
    settings.exposure.set_url = Some(format!("{}/exposure", emulator.url()));
    let without = said(&settings);
    assert!(without.contains("must hold {us}, {ms} or {s}"), "{without}");
}

#[test]
fn a_camera_that_wants_to_know_who_asks_is_told() {
    let (_, view) = World::new();
    let mut camera = emulated(view, Sending::Sized);
    camera.login = Some("bWU6c2VjcmV0".into());
    let emulator = CameraEmulator::serve(camera).unwrap();
    let settings = stream_settings(&emulator);
    let login = |password: &str| Login {
        user: "me".into(),
        password: password.into(),
    };
    for (wrong, word) in [
        (None, "set user and password_file"),
        (Some(login("guess")), "is not the right one"),
    ] {
        let error = mjpeg_camera(&settings, wrong, clock()).err().unwrap();
        let error = error.to_string();
        assert!(error.contains(word), "{error}");
        assert!(!error.contains("guess"), "{error}");
    }
    mjpeg_camera(&settings, Some(login("secret")), clock()).unwrap();
}

#[test]
fn the_wrong_address_is_told_with_what_to_do() {
    let (_, view) = World::new();
    let emulator = CameraEmulator::serve(emulated(view, Sending::Sized)).unwrap();
    let said = |path: &str| {
        let mut settings = stream_settings(&emulator);
        settings.url = format!("{}{path}", emulator.url());
        let opened = mjpeg_camera(&settings, None, clock());
        opened.err().unwrap().to_string()
    };
    let shot = said("/shot");
    assert!(shot.contains("for single images use snapshot"), "{shot}");
    let nothing = said("/video");
    assert!(
        nothing.contains("404") && nothing.contains("no such path"),
        "{nothing}"
    );
    let mut settings = shot_settings(&emulator);
    settings.url = format!("{}/stream", emulator.url());
    // A stream has no end: it is given up.
    assert!(SnapshotCamera::connect(&settings, None, clock()).is_err());
}

/// What answers and streams are made of.
const PIECES: [&[u8]; 22] = [
    b"HTTP/1.1 200 OK\r\n",
    b"HTTP/1.0 404 \r\n",
    b"Content-Length: 3\r\n",
    b"content-length: 99999999999999999999\r\n",
    b"Transfer-Encoding: chunked\r\n",
    b"Content-Type: image/jpeg\r\n",
    b"\r\n",
    b"\n",
    b"--b",
    b"--b--",
    b"--",
    b"3\r\n",
    b"0\r\n",
    b"ffffffffffffffff\r\n",
    b"abc",
    b"\xff\xd8",
    b"\xff\xd9",
    b"\xff\xc4\x00\x00",
    b"\xff\xda",
    b"\x89PNG\r\n\x1a\n",
    b"II*\x00",
    b"\x00\x00",
];

#[test]
fn whatever_comes_and_however_it_is_cut_says_the_same_and_breaks_nothing() {
    let mut random = Random(11);
    let (mut bodies, mut pictures) = (0, 0);
    for _ in 0..20_000 {
        let mut bytes = match random.below(3) {
            0 => b"HTTP/1.1 200 OK\r\n".to_vec(),
            1 => b"--b\r\n".to_vec(),
            _ => Vec::new(),
        };
        for _ in 0..random.below(16) {
            bytes.extend_from_slice(random.of(&PIECES));
        }
        let cuts = [1 + random.below(7), bytes.len().max(1)];
        let body = |cut: usize| {
            let (mut head, length) = decode_head(&bytes).ok()??;
            let mut body = Vec::new();
            for mut chunk in bytes[length..].chunks(cut) {
                while !chunk.is_empty() && !head.body_is_whole() {
                    let used = head.take_body(chunk, &mut body).ok()?;
                    chunk = &chunk[used..];
                }
            }
            Some((body, head.body_is_whole()))
        };
        let parts = |cut: usize| {
            let mut parts = Parts::new("multipart/x-mixed-replace; boundary=b").ok()?;
            let mut all = Vec::new();
            for chunk in bytes.chunks(cut) {
                parts.feed().extend_from_slice(chunk);
                while let Some(picture) = parts.take().ok()? {
                    all.push(picture);
                }
            }
            Some(all)
        };
        assert_eq!(body(cuts[0]), body(cuts[1]), "{}", bytes.escape_ascii());
        assert_eq!(parts(cuts[0]), parts(cuts[1]), "{}", bytes.escape_ascii());
        bodies += usize::from(body(1).is_some_and(|(body, _)| !body.is_empty()));
        pictures += parts(1).map_or(0, |p| p.len());
        assert!(picture::decode(&bytes).is_err());
    }
    assert!(bodies > 100 && pictures > 100, "{bodies} {pictures}");
}
