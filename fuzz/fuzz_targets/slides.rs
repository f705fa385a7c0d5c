//! Any bytes as a picture of any format. `cargo +nightly fuzz run slides`

#![no_main]

use libfuzzer_sys::fuzz_target;
use scopeservo_slide::{Alpha, Budget, Choice, Samples, Wanted, decode};

fuzz_target!(|bytes: &[u8]| {
    let [page, channel, picture @ ..] = bytes else {
        return;
    };
    // The upper half: without a wish.
    let wish = |byte: u8| (byte < 128).then_some(usize::from(byte % 8));
    let wanted = Wanted {
        choice: Choice {
            page: wish(*page),
            channel: wish(*channel),
        },
        alpha: if page % 2 == 0 {
            Alpha::Dropped
        } else {
            Alpha::OverWhite
        },
        budget: Budget { bytes: 64 << 20 },
    };
    if let Ok(picture) = decode(picture, &wanted) {
        let samples = match picture.samples {
            Samples::U8(v) => v.len(),
            Samples::U16(v) => v.len(),
        };
        assert_eq!(samples, picture.width * picture.height * picture.channels);
    }
});
