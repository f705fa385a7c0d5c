//! Any text as the answers of controllers. `cargo +nightly fuzz run codecs`

#![no_main]

use libfuzzer_sys::fuzz_target;
use scopeservo_drivers::{gcode, gcs2, sangaboard};

fuzz_target!(|text: &str| {
    let lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let names: Vec<_> = ["X", "Y", "U"]
        .iter()
        .filter_map(|n| gcs2::codec::AxisName::new(n).ok())
        .collect();
    if let Ok(values) = gcs2::codec::decode_values("POS?", &names, &lines) {
        assert!(values.iter().all(|v| v.is_finite()) && values.len() == names.len());
    }
    let _ = gcs2::codec::decode_number("VEL?", &lines);
    let _ = gcs2::codec::decode_axes(&lines);
    let _ = gcs2::codec::decode_moving(&lines);
    let _ = gcs2::codec::decode_reachable(&lines);
    let _ = gcs2::codec::decode_flags("FRF?", &names, &lines);
    let _ = gcs2::codec::decode_error(&lines);
    let _ = gcs2::codec::decode_ready(text.as_bytes());
    for line in &lines {
        let _ = gcode::codec::decode(line);
        let _ = sangaboard::codec::decode_version(line);
        let _ = sangaboard::codec::decode_position(line);
        let _ = sangaboard::codec::decode_moving(line);
        let _ = sangaboard::codec::decode_stopped(line);
        let _ = sangaboard::codec::decode_blocking(line);
    }
});
