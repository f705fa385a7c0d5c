//! A stage that stands is seen to, never taken to.

use crate::{Clock, Motion, ScopeError, StageInfo, StagePose};
use std::time::Duration;

/// What was told to stop stands within this time.
const WITHIN: Duration = Duration::from_secs(2);
/// Between two looks at where it is.
const LOOK: Duration = Duration::from_millis(20);

/// Waits until a stage was seen to stand: it says that it does not move, and that it is in one place, twice. Returns that place.
///
/// # Errors
/// [`ScopeError::StillMoves`] after two seconds, and what `poll` and `position` report.
pub fn stand_still(
    info: &StageInfo,
    clock: &dyn Clock,
    poll: &dyn Fn() -> Result<Motion, ScopeError>,
    position: &dyn Fn() -> Result<StagePose, ScopeError>,
) -> Result<StagePose, ScopeError> {
    let start = clock.now();
    let mut before: Option<StagePose> = None;
    loop {
        match poll()? {
            Motion::Moving => before = None,
            Motion::Settled | Motion::Stopped => {
                let at = position()?;
                let same = |before: &StagePose| {
                    info.axes.iter().all(|axis| {
                        let moved = at.si(axis.axis).zip(before.si(axis.axis));
                        moved.is_none_or(|(a, b)| (a - b).abs() <= axis.tolerance())
                    })
                };
                if before.as_ref().is_some_and(same) {
                    return Ok(at);
                }
                before = Some(at);
            }
        }
        if clock.now().since(start) > WITHIN {
            return Err(ScopeError::StillMoves { device: "stage" });
        }
        clock.sleep(LOOK);
    }
}
