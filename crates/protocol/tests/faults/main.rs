//! Drivers that are silent, die, or talk nonsense: a typed error within the time of the page, and a stop on the way out.

mod answers;
mod frames;
mod hello;
mod programs;

use scopeservo_protocol::{Driver, DriverError, Patience};
use scopeservo_scope::{Axis, Clock, Devices, Frame, ScopeError, StagePose, SystemClock};
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

const HELLO: &str = r#"{"id":1,"ok":true,"protocol":1,"name":"odd","stage":{"name":"s","moves":"microscope","axes":[{"axis":"x","min_um":0,"max_um":1000,"repeatability_um":0}]},"camera":{"name":"c","width_px":8,"height_px":4,"channels":1,"bits":8,"min_exposure_ms":1,"max_exposure_ms":100},"nosepiece":{"name":"n","objectives":[{"id":"10x","magnification":100,"numerical_aperture":0.25,"um_per_px":1}]}}
"#;

/// What a peer does with each line that it reads, having said hello properly.
type Odd = fn(&str, &mut TcpStream) -> std::io::Result<bool>;

fn id(line: &str) -> u64 {
    let digits = line.split("\"id\":").nth(1).unwrap_or("");
    digits
        .split(|c: char| !c.is_ascii_digit())
        .next()
        .unwrap_or("")
        .parse()
        .unwrap_or(0)
}

/// A peer on a port of its own, which tells every line that it reads.
fn peer(hello: &'static str, odd: Odd) -> (String, Receiver<String>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let (tell, told) = channel();
    std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut input = BufReader::new(stream.try_clone().unwrap());
        let mut line = String::new();
        while input.read_line(&mut line).is_ok_and(|n| n > 0) {
            let first = line.contains("hello");
            let _ = tell.send(line.clone());
            let goes_on = match first {
                true => stream.write_all(hello.as_bytes()).map(|()| true),
                false => odd(&line, &mut stream),
            };
            if !goes_on.unwrap_or(false) {
                return;
            }
            line.clear();
        }
    });
    (address, told)
}

fn devices(address: &str) -> Devices {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let driver = Driver::connect(address, None).unwrap();
    driver.devices(&clock).unwrap()
}

/// The devices of a driver that is soon asked whether it is there while a frame is late.
fn devices_asked_soon(address: &str, frame: Duration) -> Devices {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let soon = Patience {
        late: Duration::from_millis(50),
        frame,
    };
    let driver = Driver::connect(address, None).unwrap().patient(soon);
    driver.devices(&clock).unwrap()
}

/// Asks for the position and tells the error and how long it took.
fn position(odd: Odd) -> (ScopeError, Duration, Receiver<String>) {
    let (address, told) = peer(HELLO, odd);
    let devices = devices(&address);
    let stage = devices.stage.unwrap();
    let start = Instant::now();
    let error = stage.position().unwrap_err();
    let took = start.elapsed();
    // Gone is gone: nobody waits again, and the first reason stays.
    if matches!(error, ScopeError::Lost { .. }) {
        assert_eq!(stage.poll(), Err(error.clone()));
    }
    (error, took, told)
}
