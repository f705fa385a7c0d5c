//! Any bytes as what a camera sends. `cargo +nightly fuzz run pictures`

#![no_main]

use libfuzzer_sys::fuzz_target;
use scopeservo_drivers::camera::http::{HttpError, decode_head};
use scopeservo_drivers::camera::multipart::{MultipartError, Parts};
use scopeservo_drivers::camera::picture;
use scopeservo_drivers::camera::raw::{self, Layout, PixelOrder};

fn body(answer: &[u8], piece: usize) -> Result<Option<(Vec<u8>, bool)>, HttpError> {
    let Some((mut head, length)) = decode_head(answer)? else {
        return Ok(None);
    };
    let mut body = Vec::new();
    for mut chunk in answer[length..].chunks(piece) {
        while !chunk.is_empty() && !head.body_is_whole() {
            let used = head.take_body(chunk, &mut body)?;
            assert!(used > 0);
            chunk = &chunk[used..];
        }
    }
    Ok(Some((body, head.body_is_whole())))
}

fn pictures(stream: &[u8], piece: usize) -> Result<Vec<Vec<u8>>, MultipartError> {
    let mut parts = Parts::new("multipart/x-mixed-replace; boundary=b")?;
    let mut all = Vec::new();
    for chunk in stream.chunks(piece) {
        parts.feed().extend_from_slice(chunk);
        while let Some(picture) = parts.take()? {
            all.push(picture);
        }
    }
    Ok(all)
}

fuzz_target!(|bytes: &[u8]| {
    let [kind, piece, rest @ ..] = bytes else {
        return;
    };
    let piece = usize::from(*piece) + 1;
    match kind % 4 {
        // However it is cut, it says the same.
        0 => assert_eq!(body(rest, piece), body(rest, usize::MAX)),
        1 => assert_eq!(pictures(rest, piece).ok(), pictures(rest, usize::MAX).ok()),
        2 => {
            if let Ok(picture) = picture::decode(rest) {
                let count = picture.width * picture.height * picture.channels.count();
                let samples = match picture.samples {
                    scopeservo_scope::Samples::U8(s) => s.len(),
                    scopeservo_scope::Samples::U16(s) => s.len(),
                };
                assert_eq!(samples, count);
            }
        }
        _ => {
            let [order, width, height, row, pixels @ ..] = rest else {
                return;
            };
            let orders = [
                PixelOrder::Gray,
                PixelOrder::Gray16 { bits: 12 },
                PixelOrder::Rgb,
                PixelOrder::Bgr,
                PixelOrder::Yuyv,
                PixelOrder::Uyvy,
                PixelOrder::Nv12,
            ];
            let layout = Layout {
                order: orders[usize::from(*order) % orders.len()],
                width: usize::from(*width),
                height: usize::from(*height),
                row_bytes: usize::from(*row),
            };
            let _ = raw::unpack(&layout, pixels);
        }
    }
});
