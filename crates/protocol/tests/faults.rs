//! Drivers that are silent, die, or talk nonsense: a typed error within the time of the page, and a stop on the way out.

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

#[test]
fn each_kind_of_nonsense_is_a_lost_driver_at_once() {
    let kinds: [(&str, Odd); 9] = [
        ("no JSON object", |_, s| {
            s.write_all(b"garbage \xff\xfe\n").map(|()| true)
        }),
        ("longer than", |_, s| {
            s.write_all(&vec![b'x'; 100_000]).map(|()| true)
        }),
        ("middle", |_, s| s.write_all(b"{\"id\":2,").map(|()| false)),
        ("it ended", |_, _| Ok(false)),
        ("nobody asked", |_, s| {
            s.write_all(b"{\"id\":99,\"ok\":true}\n").map(|()| true)
        }),
        ("neither ok nor error", |l, s| {
            writeln!(s, "{{\"id\":{}}}", id(l)).map(|()| true)
        }),
        ("nonsense", |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":true}}", id(l)).map(|()| true)
        }),
        ("nonsense", |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":true,\"x_um\":\"far\"}}", id(l)).map(|()| true)
        }),
        ("104857600 bytes where 0", |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":true,\"bytes\":104857600}}", id(l)).map(|()| true)
        }),
    ];
    for (word, odd) in kinds {
        let (error, took, told) = position(odd);
        assert!(
            matches!(
                error,
                ScopeError::Lost {
                    device: "stage",
                    ..
                }
            ),
            "{error:?}"
        );
        assert!(error.to_string().contains(word), "{word}: {error}");
        // The time for an answer would be the reason otherwise.
        drop((took, told));
    }
}

#[test]
fn a_silent_driver_is_given_up_in_time_and_told_to_stop() {
    let (error, took, told) = position(|_, _| Ok(true));
    assert!(
        error
            .to_string()
            .contains("did not answer 'position' within 2 s"),
        "{error}"
    );
    assert!(took >= Duration::from_millis(1900), "{took:?}");
    let said: Vec<String> = told.iter().collect();
    assert!(said.iter().any(|l| l.contains("stop")), "{said:?}");
    assert!(said.last().unwrap().contains("bye"), "{said:?}");
}

#[test]
fn one_byte_at_a_time_is_slow_and_right() {
    let (address, _told) = peer(HELLO, |line, stream| {
        let reply = format!("{{\"id\":{},\"ok\":true,\"x_um\":12.5}}\r\n", id(line));
        for byte in reply.bytes() {
            stream.write_all(&[byte])?;
            std::thread::sleep(Duration::from_micros(300));
        }
        Ok(true)
    });
    let at = devices(&address).stage.unwrap().position().unwrap();
    assert!((at.si(Axis::X).unwrap() - 12.5e-6).abs() < 1e-15);
}

#[test]
fn refusals_keep_their_kind_and_words() {
    for (code, kind) in [
        ("busy", ScopeError::Busy { device: "stage" }),
        ("not_homed", ScopeError::NotHomed { device: "stage" }),
        (
            "refused",
            ScopeError::Refused {
                device: "stage",
                detail: "the lid is open".into(),
            },
        ),
        (
            "fault",
            ScopeError::Device {
                device: "stage",
                detail: "the lid is open".into(),
            },
        ),
    ] {
        // A peer function has no captures: the code goes round through a static.
        static CODE: std::sync::Mutex<String> = std::sync::Mutex::new(String::new());
        *CODE.lock().unwrap() = code.into();
        let (address, _told) = peer(HELLO, |line, stream| {
            let code = CODE.lock().unwrap().clone();
            let id = id(line);
            writeln!(
                stream,
                "{{\"id\":{id},\"error\":\"{code}\",\"message\":\"the lid is open\"}}"
            )
            .map(|()| true)
        });
        let stage = devices(&address).stage.unwrap();
        let to = StagePose::default().with_si(Axis::X, 1e-5);
        assert_eq!(stage.start_move(&to), Err(kind));
    }
}

/// Answers everything as asked, frames with `age_ms` and `bytes` of its own.
fn camera(line: &str, stream: &mut TcpStream, frame: &str, data: &[u8]) -> std::io::Result<bool> {
    let id = id(line);
    if !line.contains("grab") {
        writeln!(stream, "{{\"id\":{id},\"ok\":true,\"exposure_ms\":10}}")?;
        return Ok(true);
    }
    writeln!(
        stream,
        "{{\"id\":{id},\"ok\":true,\"channels\":1,\"bits\":8,\"exposure_ms\":10,\"sequence\":1,{frame}}}"
    )?;
    stream.write_all(data)?;
    Ok(data.len() == 32)
}

#[test]
fn frames_that_are_stale_cut_or_of_another_shape_are_refused() {
    let grab = |odd: Odd| {
        let (address, _told) = peer(HELLO, odd);
        devices(&address).camera.unwrap().grab()
    };
    let good = grab(|l, s| {
        camera(
            l,
            s,
            "\"width_px\":8,\"height_px\":4,\"age_ms\":0.01,\"bytes\":32",
            &[7; 32],
        )
    });
    assert_eq!(
        good.unwrap().samples,
        scopeservo_scope::Samples::U8(vec![7; 32])
    );
    let said = |odd: Odd| grab(odd).unwrap_err().to_string();
    let stale = said(|l, s| {
        camera(
            l,
            s,
            "\"width_px\":8,\"height_px\":4,\"age_ms\":500,\"bytes\":32",
            &[7; 32],
        )
    });
    assert!(stale.contains("before it was asked for"), "{stale}");
    let shape = said(|l, s| {
        camera(
            l,
            s,
            "\"width_px\":4,\"height_px\":8,\"age_ms\":0,\"bytes\":32",
            &[7; 32],
        )
    });
    assert!(shape.contains("agreed on"), "{shape}");
    let cut = said(|l, s| {
        camera(
            l,
            s,
            "\"width_px\":8,\"height_px\":4,\"age_ms\":0,\"bytes\":32",
            &[7; 20],
        )
    });
    assert!(cut.contains("middle"), "{cut}");
    let huge = said(|l, s| {
        camera(
            l,
            s,
            "\"width_px\":8,\"height_px\":4,\"age_ms\":0,\"bytes\":104857600",
            &[7; 32],
        )
    });
    assert!(huge.contains("104857600 bytes where 32"), "{huge}");
    let negative = said(|l, s| {
        camera(
            l,
            s,
            "\"width_px\":8,\"height_px\":4,\"age_ms\":-1e300,\"bytes\":32",
            &[7; 32],
        )
    });
    assert!(negative.contains("nonsense"), "{negative}");
}

#[test]
fn a_wrong_hello_says_what_is_wrong() {
    let said = |hello: &'static str| {
        let (address, _told) = peer(hello, |_, _| Ok(true));
        Driver::connect(&address, None)
            .err()
            .expect(hello)
            .to_string()
    };
    let version = said("{\"id\":1,\"ok\":true,\"protocol\":2,\"name\":\"new\"}\n");
    assert!(version.contains("version 2"), "{version}");
    let unsupported =
        said("{\"id\":1,\"error\":\"unsupported\",\"message\":\"I speak version 3\"}\n");
    assert!(unsupported.contains("I speak version 3"), "{unsupported}");
    let other = said("HTTP/1.1 400 Bad Request\r\n\r\n");
    assert!(other.contains("no JSON object"), "{other}");
    let nameless = said("{\"id\":1,\"ok\":true,\"protocol\":1}\n");
    assert!(nameless.contains("name"), "{nameless}");
    let nobody = Driver::connect("127.0.0.1:1", None).err().unwrap();
    assert!(matches!(nobody, DriverError::Connect { .. }), "{nobody}");
    let none = Driver::spawn("/no/such/driver", &[]).err().unwrap();
    assert!(matches!(none, DriverError::Spawn { .. }), "{none}");
    let (address, _told) = peer(
        "{\"id\":1,\"ok\":true,\"protocol\":1,\"name\":\"n\",\"stage\":{\"name\":\"s\",\"moves\":\"microscope\",\"axes\":[]}}\n",
        |_, _| Ok(true),
    );
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let impossible = Driver::connect(&address, None)
        .unwrap()
        .devices(&clock)
        .err()
        .unwrap();
    assert!(impossible.to_string().contains("no axes"), "{impossible}");
}

#[test]
fn a_stop_overtakes_a_grab() {
    // The peer answers nothing but stops until it has seen one.
    let (address, _told) = peer(HELLO, |line, stream| {
        if line.contains("exposure") {
            writeln!(
                stream,
                "{{\"id\":{},\"ok\":true,\"exposure_ms\":10}}",
                id(line)
            )?;
        } else if line.contains("stop") {
            writeln!(stream, "{{\"id\":{},\"ok\":true}}", id(line))?;
        }
        Ok(true)
    });
    let Devices { stage, camera, .. } = devices_asked_soon(&address, Duration::from_secs(600));
    let (stage, camera) = (stage.unwrap(), camera.unwrap());
    let grabbing = std::thread::spawn(move || camera.grab());
    std::thread::sleep(Duration::from_millis(100));
    stage.stop().unwrap();
    assert!(!grabbing.is_finished());
    drop(stage);
    // The frame is late, and whether it is there it does not say either: it is given up.
    let error = grabbing.join().unwrap().unwrap_err();
    assert!(error.to_string().contains("'grab'"), "{error}");
}

/// What a peer answers to the exposure and, so long as `there`, to the place; and the id of a grab that it was asked for.
fn slow(line: &str, stream: &mut TcpStream, there: bool) -> std::io::Result<Option<u64>> {
    let id = id(line);
    if line.contains("exposure") {
        writeln!(stream, "{{\"id\":{id},\"ok\":true,\"exposure_ms\":10}}")?;
    } else if line.contains("position") && there {
        writeln!(stream, "{{\"id\":{id},\"ok\":true,\"x_um\":0}}")?;
    }
    Ok(line.contains("grab").then_some(id))
}

/// Asks such a driver for a frame, and what was said to it.
fn late_frame(odd: Odd, frame: Duration) -> (Result<Frame, ScopeError>, Vec<String>) {
    let (address, told) = peer(HELLO, odd);
    let devices = devices_asked_soon(&address, frame);
    let frame = devices.camera.as_ref().unwrap().grab();
    drop(devices);
    (frame, told.iter().collect())
}

#[test]
fn a_driver_that_is_slow_with_a_frame_and_there_is_waited_for() {
    // It sends the frame once it has been asked three times where the stage is, each time after the frame was late.
    static ASKED: std::sync::Mutex<(u64, u32)> = std::sync::Mutex::new((0, 0));
    let odd: Odd = |line, stream| {
        let mut asked = ASKED.lock().unwrap();
        asked.1 += u32::from(line.contains("position"));
        if line.contains("position") && asked.1 == 3 {
            // Before the place, so that nobody asks a fourth time.
            let grab = format!("{{\"id\":{},\"call\":\"grab\"}}", asked.0);
            let shape = "\"width_px\":8,\"height_px\":4,\"age_ms\":0.01,\"bytes\":32";
            camera(&grab, stream, shape, &[7; 32])?;
        }
        if let Some(id) = slow(line, stream, true)? {
            asked.0 = id;
        }
        Ok(true)
    };
    let (frame, said) = late_frame(odd, Duration::from_secs(60));
    let samples = scopeservo_scope::Samples::U8(vec![7; 32]);
    assert_eq!(frame.unwrap().samples, samples);
    // Nothing was stopped before the end, and nothing but the place was asked for.
    let calls = [
        "hello", "exposure", "grab", "position", "position", "position",
    ];
    let last = ["stop", "bye"];
    assert_eq!(said.len(), calls.len() + last.len(), "{said:?}");
    for (line, call) in said.iter().zip(calls.iter().chain(&last)) {
        assert!(line.contains(call), "{call}: {said:?}");
    }
}

#[test]
fn a_frame_that_never_comes_is_given_up_in_time_by_a_driver_that_is_there_and_at_once_by_one_that_is_not()
 {
    let there: Odd = |line, stream| slow(line, stream, true).map(|_| true);
    let (frame, said) = late_frame(there, Duration::from_millis(300));
    let error = frame.unwrap_err().to_string();
    assert!(error.contains("'grab' within 0.31 s"), "{error}");
    assert!(said.iter().any(|l| l.contains("position")), "{said:?}");
    let silent: Odd = |line, stream| slow(line, stream, false).map(|_| true);
    let (frame, said) = late_frame(silent, Duration::from_secs(600));
    let error = frame.unwrap_err().to_string();
    let reason = "'grab', and then not 'position' within 2 s";
    assert!(error.contains(reason), "{error}");
    let asked = said.iter().filter(|l| l.contains("position")).count();
    assert_eq!(asked, 1, "silence is not asked twice: {said:?}");
    let gone: Odd = |line, stream| Ok(slow(line, stream, true)?.is_none());
    let (frame, _) = late_frame(gone, Duration::from_secs(600));
    let error = frame.unwrap_err().to_string();
    assert!(error.contains("it ended"), "{error}");
}

#[cfg(unix)]
#[test]
fn a_driver_that_is_killed_is_noticed_and_one_that_hangs_is_ended() {
    let script = |then: &str| {
        let hello = HELLO.trim_end();
        vec![
            "-c".to_owned(),
            format!("read line; echo '{hello}'; {then}"),
        ]
    };
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let killed = Driver::spawn("sh", &script("read line; kill -9 $$")).unwrap();
    let stage = killed.devices(&clock).unwrap().stage.unwrap();
    let error = stage.position().unwrap_err();
    assert!(error.to_string().contains("it ended"), "{error}");

    // It tells its number, then neither reads nor ends by itself.
    let folder = std::env::temp_dir().join(format!("scopeservo-hangs-{}", std::process::id()));
    let hangs = format!(
        "echo $$ > '{}'; while :; do sleep 1; done",
        folder.display()
    );
    let driver = Driver::spawn("sh", &script(&hangs)).unwrap();
    let mut number = String::new();
    while !number.ends_with('\n') {
        std::thread::sleep(Duration::from_millis(10));
        number = std::fs::read_to_string(&folder).unwrap_or_default();
    }
    drop(driver);
    std::fs::remove_file(&folder).unwrap();
    assert!(!runs(number.trim()), "{number} still runs");
}

#[test]
fn answers_that_cannot_be_end_the_connection_whichever_call_they_are_to() {
    type Ask = fn(&Devices) -> Result<(), ScopeError>;
    let position: Ask = |d| d.stage.as_ref().unwrap().position().map(drop);
    let motion: Ask = |d| d.stage.as_ref().unwrap().poll().map(drop);
    let objective: Ask = |d| d.nosepiece.as_ref().unwrap().current().map(drop);
    let exposure: Ask = |d| d.camera.as_ref().unwrap().exposure().map(drop);
    let cases: [(Ask, Odd); 12] = [
        (position, |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":\"true\",\"x_um\":1}}", id(l)).map(|()| true)
        }),
        (position, |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":true,\"x_um\":null}}", id(l)).map(|()| true)
        }),
        (position, |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":true,\"x_um\":NaN}}", id(l)).map(|()| true)
        }),
        (position, |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":true,\"x_um\":1e999}}", id(l)).map(|()| true)
        }),
        (position, |l, s| {
            let deep = "[".repeat(30_000);
            writeln!(s, "{{\"id\":{},\"ok\":true,\"a\":{deep}}}", id(l)).map(|()| true)
        }),
        (position, |_, s| {
            // Never a line end, for as long as somebody listens.
            while s.write_all(&[b'x'; 4096]).is_ok() {}
            Ok(false)
        }),
        (motion, |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":true,\"motion\":\"flying\"}}", id(l)).map(|()| true)
        }),
        (objective, |l, s| {
            let reply = "\"objective\":\"66x\",\"motion\":\"settled\"";
            writeln!(s, "{{\"id\":{},\"ok\":true,{reply}}}", id(l)).map(|()| true)
        }),
        (objective, |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":true,\"objective\":3}}", id(l)).map(|()| true)
        }),
        (exposure, |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":true,\"exposure_ms\":1e12}}", id(l)).map(|()| true)
        }),
        (exposure, |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":true,\"exposure_ms\":NaN}}", id(l)).map(|()| true)
        }),
        (exposure, |l, s| {
            writeln!(s, "{{\"id\":{},\"ok\":true,\"exposure_ms\":-1}}", id(l)).map(|()| true)
        }),
    ];
    for (k, (ask, odd)) in cases.into_iter().enumerate() {
        let (address, _told) = peer(HELLO, odd);
        let devices = devices(&address);
        let error = ask(&devices).expect_err("that is no answer");
        let fault = error.kind() == scopeservo_scope::ErrorKind::Fault;
        assert!(fault, "case {k}: {error:?}");
    }
}

#[test]
fn a_hello_that_cannot_be_is_refused_with_what_is_wrong() {
    let said = |from: &str, to: &str| {
        let hello: &'static str = Box::leak(HELLO.replacen(from, to, 1).into_boxed_str());
        assert_ne!(hello, HELLO, "{from}");
        let (address, _told) = peer(hello, |_, _| Ok(true));
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        let opened = Driver::connect(&address, None).and_then(|d| d.devices(&clock).map(drop));
        opened.expect_err(to).to_string()
    };
    for (from, to, word) in [
        ("\"min_um\":0", "\"min_um\":5000", "below"),
        ("\"min_um\":0", "\"min_um\":NaN", "no JSON object"),
        ("\"max_um\":1000", "\"max_um\":1e999", "no JSON object"),
        (
            "\"repeatability_um\":0",
            "\"repeatability_um\":-1",
            "negative",
        ),
        (
            "\"repeatability_um\":0",
            "\"repeatability_um\":600",
            "half-width",
        ),
        (
            "\"repeatability_um\":0",
            "\"repeatability_um\":1e9",
            "half-width",
        ),
        ("\"axis\":\"x\"", "\"axis\":\"z\"", "positive_z"),
        ("\"um_per_px\":1}", "\"um_per_px\":-1}", "um"),
        ("\"width_px\":8", "\"width_px\":0", "frames"),
        (
            "\"min_exposure_ms\":1",
            "\"min_exposure_ms\":1e9",
            "exposures",
        ),
        ("\"protocol\":1", "\"protocol\":2", "version 2"),
    ] {
        let said = said(from, to);
        assert!(said.contains(word), "{to}: {said}");
    }
}

#[test]
fn what_a_driver_says_is_shown_and_commands_no_terminal() {
    // ESC, a title and a bell, and what turns text round; and 50 kB of a name.
    let codes = "\\u001b[2J\\u001b]0;mine\\u0007\\u202e";
    let named = |from: &str, to: &str| {
        let hello: &'static str = Box::leak(HELLO.replacen(from, to, 1).into_boxed_str());
        assert_ne!(hello, HELLO, "{from}");
        hello
    };
    for (from, name) in [
        ("\"name\":\"odd\"", format!("odd{codes}")),
        ("\"name\":\"s\"", "N".repeat(50_000)),
        ("\"name\":\"c\"", format!("{codes}c")),
    ] {
        let (address, _told) = peer(named(from, &format!("\"name\":\"{name}\"")), |_, _| {
            Ok(true)
        });
        let driver = Driver::connect(&address, None).unwrap();
        let said = format!("{:?}", driver.hello());
        assert!(
            said.chars().all(|c| !c.is_control() && c != '\u{202e}'),
            "{said}"
        );
        assert!(said.len() < 2_000, "{}", said.len());
    }
    // In what it refuses, and in its words for it.
    let (error, _, _told) = position(|line, stream| {
        let id = id(line);
        writeln!(
            stream,
            "{{\"id\":{id},\"error\":\"purple\\u001b[2J\",\"message\":\"\\u001b[31mred\\n\"}}"
        )?;
        Ok(false)
    });
    assert!(error.to_string().contains(r"\u{1b}[31mred\n"), "{error}");
    let (error, _, _told) = position(|line, stream| {
        let id = id(line);
        writeln!(stream, "{{\"id\":{id},\"error\":\"pur\\u001b[2J\"}}")?;
        Ok(false)
    });
    let said = error.to_string();
    assert!(!said.contains('\x1b') && said.contains("1b}[2J"), "{said}");
    // An objective is asked for by its name: one that cannot be shown is none.
    for id in [
        "../../evil\\u001b[31m".to_owned(),
        "10\\\\x".to_owned(),
        "9".repeat(300),
    ] {
        let hello = named("\"id\":\"10x\"", &format!("\"id\":\"{id}\""));
        let (address, _told) = peer(hello, |_, _| Ok(true));
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        let opened = Driver::connect(&address, None).and_then(|d| d.devices(&clock).map(drop));
        let said = opened.expect_err(&id).to_string();
        assert!(said.contains("give it a plain one"), "{said}");
        assert!(!said.contains('\x1b'), "{said}");
    }
}

#[test]
fn frames_that_are_not_counted_are_refused() {
    // Which number each frame has, and whether it may.
    for numbers in [
        [(0, true), (0, false), (1, true)],
        [(5, true), (4, false), (6, true)],
        [(7, true), (9, true), (9, false)],
    ] {
        static NUMBER: std::sync::Mutex<u64> = std::sync::Mutex::new(0);
        let (address, _told) = peer(HELLO, |line, stream| {
            let id = id(line);
            let number = *NUMBER.lock().unwrap();
            if !line.contains("grab") {
                return writeln!(stream, "{{\"id\":{id},\"ok\":true,\"exposure_ms\":10}}")
                    .map(|()| true);
            }
            writeln!(
                stream,
                "{{\"id\":{id},\"ok\":true,\"channels\":1,\"bits\":8,\"exposure_ms\":10,\"sequence\":{number},\
                 \"width_px\":8,\"height_px\":4,\"age_ms\":0.01,\"bytes\":32}}"
            )?;
            stream.write_all(&[7; 32]).map(|()| true)
        });
        let camera = devices(&address).camera.unwrap();
        for (number, may) in numbers {
            *NUMBER.lock().unwrap() = number;
            let frame = camera.grab();
            assert_eq!(frame.is_ok(), may, "{number}: {frame:?}");
            if let Err(error) = frame {
                assert!(error.to_string().contains("count its frames"), "{error}");
            }
        }
    }
}

/// A program that says hello, and whatever `then` does after that, in its own folder.
#[cfg(unix)]
fn program(folder: &std::path::Path, then: &str) -> Driver {
    let hello = HELLO.trim_end();
    let script = format!(
        "cd '{}'; read line; echo '{hello}'; {then}",
        folder.display()
    );
    Driver::spawn("sh", &["-c".to_owned(), script]).unwrap()
}

/// A folder of a test's own.
#[cfg(unix)]
struct Folder(std::path::PathBuf);

#[cfg(unix)]
impl Folder {
    fn new(name: &str) -> Self {
        let name = format!("scopeservo-{name}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
    fn read(&self, file: &str) -> String {
        std::fs::read_to_string(self.0.join(file)).unwrap_or_default()
    }
}

#[cfg(unix)]
impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[cfg(unix)]
#[test]
fn the_answer_to_bye_is_waited_for() {
    let folder = Folder::new("bye");
    // Slow to answer, or with more than a pipe holds; it would die of what nobody reads, and then not write its last word.
    for (k, answer) in [
        "echo '{\"id\":3,\"ok\":true}'",
        "sleep 0.3; echo '{\"id\":3,\"ok\":true}'",
        "head -c 300000 /dev/zero; sleep 0.1; echo '{\"id\":3,\"ok\":true}'",
    ]
    .into_iter()
    .enumerate()
    {
        let file = format!("said{k}");
        let then = format!(
            "read stop; echo '{{\"id\":2,\"ok\":true}}'; read bye; ({answer}) && echo \"$bye\" > {file}"
        );
        drop(program(&folder.0, &then));
        let said = folder.read(&file);
        assert!(said.contains("\"call\":\"bye\""), "{answer}: {said:?}");
    }
    // And of one that listens on a port: it may say all that it has to say.
    for more in ["", " ", "\n"] {
        static MORE: std::sync::Mutex<&str> = std::sync::Mutex::new("");
        static SAID: std::sync::Mutex<Option<bool>> = std::sync::Mutex::new(None);
        *MORE.lock().unwrap() = more;
        *SAID.lock().unwrap() = None;
        let (address, told) = peer(HELLO, |line, stream| {
            if line.contains("bye") {
                std::thread::sleep(Duration::from_millis(100));
            }
            let more = MORE.lock().unwrap();
            let wrote = writeln!(stream, "{{\"id\":{},\"ok\":true{more}}}", id(line))
                .and_then(|()| stream.write_all(&[b' '; 300_000]));
            if line.contains("bye") {
                *SAID.lock().unwrap() = Some(wrote.is_ok());
            }
            Ok(!line.contains("bye"))
        });
        drop(Driver::connect(&address, None).unwrap());
        let last = told.iter().last().unwrap();
        assert!(last.contains("bye"), "{last}");
        assert_eq!(*SAID.lock().unwrap(), Some(true));
    }
}

/// Whether a process runs; one that has ended and that nobody has asked about yet does not.
#[cfg(unix)]
fn runs(number: &str) -> bool {
    let asked = std::process::Command::new("kill")
        .args(["-0", number])
        .output();
    let state = std::fs::read_to_string(format!("/proc/{number}/stat")).unwrap_or_default();
    asked.unwrap().status.success() && !state.contains(") Z ")
}

#[cfg(unix)]
#[test]
fn what_a_driver_started_ends_with_it() {
    let folder = Folder::new("children");
    let alive = |numbers: &str| -> (usize, usize) {
        let all: Vec<&str> = numbers.split_whitespace().collect();
        (all.len(), all.iter().filter(|n| runs(n)).count())
    };
    for (name, then) in [
        // It ends as it should, and leaves three behind.
        (
            "honest",
            "for i in 1 2 3; do sleep 60 & echo $! >> honest; done; cat > /dev/null",
        ),
        // It crashes, and leaves one that holds its output.
        ("crash", "sleep 60 & echo $! > crash; kill -9 $$"),
        // What it leaves does not listen to a request to end.
        (
            "deaf",
            "sh -c 'trap \"\" TERM; while :; do sleep 0.1; done' & echo $! > deaf; cat > /dev/null",
        ),
    ] {
        let driver = program(&folder.0, then);
        let start = Instant::now();
        while folder.read(name).is_empty() {
            assert!(start.elapsed() < Duration::from_secs(60));
            std::thread::sleep(Duration::from_millis(10));
        }
        drop(driver);
        let numbers = folder.read(name);
        let start = Instant::now();
        while alive(&numbers).1 > 0 {
            assert!(start.elapsed() < Duration::from_secs(20), "{name}");
            std::thread::sleep(Duration::from_millis(10));
        }
        assert!(alive(&numbers).0 > 0, "{name}");
    }
}

/// A driver refuses a request whose number is not larger than those before, as the page says; were it a stop, the stage would go on.
#[test]
fn numbers_rise_as_they_are_written_whoever_asks_at_the_same_time() {
    let answer: Odd = |line, stream| {
        let reply = format!(
            "{{\"id\":{},\"ok\":true,\"x_um\":1,\"motion\":\"settled\"}}\n",
            id(line)
        );
        stream.write_all(reply.as_bytes()).map(|()| true)
    };
    let (address, told) = peer(HELLO, answer);
    let devices = devices(&address);
    let stage = devices.stage.as_deref().unwrap();
    std::thread::scope(|threads| {
        for k in 0..8 {
            threads.spawn(move || {
                for _ in 0..150 {
                    match k % 3 {
                        0 => drop(stage.position()),
                        1 => drop(stage.poll()),
                        _ => drop(stage.stop()),
                    }
                }
            });
        }
    });
    drop(devices);
    let all: Vec<u64> = told.iter().map(|line| id(&line)).collect();
    assert!(all.len() > 1200, "{}", all.len());
    let odd = all.windows(2).find(|pair| pair[0] >= pair[1]);
    assert_eq!(odd, None);
}
