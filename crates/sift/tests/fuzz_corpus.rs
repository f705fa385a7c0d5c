//! The fuzzer's target on seeded bytes: needs no nightly compiler and runs with every other test. `SIFT_FUZZ_CASES` asks for more
//! or fewer cases, `SIFT_FUZZ_SEED` for other ones.

#[path = "common/drive.rs"]
mod drive;

use std::panic::catch_unwind;

fn from_env(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |v| v.parse().expect("a number"))
}

#[test]
fn seeded_bytes_break_no_promise() {
    let seed = from_env("SIFT_FUZZ_SEED", 1);
    for case in seed..seed + from_env("SIFT_FUZZ_CASES", 300) {
        // Splitmix64; one case in four goes on with the bytes of the target's own generator soon.
        let mut state = case;
        let mut byte = || {
            state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
            let z = (state ^ (state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
            (z ^ (z >> 29)) as u8
        };
        let len = if case % 4 == 0 { 40 } else { 4096 };
        let data: Vec<u8> = (0..len).map(|_| byte()).collect();
        assert!(
            catch_unwind(|| drive::drive(&data)).is_ok(),
            "SIFT_FUZZ_SEED={case} SIFT_FUZZ_CASES=1 shows it again"
        );
    }
}
