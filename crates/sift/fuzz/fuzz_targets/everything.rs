//! Any bytes through images, options, detection, description and matching.

#![no_main]

#[path = "../../tests/common/drive.rs"]
mod drive;

use libfuzzer_sys::fuzz_target;

fuzz_target!(
    init: {
        // One thread: what a case does shall depend on its bytes alone.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global();
    },
    |data: &[u8]| drive::drive(data)
);
