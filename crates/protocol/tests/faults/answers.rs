//! Answers that are late, wrong or none.

use super::*;

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
