//! What the workers that are timed beside OpenCV share: a request is one JSON object per line.

use serde_json::Value;
use std::hint::black_box;
use std::time::Instant;

/// Milliseconds of each of the `repetitions` of a request, and what the last one gave.
pub fn repeat<T>(request: &Value, mut work: impl FnMut() -> T) -> (Vec<f64>, T) {
    let mut once = || {
        let start = Instant::now();
        let value = black_box(work());
        (start.elapsed().as_secs_f64() * 1e3, value)
    };
    let (first, mut value) = once();
    let mut ms = vec![first];
    for _ in 1..request["repetitions"].as_u64().unwrap_or(1) {
        let (next, new) = once();
        ms.push(next);
        value = new;
    }
    (ms, value)
}

/// A text of a request.
///
/// # Errors
/// That there is none.
pub fn text<'a>(request: &'a Value, key: &str) -> Result<&'a str, String> {
    let text = request[key].as_str();
    text.ok_or_else(|| format!("the request has no {key}"))
}
