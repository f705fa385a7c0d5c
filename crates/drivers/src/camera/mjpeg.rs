//! Cameras on the web that send one JPEG after another.

use crate::camera::exposing::ExposureSettings;
use crate::camera::http::{Answer, HttpError, Login, Url};
use crate::camera::multipart::Parts;
use crate::camera::stream::{Packed, Source, StreamCamera};
use crate::camera::{device, duration, lost};
use crate::link::LinkError;
use scopeservo_scope::{Clock, ScopeError};
use serde::Deserialize;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A camera that sends MJPEG over HTTP.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MjpegSettings {
    /// Where it sends from: `http://host:port/path`.
    pub url: String,
    /// The longest time from the start of an exposure until the whole image is here. Too short a time lets old images pass;
    /// `doctor --allow-motion` finds that out.
    pub latency_ms: f64,
    /// How long after that an image is waited for.
    #[serde(default = "five_seconds")]
    pub timeout_ms: f64,
    /// How long it exposes.
    pub exposure: ExposureSettings,
}

fn five_seconds() -> f64 {
    5000.0
}

/// Opens the camera and waits for its first image.
///
/// # Errors
/// [`ScopeError::BadSetting`], [`ScopeError::Lost`] when it is not there or answers otherwise, [`ScopeError::Timeout`],
/// [`ScopeError::Device`].
pub fn mjpeg_camera(
    settings: &MjpegSettings,
    login: Option<Login>,
    clock: Arc<dyn Clock>,
) -> Result<StreamCamera, ScopeError> {
    let url = Url::parse(&settings.url)?;
    let latency = duration("latency_ms", settings.latency_ms)?;
    let timeout = duration("timeout_ms", settings.timeout_ms)?;
    let exposing = settings.exposure.exposing(login.clone(), timeout)?;
    let name = format!("MJPEG camera at {url}");
    let open = move || -> Result<Box<dyn Source>, ScopeError> {
        let answer = Answer::get(&url, login.as_ref(), timeout).map_err(|error| match error {
            HttpError::Link(error) => lost(format!("{url}: {error}")),
            error => device(format!("{url}: {error}")),
        })?;
        let parts = Parts::new(&answer.head.content_type);
        let parts = parts.map_err(|e| device(format!("{url}: {e}")))?;
        let grew = Instant::now();
        Ok(Box::new(Mjpeg {
            answer,
            parts,
            grew,
        }))
    };
    StreamCamera::new(name, Box::new(open), exposing, latency, timeout, clock)
}

struct Mjpeg {
    answer: Answer,
    parts: Parts,
    /// When bytes came last.
    grew: Instant,
}

impl Source for Mjpeg {
    fn next(&mut self, wait: Duration) -> Result<Option<(Packed, Instant)>, String> {
        let deadline = Instant::now() + wait;
        let mut before = self.grew;
        loop {
            if let Some(picture) = self.parts.take().map_err(|e| e.to_string())? {
                // One without a length ends with the head of the next, perhaps a whole period later.
                let came = match self.parts.was_sized() {
                    true => self.grew,
                    false => before,
                };
                return Ok(Some((Packed::File(picture), came)));
            }
            match self.answer.more(self.parts.feed(), deadline) {
                Ok(true) => before = std::mem::replace(&mut self.grew, Instant::now()),
                Ok(false) => return Err("it has ended its images".into()),
                Err(HttpError::Link(LinkError::Silence)) => return Ok(None),
                Err(error) => return Err(error.to_string()),
            }
        }
    }
}
