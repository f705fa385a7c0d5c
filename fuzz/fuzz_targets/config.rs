//! Any text as scopeservo.toml. `cargo +nightly fuzz run config`

#![no_main]

use libfuzzer_sys::fuzz_target;
use scopeservo_setup::Config;
use std::path::Path;

fuzz_target!(|text: &str| {
    if let Err(error) = Config::parse(text, Path::new("scopeservo.toml")) {
        assert!(error.to_string().starts_with("scopeservo.toml"));
    }
});
