//! What a driver says of itself, and what of it is shown.

use super::*;

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
