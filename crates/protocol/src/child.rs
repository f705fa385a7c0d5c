//! Starting a driver's program and ending it, with all that it started itself.

use std::process::{Child, Command};
use std::time::{Duration, Instant};

/// How long a driver that was told to end may take for it before it is ended.
const GRACE: Duration = Duration::from_secs(5);
/// How long what is told to terminate may take to stop its devices.
const LAST_GRACE: Duration = Duration::from_millis(500);
const LOOK: Duration = Duration::from_millis(10);

/// The driver, in a group of its own with what it starts: Ctrl-C is ours to handle, and the driver shall still be there to stop what moves.
pub(crate) fn start(command: &mut Command) -> std::io::Result<Child> {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    command.spawn()
}

/// Waits until the driver has ended, and ends it when it does not; then what it has left behind in its group, which may still hold a port.
#[cfg(unix)]
pub(crate) fn end(mut child: Child) {
    use rustix::process::{
        Pid, Signal, WaitId, WaitIdOptions, kill_process_group, test_kill_process_group, waitid,
    };
    let Some(group) = i32::try_from(child.id()).ok().and_then(Pid::from_raw) else {
        return;
    };
    // Without taking its number from it: no other program can have that before its group was told.
    let options = WaitIdOptions::EXITED | WaitIdOptions::NOWAIT | WaitIdOptions::NOHANG;
    let ended = || !matches!(waitid(WaitId::Pid(group), options), Ok(None));
    within(GRACE, ended);
    let _ = kill_process_group(group, Signal::TERM);
    if !within(LAST_GRACE, ended) {
        let _ = kill_process_group(group, Signal::KILL);
    }
    let _ = child.wait();
    // A group is there as long as anybody is in it.
    let gone = || test_kill_process_group(group).is_err();
    if !within(LAST_GRACE, gone) {
        let _ = kill_process_group(group, Signal::KILL);
    }
}

/// Waits until the driver has ended, and ends it when it does not.
#[cfg(not(unix))]
pub(crate) fn end(mut child: Child) {
    within(GRACE, || !matches!(child.try_wait(), Ok(None)));
    let _ = child.kill();
    let _ = child.wait();
}

/// Whether it comes true in time.
fn within(time: Duration, mut so: impl FnMut() -> bool) -> bool {
    let start = Instant::now();
    loop {
        if so() {
            return true;
        }
        if start.elapsed() >= time {
            return false;
        }
        std::thread::sleep(LOOK);
    }
}
