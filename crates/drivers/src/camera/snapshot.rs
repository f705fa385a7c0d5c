//! Cameras on the web that give one image for each question.

use crate::camera::exposing::{Exposing, ExposureSettings};
use crate::camera::http::{Answer, HttpError, Login, Url};
use crate::camera::{check_latency, device, duration, frame, info, lost, picture};
use crate::link::LinkError;
use scopeservo_scope::{Camera, CameraInfo, Clock, Frame, ScopeError};
use serde::Deserialize;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// A camera that gives an image for each question over HTTP.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SnapshotSettings {
    /// Where it gives them: `http://host:port/path`, a JPEG, PNG or TIFF.
    pub url: String,
    /// How long before the question the exposure of the answer may have begun: the oldest image that it keeps, its exposure
    /// included. 0 for a camera that exposes when asked. Too short a time lets old images pass; `doctor --allow-motion` finds that out.
    pub stale_ms: f64,
    /// How long an answer may take.
    #[serde(default = "five_seconds")]
    pub timeout_ms: f64,
    /// How long it exposes.
    pub exposure: ExposureSettings,
}

fn five_seconds() -> f64 {
    5000.0
}

/// A camera that is asked for each image.
pub struct SnapshotCamera {
    url: Url,
    login: Option<Login>,
    stale: Duration,
    /// The exposure that `stale` was told for.
    first_exposure: Duration,
    timeout: Duration,
    exposing: Exposing,
    info: CameraInfo,
    clock: Arc<dyn Clock>,
    count: AtomicU64,
}

impl SnapshotCamera {
    /// Asks for a first image.
    ///
    /// # Errors
    /// [`ScopeError::BadSetting`], [`ScopeError::Lost`] when it is not there or answers otherwise, [`ScopeError::Timeout`],
    /// [`ScopeError::Device`].
    pub fn connect(
        settings: &SnapshotSettings,
        login: Option<Login>,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, ScopeError> {
        let url = Url::parse(&settings.url)?;
        let timeout = duration("timeout_ms", settings.timeout_ms)?;
        let exposing = settings.exposure.exposing(login.clone(), timeout)?;
        let stale = duration("stale_ms", settings.stale_ms)?;
        let first_exposure = exposing.get();
        if !stale.is_zero() {
            check_latency("stale_ms", stale, first_exposure)?;
        }
        let first = shot(&url, login.as_ref(), timeout)?;
        Ok(Self {
            info: info(format!("camera at {url}"), &first, exposing.range()),
            url,
            login,
            stale,
            first_exposure,
            timeout,
            exposing,
            clock,
            count: AtomicU64::new(0),
        })
    }
}

fn shot(
    url: &Url,
    login: Option<&Login>,
    timeout: Duration,
) -> Result<picture::Picture, ScopeError> {
    let bytes = Answer::get(url, login, timeout).and_then(|answer| answer.whole(timeout));
    let bytes = bytes.map_err(|error| match error {
        HttpError::Link(LinkError::Silence) => device(format!(
            "{url} gave no whole image within {:.1} s; if it sends one after another, use mjpeg",
            timeout.as_secs_f64()
        )),
        HttpError::Link(error) => lost(format!("{url}: {error}")),
        error => device(format!("{url}: {error}")),
    })?;
    picture::decode(&bytes).map_err(|e| device(format!("{url}: {e}")))
}

impl Camera for SnapshotCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    fn exposure(&self) -> Result<Duration, ScopeError> {
        Ok(self.exposing.get())
    }

    fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
        self.exposing.set(&self.info, exposure)
    }

    fn grab(&self) -> Result<Frame, ScopeError> {
        let exposure = self.exposing.get();
        let asked = self.clock.now();
        // What it keeps from before grows too old meanwhile.
        if !self.stale.is_zero() {
            std::thread::sleep(self.stale + exposure.saturating_sub(self.first_exposure));
        }
        let timeout = self.timeout + exposure;
        let picture = shot(&self.url, self.login.as_ref(), timeout)?;
        let sequence = self.count.fetch_add(1, Ordering::Relaxed);
        frame(&self.info, picture, sequence, asked, exposure)
    }
}
