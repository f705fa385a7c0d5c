//! What a description cannot mean is refused with the file, the line and the value, before any device is asked.

use scopeservo_scope::CancelToken;
use scopeservo_setup::{Config, Consent, SetupError, TWIN_TEMPLATE, connect, schema};
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;

const FILE: &str = "lab/scopeservo.toml";

fn parse(text: &str) -> Result<Config, SetupError> {
    Config::parse(text, Path::new(FILE))
}

/// What is said of a text, which must begin with the file and this line.
fn said_at(line: usize, text: &str) -> String {
    let said = parse(text).expect_err(text).to_string();
    let begins = format!("{FILE}:{line}:");
    assert!(said.starts_with(&begins), "not {begins} but {said}\n{text}");
    said
}

/// The line of the first place that says `what`.
fn line_of(text: &str, what: &str) -> usize {
    let at = text
        .find(what)
        .unwrap_or_else(|| panic!("{what} in {text}"));
    text[..at].matches('\n').count() + 1
}

/// The template with something else in it, and what is said of that.
fn instead(from: &str, to: &str) -> String {
    let text = TWIN_TEMPLATE.replace(from, to);
    assert_ne!(text, TWIN_TEMPLATE, "{from}");
    said_at(line_of(&text, to), &text)
}

#[test]
fn limits_are_two_numbers_in_order() {
    for (values, right) in [
        ("[-3000, 3000, -50]", "exactly 2 values, and there are 3"),
        ("[-3000]", "invalid length 1"),
        ("[]", "invalid length 0"),
        (
            "[3000, -3000]",
            "x_um is [3000, -3000]: it must be two numbers, the smaller first",
        ),
        ("[nan, 3000]", "it must be two numbers"),
        ("[-inf, inf]", "it must be two numbers"),
    ] {
        let said = instead("x_um = [-17000, 17000]", &format!("x_um = {values}"));
        assert!(said.contains(right), "{values}: {said}");
    }
    // An axis may be held at one place.
    parse(&TWIN_TEMPLATE.replace("[-17000, 17000]", "[5, 5]")).unwrap();
    let more = |table: &str, wrong: &str| {
        let text = format!("{TWIN_TEMPLATE}\n{table}\n{wrong}\n");
        said_at(line_of(&text, wrong), &text)
    };
    let own = more("[limits_for.40x]", "z_um = [120, -3000]");
    assert!(own.contains("limits_for.40x.z_um is [120, -3000]"), "{own}");
    let step = more("[largest_step]", "z_um = 0");
    assert!(
        step.contains("largest_step.z_um is 0: it must be above 0"),
        "{step}"
    );
    let zone = "[[zone]]\nname = \"a clamp\"\nclosest_z_um = -1500\nx_um = [-1, 1]";
    let zone = more(zone, "y_um = [16000, -16000]");
    assert!(
        zone.contains("y_um of the zone 'a clamp' is [16000, -16000]"),
        "{zone}"
    );
}

/// Of every list whose length the schema states, one value more is refused where it is written: none is dropped silently.
#[test]
fn a_list_with_a_value_too_many_is_refused_wherever_it_is() {
    fn lists(schema: &Value, keys: &mut Vec<String>, found: &mut Vec<(Vec<String>, u64)>) {
        let most = schema["maxItems"].as_u64();
        if let (Some(most), true) = (most, schema["items"]["type"] == "number") {
            found.push((keys.clone(), most));
        }
        let named = schema["properties"].as_object().into_iter().flatten();
        let any = schema["additionalProperties"].as_object();
        let any = any.map(|_| (String::from("any"), &schema["additionalProperties"]));
        for (key, inner) in named.map(|(k, v)| (k.clone(), v)).chain(any) {
            keys.push(key);
            lists(inner, keys, found);
            keys.pop();
        }
        if schema["items"]["properties"].is_object() {
            keys.push("[]".into());
            lists(&schema["items"], keys, found);
            keys.pop();
        }
    }
    let schema: Value = serde_json::from_str(&schema()).unwrap();
    let mut found = Vec::new();
    lists(&schema, &mut Vec::new(), &mut found);
    assert!(found.len() >= 20, "{found:?}");
    for (keys, most) in found {
        // As one inline value: {limits = {x_um = [..]}}, with [..] around the items of lists.
        let numbers = vec!["1"; most as usize + 1].join(", ");
        let value = keys[1..]
            .iter()
            .rev()
            .fold(format!("[{numbers}]"), |v, key| match key.as_str() {
                "[]" => format!("[{v}]"),
                key => format!("{{ \"{key}\" = {v} }}"),
            });
        let text = format!("\"{}\" = {value}\n", keys[0]);
        let said = Config::is_spelled_as_meant(&text).expect_err(&text);
        assert!(
            said.contains(&format!("and there are {}", most + 1)),
            "{text}: {said}"
        );
    }
}

#[test]
fn a_path_whose_backslashes_began_an_escape_is_told_to_use_single_quotes() {
    let written = |value: &str| {
        let text = TWIN_TEMPLATE.replace("seed = 1", &format!("seed = 1\nspecimen = {value}"));
        (line_of(&text, "specimen = "), text)
    };
    for wrong in [
        r#""C:\temp\x""#,
        r#""C:\temp""#,
        r#""C:\x41bc""#,
        r#""D:\new\run.svs""#,
        r#""drivers\run.png""#,
        r#""\\server\fresh""#,
        r#""C:\Users\me\slide.svs""#,
        r#""C:\lab\slide.svs""#,
        r#""C:\slides\a.tif""#,
    ] {
        let (line, text) = written(wrong);
        // In a table of its own line: the template's own comment has a specimen too.
        let said = said_at(line, &text);
        assert!(
            said.contains("use single quotes for paths") && said.contains("or write them with /"),
            "{wrong}: {said}"
        );
    }
    for right in [
        r"'C:\temp\x'",
        r#""C:/temp/x""#,
        r#""C:\\temp\\x""#,
        r#""\u00e9t\u00e9.svs""#,
    ] {
        let (_, text) = written(right);
        let config = parse(&text).unwrap_or_else(|e| panic!("{right}: {e}"));
        assert_eq!(config.drivers.len(), 1);
    }
    // A program's arguments as well, and lines that are meant as such.
    let program = TWIN_TEMPLATE.replace(
        "[devices]",
        "[drivers.other]\nprogram = [\"python\", \"C:\\temp\\driver.py\"]\n[devices]",
    );
    said_at(line_of(&program, "program = ["), &program);
    let lines = TWIN_TEMPLATE.replace(
        "[devices]",
        "[drivers.other]\nprogram = [\"sh\", \"-c\", \"\"\"one\ntwo\"\"\"]\n[devices]",
    );
    parse(&lines).unwrap();
}

fn by_hand(objectives: &[(&str, f64, f64, &str)]) -> String {
    let mut text = TWIN_TEMPLATE.replace("nosepiece = \"twin\"", "nosepiece = \"by-hand\"");
    for (id, magnification, aperture, immersion) in objectives {
        text += &format!(
            "\n[[objective]]\nid = \"{id}\"\nmagnification = {magnification}\nnumerical_aperture = {aperture}\num_per_px = {}\nimmersion = \"{immersion}\"\n",
            100.0 / magnification
        );
    }
    text
}

#[test]
fn objectives_are_told_apart_or_refused() {
    let ten = ("10x", 100.0, 0.25, "air");
    for (second, right) in [
        (
            ("Plan", 100.0, 0.25, "air"),
            "'10x' and 'Plan' have the same magnification, aperture and medium",
        ),
        (("10x", 400.0, 0.65, "air"), "'10x' needs a name of its own"),
        (("", 400.0, 0.65, "air"), "needs a name of its own"),
        (
            ("10X", 400.0, 0.65, "air"),
            "differ by capital letters only",
        ),
        (
            ("40x", 400.0, 50.0, "air"),
            "40x has a numerical aperture of 50, and in air there is none above 1",
        ),
        (("100x", 1000.0, 1.3, "air"), "(immersion)"),
        (("40x", 0.0, 0.65, "air"), "must be above 0"),
    ] {
        let text = by_hand(&[ten, second]);
        let line = text.rfind("[[objective]]").unwrap();
        let said = said_at(text[..line].matches('\n').count() + 1, &text);
        assert!(said.contains(right), "{said}");
    }
    for second in [
        ("10x Ph", 100.0, 0.3, "air"),
        ("10x W", 100.0, 0.25, "water"),
        ("11x", 110.0, 0.25, "air"),
    ] {
        parse(&by_hand(&[ten, second])).unwrap();
    }
}

#[test]
fn settings_that_cannot_be_are_refused_with_their_line() {
    let appended = |table: &str, wrong: &str| {
        let text = format!("{TWIN_TEMPLATE}\n{table}\n{wrong}\n");
        said_at(line_of(&text, wrong), &text)
    };
    for (table, wrong, right) in [
        ("[camera]", "exposure_ms = -1", "camera.exposure_ms is -1"),
        ("[camera]", "exposure_ms = nan", "camera.exposure_ms is NaN"),
        (
            "[light]",
            "level = 1.5",
            "light.level is 1.5: it must be from 0 to 1",
        ),
        ("[light]", "level = 0.5", "devices.light names no driver"),
        ("[arrival]", "within_um = -2", "arrival.within_um is -2"),
    ] {
        let said = appended(table, wrong);
        assert!(said.contains(right), "{said}");
    }
    let name = instead("name = \"simulated microscope\"", "name = \" \"");
    assert!(name.contains("name is empty"), "{name}");
    let margin = instead("margin_um = 0", "margin_um = -5");
    assert!(margin.contains("margin_um must be 0 or above"), "{margin}");
    let height = instead("retract_z_um = -2000", "retract_z_um = nan");
    assert!(height.contains("retract_z_um must be a number"), "{height}");
}

/// What only the devices show is wrong has its line, too.
#[test]
fn rules_that_do_not_fit_the_devices_name_the_file_the_line_and_the_key() {
    let consent = Consent {
        home: false,
        ask: Arc::new(|_, _| false),
        ask_immersion: Arc::new(|_, _| false),
    };
    let said = |text: &str, line: usize| {
        let opened = connect(&parse(text).unwrap(), &consent, CancelToken::new());
        let said = opened.err().unwrap().to_string();
        let begins = format!("{FILE}:{line}: ");
        assert!(said.starts_with(&begins), "not {begins} but {said}");
        said
    };
    let instead = |from: &str, to: &str| {
        let text = TWIN_TEMPLATE.replace(from, to);
        said(&text, line_of(&text, to))
    };
    let appended = |table: &str, rest: &str| {
        let text = format!("{TWIN_TEMPLATE}\n{table}\n{rest}\n");
        said(&text, line_of(&text, table))
    };
    let room = instead("x_um = [-17000, 17000]", "x_um = [90000, 91000]");
    assert!(
        room.contains("limits.x_um: the limits of x leave no room to move"),
        "{room}"
    );
    let height = instead(
        "[objective_change]\nretract_z_um = -2000",
        "[objective_change]\nretract_z_um = -9000000",
    );
    assert!(
        height.contains("objective_change: objectives are to change from"),
        "{height}"
    );
    let other = appended("[limits_for.90x]", "z_um = [-3000, 100]");
    assert!(
        other.contains("limits_for.90x: limits are set for 90x, which is no objective here"),
        "{other}"
    );
    let near = appended("[limits_for.40x]", "z_um = [-100, 100]");
    assert!(
        near.contains("the limits of 40x leave out the height"),
        "{near}"
    );
    let zone = appended(
        "[[zone]]",
        "name = \"clamp\"\nx_um = [0, 1]\ny_um = [0, 1]\nclosest_z_um = 0\nobjectives = [\"5x\"]",
    );
    assert!(
        zone.contains("zone.0: the zone 'clamp' is for 5x"),
        "{zone}"
    );
    let text = TWIN_TEMPLATE.replace("turned_deg = 0", "turned_deg = 0\nstage = \"xyz\"");
    let text = format!("{text}\n[largest_step]\nrz_deg = 3\n");
    let step = said(&text, line_of(&text, "rz_deg = 3"));
    assert!(step.contains("largest_step.rz_deg: "), "{step}");
    for (wrong, right) in [
        ("turned_deg = 1e300", "turned_deg must be from -360 to 360"),
        ("turned_deg = 361", "turned_deg must be from -360 to 360"),
        ("turned_deg = inf", "turned_deg must be from -360 to 360"),
        ("centre_um = [1e9, 0]", "centre_um must be within 100000 um"),
    ] {
        let key = wrong.split(' ').next().unwrap();
        let mut lines: Vec<&str> = TWIN_TEMPLATE.lines().collect();
        for line in &mut lines {
            if line.starts_with(key) {
                *line = wrong;
            }
        }
        let text = lines.join("\n");
        let said = said(&text, line_of(&text, "twin.twin]"));
        assert!(said.contains(right), "{said}");
    }
    for tilt in ["[99, 0]", "[0, -51]", "[nan, 0]"] {
        let more = format!("turned_deg = 0\ntilt_mrad = {tilt}");
        let text = TWIN_TEMPLATE.replace("turned_deg = 0", &more);
        let said = said(&text, line_of(&text, "twin.twin]"));
        assert!(said.contains("tilt_mrad must be from -50 to 50"), "{said}");
    }
}
