//! The check of a connection that is lost and made anew.

use super::check::{Check, ensure, run, said};
use super::trial::{LONG_M, long_axis, towards_room, trial};
use crate::{ErrorKind, Instrument, Motion, ScopeError, StagePose};
use std::sync::Arc;
use std::time::Duration;

/// A device that is gone says so within this time.
const GONE_WITHIN: Duration = Duration::from_secs(10);

/// The plug is pulled while the stage moves, and put back: every device says in time that it is gone, a new connection finds the
/// stage standing, or says that it moves until it stands, and drives it. `pull` ends the connection to the devices of `scope`;
/// `put_back` opens them anew. Needs x or y. Also returns the instrument that was opened anew.
pub fn check_replug(
    scope: Arc<Instrument>,
    pull: impl FnOnce(),
    put_back: impl FnOnce() -> Result<Arc<Instrument>, String>,
) -> (Vec<Check>, Option<Arc<Instrument>>) {
    let gone = run("unplugged on the way, every device says so in time", || {
        let gate = scope.gate();
        let axis = long_axis(gate)?;
        let (here, there) = towards_room(gate, axis, LONG_M)?;
        let to = |place: f64| StagePose::default().with_si(axis, place);
        gate.start_move(&to(there)).map_err(said)?;
        scope.clock().sleep(Duration::from_millis(20));
        pull();
        let says = |what: &str, call: &dyn Fn() -> Result<(), ScopeError>| {
            let asked = scope.clock().now();
            let answer = call();
            let took = scope.clock().now().since(asked);
            let fault = answer.as_ref().is_err_and(|e| e.kind() == ErrorKind::Fault);
            ensure(fault && took <= GONE_WITHIN, || {
                format!(
                    "{what} answered {answer:?} after {:.1} s",
                    took.as_secs_f64()
                )
            })
        };
        says("position", &|| gate.position().map(drop))?;
        says("poll", &|| gate.poll().map(drop))?;
        says("a move", &|| gate.start_move(&to(here)))?;
        if !gate.objectives().is_empty() {
            says("the nosepiece", &|| gate.poll_nosepiece().map(drop))?;
        }
        if scope.camera().info().width > 0 {
            says("the camera", &|| scope.camera().grab().map(drop))?;
        }
        Ok(())
    });
    drop(scope);
    let mut opened = None;
    let back = run("plugged in again, it stands and moves when told to", || {
        let scope = opened.insert(put_back()?);
        let gate = scope.gate();
        let asked = scope.clock().now();
        while gate.poll().map_err(said)? == Motion::Moving {
            scope.check_cancel().map_err(said)?;
            scope.clock().sleep(Duration::from_millis(10));
            let took = scope.clock().now().since(asked);
            ensure(took <= Duration::from_secs(60), || {
                "it says that it moves, a minute later still".into()
            })?;
        }
        let axis = long_axis(gate)?;
        let at = gate.position().map_err(said)?.si(axis);
        scope.clock().sleep(Duration::from_millis(200));
        let later = gate.position().map_err(said)?.si(axis);
        ensure(at == later, || {
            format!("it says that it stands, and went from {at:?} to {later:?}")
        })?;
        let (here, there) = towards_room(gate, axis, trial(axis))?;
        for place in [there, here] {
            let to = StagePose::default().with_si(axis, place);
            scope.move_to(&to).map_err(said)?;
        }
        Ok(())
    });
    (vec![gone, back], opened)
}
