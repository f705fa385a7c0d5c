//! How long a driver is waited for. For a frame that may be longer, as waiting for one endangers nothing while the driver is there. What
//! stops, and what tells of motion, has a time of its own ([`ANSWER`]), which nobody can lengthen.

use std::time::Duration;

/// The page's time for the first word.
pub(crate) const HELLO: Duration = Duration::from_secs(15);
/// The page's time for stops and for all that tells of motion: a driver that is silent for so long is given up.
pub(crate) const ANSWER: Duration = Duration::from_secs(2);

/// How long a driver is waited for with a frame, beyond the exposure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Patience {
    /// It is late after this: from then on, and each time that so much has passed again, a driver of a stage is asked whether it is still
    /// there, and given up when it does not answer in the time of all other calls.
    pub late: Duration,
    /// It is given up after this, also by a driver that is there.
    pub frame: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self {
            late: Duration::from_secs(5),
            frame: Duration::from_secs(60),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_is_waited_for_no_longer_however_patient_one_is_with_frames() {
        let usual = Patience::default();
        assert_eq!(ANSWER, Duration::from_secs(2));
        // By the page: a frame is late after 5 s, and a driver that is there has more time for it.
        assert_eq!(usual.late, Duration::from_secs(5));
        assert!(usual.frame > 2 * usual.late);
    }
}
