//! Any bytes as what a client says to us, and as what a driver says of itself. `cargo +nightly fuzz run conversation`

#![no_main]

use libfuzzer_sys::fuzz_target;
use scopeservo_protocol::{Hello, Offer, serve};
use scopeservo_scope::{Devices, VirtualClock};
use std::sync::Arc;

fuzz_target!(|data: &[u8]| {
    let offer = Offer {
        name: "nothing".into(),
        devices: Devices::none(Arc::new(VirtualClock::new())),
    };
    let mut said = Vec::new();
    let _ = serve(&offer, None, &mut &data[..], &mut said);
    // Every reply is a line of JSON.
    for line in said.split(|&b| b == b'\n').filter(|l| !l.is_empty()) {
        scopeservo_protocol::wire::parse(line).expect("a reply is an object");
    }
    if let Ok(hello) = serde_json::from_slice::<Hello>(data) {
        let _ = hello.check();
    }
});
