//! The `sift-features` crate as a worker: JSON lines in, JSON lines out, as speed.py asks.

use std::io::{BufRead, Write};
use std::time::Instant;

use serde_json::{Value, json};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for line in std::io::stdin().lock().lines() {
        let reply = answer(&serde_json::from_str(&line?)?)
            .unwrap_or_else(|e| json!({ "error": e.to_string() }));
        let mut out = std::io::stdout().lock();
        writeln!(out, "{reply}")?;
        out.flush()?;
    }
    Ok(())
}

fn answer(request: &Value) -> Result<Value, Box<dyn std::error::Error>> {
    if request["piece"] == "hello" {
        return Ok(json!({ "name": "sift-features", "version": "0.1.0" }));
    }
    let image = image::open(request["image"].as_str().ok_or("no image")?)?.into_luma8();
    let mut count = 0;
    let ms: Vec<f64> = (0..request["repetitions"].as_u64().unwrap_or(1))
        .map(|_| {
            let start = Instant::now();
            count = sift_features::sift(&image, None).keypoints.len();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    Ok(json!({ "ms": ms, "count": count }))
}
