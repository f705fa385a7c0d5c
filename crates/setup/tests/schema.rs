//! The schema for editors knows the keys that the program knows, no more and no fewer.

use scopeservo_setup::{Config, TWIN_TEMPLATE, schema};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::Path;

/// What the program says there is in the table that a text ends in, when it meets a key that is none.
fn known_keys(table: &str) -> BTreeSet<String> {
    // An unknown key in a text that is otherwise right up to there. None is like it, so all are listed.
    let text = format!("{table}\nqqqqq = 1\n");
    let said = Config::parse(&text, Path::new("x.toml"))
        .expect_err(table)
        .to_string();
    let list = said
        .split("there are ")
        .nth(1)
        .unwrap_or_else(|| panic!("{table}: {said}"));
    list.split(", ").map(str::to_owned).collect()
}

fn schema_keys(pointer: &str) -> BTreeSet<String> {
    let schema: Value = serde_json::from_str(&schema()).unwrap();
    let at = schema
        .pointer(pointer)
        .unwrap_or_else(|| panic!("{pointer}"));
    assert_eq!(at["additionalProperties"], false, "{pointer}");
    at["properties"]
        .as_object()
        .unwrap()
        .keys()
        .cloned()
        .collect()
}

#[test]
fn the_schema_has_the_keys_of_the_program_table_by_table() {
    let driver = "/properties/drivers/additionalProperties";
    let own = |kind: &str| format!("{driver}/properties/{kind}");
    for (table, pointer) in [
        ("", String::new()),
        ("[devices]", "/properties/devices".into()),
        ("[[objective]]", "/properties/objective/items".into()),
        ("[limits]", "/properties/limits".into()),
        (
            "[limits_for.40x]",
            "/properties/limits_for/additionalProperties".into(),
        ),
        ("[largest_step]", "/properties/largest_step".into()),
        ("[[zone]]", "/properties/zone/items".into()),
        ("[objective_change]", "/properties/objective_change".into()),
        ("[camera]", "/properties/camera".into()),
        ("[light]", "/properties/light".into()),
        ("[target]", "/properties/target".into()),
        ("[arrival]", "/properties/arrival".into()),
        ("[focus]", "/properties/focus".into()),
        ("[drivers.a]", driver.into()),
        ("[drivers.a.twin]", own("twin")),
        ("[drivers.a.twin.camera]", own("twin/properties/camera")),
        (
            "[drivers.a.twin.camera.auto_exposure]",
            own("twin/properties/camera/properties/auto_exposure"),
        ),
        (
            "[[drivers.a.twin.camera.dust]]",
            own("twin/properties/camera/properties/dust/items"),
        ),
        (
            "[drivers.a.twin.camera.pattern]",
            own("twin/properties/camera/properties/pattern"),
        ),
        (
            "[drivers.a.twin.made.lattice]",
            own("twin/properties/made/properties/lattice"),
        ),
        (
            "[drivers.a.twin.made.sparse]",
            own("twin/properties/made/properties/sparse"),
        ),
        (
            "[drivers.a.twin.made.twice]",
            own("twin/properties/made/properties/twice"),
        ),
        ("[drivers.a.gcs2]", own("gcs2")),
        ("[drivers.a.gcs2.settings]", own("gcs2/properties/settings")),
        (
            "[[drivers.a.gcs2.settings.linear]]",
            own("gcs2/properties/settings/properties/linear/items"),
        ),
        (
            "[[drivers.a.gcs2.settings.rotary]]",
            own("gcs2/properties/settings/properties/rotary/items"),
        ),
        ("[drivers.a.gcode]", own("gcode")),
        (
            "[drivers.a.gcode.settings]",
            own("gcode/properties/settings"),
        ),
        (
            "[[drivers.a.gcode.settings.axes]]",
            own("gcode/properties/settings/properties/axes/items"),
        ),
        (
            "[drivers.a.gcs2.settings.nosepiece]",
            own("gcs2/properties/settings/properties/nosepiece"),
        ),
        (
            "[[drivers.a.gcs2.settings.nosepiece.objectives]]",
            own("gcs2/properties/settings/properties/nosepiece/properties/objectives/items"),
        ),
        (
            "[drivers.a.gcode.settings.nosepiece]",
            own("gcode/properties/settings/properties/nosepiece"),
        ),
        (
            "[[drivers.a.gcode.settings.nosepiece.objectives]]",
            own("gcode/properties/settings/properties/nosepiece/properties/objectives/items"),
        ),
        ("[drivers.a.sangaboard]", own("sangaboard")),
        (
            "[drivers.a.sangaboard.settings]",
            own("sangaboard/properties/settings"),
        ),
        (
            "[drivers.a.sangaboard.settings.x]",
            own("sangaboard/properties/settings/properties/x"),
        ),
        ("[drivers.a.mjpeg]", own("mjpeg")),
        (
            "[drivers.a.mjpeg.settings]",
            own("mjpeg/properties/settings"),
        ),
        (
            "[drivers.a.mjpeg.settings.exposure]",
            own("mjpeg/properties/settings/properties/exposure"),
        ),
        ("[drivers.a.snapshot]", own("snapshot")),
        (
            "[drivers.a.snapshot.settings]",
            own("snapshot/properties/settings"),
        ),
        ("[drivers.a.folder]", own("folder")),
        ("[drivers.a.v4l]", own("v4l")),
    ] {
        assert_eq!(known_keys(table), schema_keys(&pointer), "{table}");
    }
}

#[test]
fn what_the_schema_requires_the_program_requires() {
    let schema: Value = serde_json::from_str(&schema()).unwrap();
    let without = |key: &str| -> String {
        let start = TWIN_TEMPLATE.find(&format!("\n{key}")).unwrap() + 1;
        let end = start + TWIN_TEMPLATE[start..].find('\n').unwrap();
        let text = format!("{}{}", &TWIN_TEMPLATE[..start], &TWIN_TEMPLATE[end..]);
        Config::parse(&text, Path::new("x.toml"))
            .expect_err(key)
            .to_string()
    };
    assert_eq!(schema["required"][0], "name");
    assert!(without("name = ").contains("missing field `name`"));
    for device in schema["properties"]["devices"]["required"]
        .as_array()
        .unwrap()
    {
        let device = device.as_str().unwrap();
        let said = without(&format!("{device} = "));
        assert!(
            said.contains(&format!("missing field `{device}`")),
            "{said}"
        );
    }
}
