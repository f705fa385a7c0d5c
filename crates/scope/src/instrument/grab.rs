//! Frames: grabbed anew, and given up when somebody asks for a stop.

use super::Instrument;
use super::waiting::POLL;
use crate::{Frame, ScopeError};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

/// How often one who waits for a frame looks whether a stop was asked for.
const POLL_CANCEL: Duration = Duration::from_millis(20);
/// A driver that hangs over a frame is given so long to be noticed as such, and ended, before the instrument is gone.
const LAST_FRAME: Duration = Duration::from_secs(8);

impl Instrument {
    /// Grabs a fresh frame.
    ///
    /// # Errors
    /// [`ScopeError::Interrupted`], or what the camera reports.
    pub fn grab(&self) -> Result<Frame, ScopeError> {
        self.check_cancel()?;
        let (tell, told) = mpsc::channel();
        let camera = self.camera.clone();
        // Whoever asks for a stop need not wait for a long exposure: the camera ends it by itself, and nobody looks.
        let frame = std::thread::spawn(move || {
            // Whoever asked may have gone.
            let _ = tell.send(camera.grab());
        });
        loop {
            match told.recv_timeout(POLL_CANCEL) {
                Ok(frame) => {
                    let frame = frame?;
                    self.frames.fetch_add(1, Ordering::SeqCst);
                    return Ok(frame);
                }
                Err(RecvTimeoutError::Timeout) => {
                    if let Err(interrupted) = self.check_cancel() {
                        *self.given_up.lock().unwrap_or_else(|e| e.into_inner()) = Some(frame);
                        return Err(interrupted);
                    }
                }
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(ScopeError::Device {
                        device: "camera",
                        detail: "its driver broke down".into(),
                    });
                }
            }
        }
    }
}

impl Drop for Instrument {
    fn drop(&mut self) {
        let given_up = self.given_up.get_mut().ok().and_then(Option::take);
        let Some(frame) = given_up else { return };
        // A long exposure ends by itself.
        if self.camera.exposure().is_ok_and(|e| e > LAST_FRAME / 4) {
            return;
        }
        let start = std::time::Instant::now();
        while !frame.is_finished() && start.elapsed() < LAST_FRAME {
            std::thread::sleep(POLL);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Absent, Camera, CancelToken, ChangeRule, Clock, Devices, Rules};
    use std::sync::Arc;

    /// A camera that exposes for a minute.
    struct Night(Absent);

    impl Camera for Night {
        fn info(&self) -> &crate::CameraInfo {
            Camera::info(&self.0)
        }
        fn exposure(&self) -> Result<Duration, ScopeError> {
            Ok(Duration::from_secs(60))
        }
        fn set_exposure(&self, exposure: Duration) -> Result<Duration, ScopeError> {
            Ok(exposure)
        }
        fn grab(&self) -> Result<Frame, ScopeError> {
            std::thread::sleep(Duration::from_secs(60));
            self.0.grab()
        }
    }

    #[test]
    fn a_stop_does_not_wait_for_a_long_exposure() {
        let cancel = CancelToken::new();
        let rules = Rules::travel_only(ChangeRule::Anywhere);
        let clock = Arc::new(crate::SystemClock::new());
        let devices = Devices {
            camera: Some(Box::new(Night(Absent::new()))),
            ..Devices::none(clock.clone())
        };
        let scope = Instrument::new(devices, rules, cancel.clone()).unwrap();
        std::thread::scope(|s| {
            let grab = s.spawn(|| scope.grab());
            std::thread::sleep(Duration::from_millis(50));
            cancel.cancel();
            let answer = grab.join().unwrap();
            assert!(
                matches!(answer, Err(ScopeError::Interrupted { .. })),
                "{answer:?}"
            );
        });
        assert!(clock.now().seconds() < 5.0);
    }
}
