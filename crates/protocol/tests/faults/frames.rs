//! Frames that are late, cut, of another shape, or none.

use super::*;

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
