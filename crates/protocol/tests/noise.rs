//! Requests that were damaged on the way: an answer with a code, or the end, and never a panic. `fuzz/` has the same for as long as
//! one likes.

use scopeservo_protocol::{Hello, Offer, serve, wire};
use scopeservo_scope::{Clock, SystemClock, VirtualClock};
use scopeservo_twin::specimen::Tissue;
use scopeservo_twin::{Config, Twin};
use std::sync::Arc;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % n as u64) as usize
    }
}

const SOUND: [&str; 12] = [
    r#"{"id":1,"call":"hello","protocol":1,"client":"t"}"#,
    r#"{"id":2,"call":"position"}"#,
    r#"{"id":3,"call":"move","x_um":12.5,"rz_deg":-1}"#,
    r#"{"id":4,"call":"motion"}"#,
    r#"{"id":5,"call":"stop"}"#,
    r#"{"id":6,"call":"objective"}"#,
    r#"{"id":7,"call":"change","objective":"40x"}"#,
    r#"{"id":8,"call":"exposure","exposure_ms":1e300}"#,
    r#"{"id":9,"call":"exposure"}"#,
    r#"{"id":10,"call":"light","level":0.5}"#,
    r#"{"id":11,"call":"home"}"#,
    r#"{"id":12,"call":"dance"}"#,
];
const ODD: [&[u8]; 10] = [
    b"\"", b"{", b"}", b"[", b":", b",", b"1e999", b"null", b"\xff", b"\n",
];

fn damaged(random: &mut Random) -> Vec<u8> {
    let mut bytes = Vec::new();
    // Nothing else is answered before.
    if random.below(8) > 0 {
        bytes.extend_from_slice(SOUND[0].as_bytes());
        bytes.push(b'\n');
    }
    for _ in 0..1 + random.below(4) {
        let mut line = SOUND[random.below(SOUND.len())].as_bytes().to_vec();
        for _ in 0..random.below(4) {
            let at = random.below(line.len());
            match random.below(3) {
                0 => drop(line.remove(at)),
                1 => line[at] = random.below(256) as u8,
                _ => drop(line.splice(at..at, ODD[random.below(ODD.len())].iter().copied())),
            }
        }
        bytes.extend_from_slice(&line);
        bytes.push(b'\n');
    }
    if random.below(4) == 0 {
        bytes.truncate(random.below(bytes.len()));
    }
    bytes
}

/// The twin on offer.
fn twin(clock: Arc<dyn Clock>) -> Offer {
    let twin = Twin::new(
        Config::realistic(),
        Arc::new(Tissue::new(1)),
        1,
        clock.clone(),
    )
    .unwrap();
    Offer {
        name: "twin".into(),
        devices: twin.devices(),
    }
}

#[test]
fn damaged_requests_get_a_code_or_the_end() {
    let clock = Arc::new(VirtualClock::new());
    let offer = twin(clock);
    let mut random = Random(5);
    let (mut answered, mut refused) = (0u32, 0u32);
    for _ in 0..40_000 {
        let bytes = damaged(&mut random);
        let mut said = Vec::new();
        let _ = serve(&offer, None, &mut &bytes[..], &mut said);
        for line in said.split(|&b| b == b'\n').filter(|l| !l.is_empty()) {
            let reply = wire::parse(line).expect("a reply is an object");
            assert!(reply["id"].is_u64(), "{reply:?}");
            match reply.get("error") {
                Some(code) => {
                    refused += 1;
                    let sentence = reply["message"].as_str().unwrap();
                    assert!(code.is_string() && sentence.len() > 10, "{reply:?}");
                }
                None => answered += 1,
            }
        }
    }
    assert!(answered > 5_000 && refused > 5_000, "{answered} {refused}");
}

#[test]
fn damaged_hellos_are_refused_or_make_sense() {
    let clock = Arc::new(SystemClock::new());
    let offer = twin(clock);
    let mut said = Vec::new();
    serve(
        &offer,
        None,
        &mut SOUND[0]
            .as_bytes()
            .iter()
            .chain(b"\n")
            .copied()
            .collect::<Vec<_>>()
            .as_slice(),
        &mut said,
    )
    .unwrap();
    let sound: Hello = serde_json::from_slice(&said).unwrap();
    sound.check().unwrap();
    let mut random = Random(6);
    let (mut nonsense, mut fine) = (0, 0);
    for _ in 0..20_000 {
        let mut bytes = said.clone();
        for _ in 0..1 + random.below(3) {
            let at = random.below(bytes.len());
            // Digits mostly: so that it stays a hello, of other numbers.
            bytes[at] = match bytes[at] {
                b'0'..=b'9' => b"0123456789-"[random.below(11)],
                _ if random.below(3) == 0 => random.below(256) as u8,
                same => same,
            };
        }
        if let Ok(hello) = serde_json::from_slice::<Hello>(&bytes) {
            match hello.check() {
                Ok(()) => fine += 1,
                Err(_) => nonsense += 1,
            }
        }
    }
    assert!(fine > 1000 && nonsense > 100, "{fine} {nonsense}");
}
