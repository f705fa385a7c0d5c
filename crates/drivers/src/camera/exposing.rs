//! How long a camera exposes, and how that is set.

use crate::camera::http::{Answer, Login, Url};
use crate::camera::{bad_setting, device, duration};
use crate::session::lock;
use scopeservo_scope::{CameraInfo, ScopeError};
use serde::Deserialize;
use std::sync::Mutex;
use std::time::Duration;

/// The exposure of a camera on the web: as it was set by hand, or set by asking for an address.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExposureSettings {
    /// The exposure in force. Automatic exposure must be off: images of one place would differ.
    pub now_ms: f64,
    /// An address that sets it, with {us}, {ms} or {s} where the time belongs.
    pub set_url: Option<String>,
    /// The shortest that can be set.
    pub shortest_ms: Option<f64>,
    /// The longest that can be set.
    pub longest_ms: Option<f64>,
}

type Set = Box<dyn Fn(Duration) -> Result<Duration, ScopeError> + Send + Sync>;

/// An exposure within its range.
pub(crate) struct Exposing {
    now: Mutex<Duration>,
    range: [Duration; 2],
    set: Option<Set>,
}

impl Exposing {
    /// One that is what it is.
    pub(crate) fn fixed(now: Duration) -> Self {
        Self {
            now: Mutex::new(now),
            range: [now, now],
            set: None,
        }
    }

    /// One that `set` sets, and returns as it was really set.
    pub(crate) fn with(now: Duration, range: [Duration; 2], set: Set) -> Self {
        Self {
            now: Mutex::new(now),
            range,
            set: Some(set),
        }
    }

    pub(crate) fn range(&self) -> [Duration; 2] {
        self.range
    }

    pub(crate) fn get(&self) -> Duration {
        *lock(&self.now)
    }

    /// Sets it on the camera with this `info`, whose range is that of [`Exposing::range`].
    pub(crate) fn set(
        &self,
        info: &CameraInfo,
        exposure: Duration,
    ) -> Result<Duration, ScopeError> {
        info.check_exposure(exposure)?;
        let mut now = lock(&self.now);
        *now = match &self.set {
            Some(set) => set(exposure)?,
            None => exposure,
        };
        Ok(*now)
    }
}

impl ExposureSettings {
    pub(crate) fn exposing(
        &self,
        login: Option<Login>,
        timeout: Duration,
    ) -> Result<Exposing, ScopeError> {
        let now = duration("exposure.now_ms", self.now_ms)?;
        if now.is_zero() {
            return Err(bad_setting("exposure.now_ms must be above 0"));
        }
        let (url, range) = match (&self.set_url, self.shortest_ms, self.longest_ms) {
            (None, None, None) => return Ok(Exposing::fixed(now)),
            (Some(url), Some(shortest), Some(longest)) => {
                let shortest = duration("exposure.shortest_ms", shortest)?;
                (url, [shortest, duration("exposure.longest_ms", longest)?])
            }
            _ => {
                return Err(bad_setting(
                    "exposure: set_url, shortest_ms and longest_ms belong together",
                ));
            }
        };
        if range[0].is_zero() || now < range[0] || now > range[1] {
            return Err(bad_setting(
                "exposure: shortest_ms must be above 0, and now_ms from shortest_ms to longest_ms",
            ));
        }
        let template = url.clone();
        let filled = move |exposure: Duration| {
            let s = exposure.as_secs_f64();
            template
                .replace("{us}", &format!("{:.0}", s * 1e6))
                .replace("{ms}", &format!("{:.3}", s * 1e3))
                .replace("{s}", &format!("{s:.6}"))
        };
        if filled(now) == *url {
            return Err(bad_setting(
                "exposure.set_url must hold {us}, {ms} or {s}: the exposure in microseconds, milliseconds or seconds",
            ));
        }
        Url::parse(&filled(now))?;
        Ok(Exposing::with(
            now,
            range,
            Box::new(move |exposure| {
                let url = Url::parse(&filled(exposure))?;
                Answer::get(&url, login.as_ref(), timeout)
                    .and_then(|answer| answer.whole(timeout))
                    .map_err(|e| device(format!("the exposure was not set at {url}: {e}")))?;
                Ok(exposure)
            }),
        ))
    }
}
