//! Pictures that people bring to the demonstration, and whoever would do harm by one.

mod common;

use common::{Bench, Client, HURRIED, PATIENCE, Said};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use serde_json::json;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A picture of blocks, each its own grey.
fn png(width: u32, height: u32, seed: u32) -> Vec<u8> {
    let grey = |k: u32| {
        let block = (k % width / 16, k / width / 16);
        let mixed = (block.0 * 7919 + block.1 * 104_729 + seed).wrapping_mul(2_654_435_761);
        (mixed >> 24) as u8
    };
    let samples: Vec<u8> = (0..width * height).map(grey).collect();
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(&samples, width, height, ExtendedColorType::L8)
        .unwrap();
    png
}

/// The checksum of a part of a PNG.
fn crc(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| match c & 1 {
            1 => 0xedb8_8320 ^ (c >> 1),
            _ => c >> 1,
        })
    };
    !bytes.iter().fold(!0, step)
}

/// The same, claiming another size.
fn claiming(mut png: Vec<u8>, [width, height]: [u32; 2]) -> Vec<u8> {
    png[16..20].copy_from_slice(&width.to_be_bytes());
    png[20..24].copy_from_slice(&height.to_be_bytes());
    let sum = crc(&png[12..29]);
    png[29..33].copy_from_slice(&sum.to_be_bytes());
    png
}

fn head(client: &Client, path: &str, kind: &str, length: usize) -> String {
    let cookie = client.cookie.clone().unwrap_or_default();
    format!(
        "PUT {path} HTTP/1.1\r\nhost: {}\r\ncontent-type: {kind}\r\ncookie: {cookie}\r\nconnection: close\r\ncontent-length: {length}\r\n\r\n",
        client.address
    )
}

fn bring(client: &Client, path: &str, kind: &str, bytes: &[u8]) -> Said {
    let mut request = head(client, path, kind, bytes.len()).into_bytes();
    request.extend(bytes);
    client.raw(&request)
}

fn at(name: &str) -> String {
    format!("/api/v1/pictures/{name}?um_per_px=0.5")
}

#[test]
fn a_picture_is_brought_laid_under_the_microscope_and_removed() {
    let bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    let picture = png(900, 700, 1);
    let said = bring(&visitor, &at("gland-1"), "image/png", &picture);
    assert_eq!(said.status, 200, "{}", said.json());
    let all = visitor.get("/api/v1/pictures").json();
    assert_eq!(all.as_array().unwrap().len(), 1);
    let told = &all[0];
    assert_eq!(
        (&told["name"], &told["size_px"], &told["um_per_px"]),
        (&json!("gland-1"), &json!([900, 700]), &json!(0.5))
    );
    assert_eq!(
        (&told["bytes"], &told["user"], &told["lies"]),
        (&json!(picture.len()), &json!("you"), &json!(false))
    );
    // Kept as it came, by its checksum.
    let sum = {
        let objects = bench.folder.path().join("scopeservo-data/objects");
        let folders = std::fs::read_dir(objects).unwrap().flatten();
        let files = folders
            .filter(|f| f.path().is_dir())
            .flat_map(|f| std::fs::read_dir(f.path()).unwrap().flatten());
        let mut same = files.filter(|f| std::fs::read(f.path()).unwrap() == picture);
        same.next().unwrap().file_name().into_string().unwrap()
    };
    assert!(sum.len() == 68 && sum.ends_with(".png"), "{sum}");
    // It lies there when that is said, and what lay there before when that is.
    let before = visitor.get("/api/v1/frame.jpg").body;
    let said = visitor.post("/api/v1/demo", &json!({"picture": "gland-1"}));
    assert_eq!(said.status, 200, "{}", said.json());
    let state = visitor.state();
    assert_eq!(state["demo"], json!({"slide": "in", "picture": "gland-1"}));
    assert_eq!(state["slide"], "gland-1");
    assert_eq!(visitor.get("/api/v1/pictures").json()[0]["lies"], true);
    assert_ne!(visitor.get("/api/v1/frame.jpg").body, before);
    let kept = visitor.with("DELETE", "/api/v1/pictures/gland-1", &[], "");
    assert_eq!((kept.status, kept.code().as_str()), (409, "in_use"));
    // A view of it is saved, on that slide.
    let saved = visitor.run(&json!({"job": "save_target", "name": "block", "focus": false}));
    assert_eq!(saved["error"], json!(null), "{saved}");
    assert_eq!(
        visitor.get("/api/v1/targets/block").json()["slide"],
        "gland-1"
    );
    let said = visitor.post("/api/v1/demo", &json!({"picture": null}));
    assert_eq!(said.status, 200);
    assert_eq!(visitor.state()["demo"]["picture"], json!(null));
    let gone = visitor.with("DELETE", "/api/v1/pictures/gland-1", &[], "");
    assert_eq!(gone.status, 200, "{}", gone.json());
    assert_eq!(visitor.get("/api/v1/pictures").json(), json!([]));
    let none = visitor.post("/api/v1/demo", &json!({"picture": "gland-1"}));
    assert_eq!((none.status, none.code().as_str()), (404, "no_picture"));
    let none = visitor.with("DELETE", "/api/v1/pictures/gland-1", &[], "");
    assert_eq!((none.status, none.code().as_str()), (404, "no_picture"));
}

#[test]
fn what_is_no_picture_or_claims_too_much_or_has_another_name_is_refused_and_nothing_is_kept() {
    let bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    let sound = png(300, 300, 2);
    let refused = |path: &str, kind: &str, bytes: &[u8], status: u16, code: &str| {
        let said = bring(&visitor, path, kind, bytes);
        assert_eq!(
            (said.status, said.code().as_str()),
            (status, code),
            "{path} {kind}"
        );
        said.json()["message"].as_str().unwrap().to_owned()
    };
    // A few bytes that would be 10 GB; one side of nothing; less than can be come back to.
    for size in [
        [100_000, 100_000],
        [4_000_000_000, 256],
        [256, 400_000],
        [100, 300],
    ] {
        let said = refused(
            &at("bomb"),
            "image/png",
            &claiming(sound.clone(), size),
            400,
            "bad_picture",
        );
        assert!(size[0] > 1 << 31 || said.contains("pixels"), "{said}");
        assert!(!said.contains("/tmp"), "{said}");
    }
    // As large as may be, with nothing in it.
    let hollow = claiming(sound.clone(), [8000, 8000]);
    refused(&at("hollow"), "image/png", &hollow, 400, "bad_picture");
    for cut in [0, 8, 40, sound.len() / 2, sound.len() - 20] {
        refused(&at("cut"), "image/png", &sound[..cut], 400, "bad_picture");
    }
    refused(
        &at("text"),
        "image/png",
        b"no picture at all, but some words",
        400,
        "bad_picture",
    );
    refused(
        &at("page"),
        "image/jpeg",
        b"<svg onload=alert(1)>",
        400,
        "bad_picture",
    );
    for kind in [
        "text/html",
        "application/json",
        "image/svg+xml",
        "multipart/form-data",
        "",
    ] {
        refused(&at("kind"), kind, &sound, 415, "not_a_picture");
    }
    // Names that lead elsewhere, or that no system has.
    for name in [
        "..%2F..%2Fetc%2Fpasswd",
        "..",
        ".hidden",
        "a%2Fb",
        "a%5Cb",
        "a%00b",
        "CON",
        "-rf",
        "%C3%A4",
    ] {
        let said = bring(&visitor, &at(name), "image/png", &sound);
        assert!(
            (said.status, said.code().as_str()) == (400, "bad_name") || said.status == 404,
            "{name}: {} {}",
            said.status,
            said.code()
        );
    }
    for scale in ["0", "-1", "nan", "inf", "51", "x", ""] {
        let path = format!("/api/v1/pictures/scale?um_per_px={scale}");
        refused(&path, "image/png", &sound, 400, "bad_input");
    }
    refused(
        "/api/v1/pictures/scale",
        "image/png",
        &sound,
        400,
        "bad_input",
    );
    // Larger than may be, said or not.
    let path = at("large");
    let said = visitor.raw(head(&visitor, &path, "image/png", 65 << 20).as_bytes());
    assert_eq!((said.status, said.code().as_str()), (413, "too_large"));
    assert_eq!(visitor.get("/api/v1/pictures").json(), json!([]));
    assert_eq!(
        bring(&visitor, &at("sound"), "image/png", &sound).status,
        200
    );
    let taken = bring(&visitor, &at("SOUND"), "image/png", &sound);
    assert_eq!((taken.status, taken.code().as_str()), (409, "taken"));
}

/// Begins to send a picture, and says no more.
fn begun(visitor: &Client, name: &str, picture: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(visitor.address).unwrap();
    let head = head(visitor, &at(name), "image/png", picture.len());
    stream.write_all(head.as_bytes()).unwrap();
    stream.write_all(&picture[..50]).unwrap();
    stream
}

#[test]
fn who_sends_for_ever_keeps_nobody_else_waiting_and_is_told() {
    let bench = Bench::demo(HURRIED);
    let visitor = bench.visitor();
    let sound = png(300, 300, 3);
    let third = || bring(&visitor, &at("three"), "image/png", &sound);
    let again = |said: &Said| {
        assert!(matches!(said.status, 200 | 429), "{}", said.head);
        visitor.with("DELETE", "/api/v1/pictures/three", &[], "");
    };
    // Two come: a third waits. Everything else is as ever. One that found no place at that moment is gone: then another one begins.
    let mut slow = Vec::new();
    let said = loop {
        slow.push(begun(&visitor, &format!("slow-{}", slow.len()), &sound));
        let said = third();
        if said.status == 429 {
            break said;
        }
        again(&said);
        assert!(slow.len() < 200);
    };
    assert_eq!(said.code(), "too_many");
    assert!(said.header("retry-after").is_some());
    assert_eq!(visitor.get("/api/v1/state").status, 200);
    // Who leaves makes room.
    drop(slow);
    let began = Instant::now();
    while third().status != 200 {
        assert!(began.elapsed() < PATIENCE, "no room");
    }
    let kept = visitor.get("/api/v1/pictures").json();
    assert_eq!(kept.as_array().unwrap().len(), 1, "{kept}");
    // Who stays is told when it took too long.
    let folder = Arc::new(TempDir::new().unwrap());
    let bench = Bench::set(HURRIED, true, folder, |settings| {
        settings.limits.picture_patience = Duration::from_millis(300);
    });
    let mut said = String::new();
    let mut slow = begun(&bench.visitor(), "one", &sound);
    slow.read_to_string(&mut said).unwrap();
    assert!(
        said.starts_with("HTTP/1.1 408") && said.contains("too_slow"),
        "{said}"
    );
}

#[test]
fn pictures_come_to_a_demonstration_only_and_from_whoever_may() {
    let bench = Bench::new(HURRIED, false, Arc::new(TempDir::new().unwrap()));
    let key = bench.key.clone().unwrap();
    let stranger = bench.stranger();
    let claim = json!({"key": key, "name": "anna", "password": "long enough"});
    let admin = stranger.with_cookie(&stranger.post("/api/v1/claim", &claim));
    let sound = png(300, 300, 4);
    let said = bring(&stranger, &at("mine"), "image/png", &sound);
    assert_eq!((said.status, said.code().as_str()), (401, "not_logged_in"));
    let said = bring(&admin, &at("mine"), "image/png", &sound);
    assert_eq!((said.status, said.code().as_str()), (409, "no_demo"));
    for said in [
        admin.get("/api/v1/pictures"),
        admin.with("DELETE", "/api/v1/pictures/mine", &[], ""),
        admin.post("/api/v1/demo", &json!({"picture": "mine"})),
        admin.post("/api/v1/demo", &json!({"picture": null})),
    ] {
        assert_eq!((said.status, said.code().as_str()), (409, "no_demo"));
    }
    let new = json!({"name": "vera", "password": "long enough", "role": "viewer"});
    assert_eq!(admin.post("/api/v1/users", &new).status, 200);
    let login = json!({"name": "vera", "password": "long enough"});
    let viewer = stranger.with_cookie(&stranger.post("/api/v1/login", &login));
    let said = bring(&viewer, &at("mine"), "image/png", &sound);
    assert_eq!((said.status, said.code().as_str()), (403, "role"));
}
