//! The threads that a command's mathematics has.

use crate::error::CliError;

/// More than any machine that a microscope stands beside has cores.
const MAX_THREADS: usize = 256;

/// From now on whoever computes does so on so many threads, or on all cores.
pub(crate) fn take_threads(threads: Option<usize>) -> Result<(), CliError> {
    let mut pool = rayon::ThreadPoolBuilder::new();
    if let Some(threads) = threads {
        if !(1..=MAX_THREADS).contains(&threads) {
            return Err(CliError::Usage(format!(
                "--threads must be from 1 to {MAX_THREADS}; without it all cores are used"
            )));
        }
        pool = pool.num_threads(threads);
    }
    pool.build_global()
        .map_err(|e| CliError::Internal(format!("no threads could be started: {e}")))
}

/// Runs `command` on these threads: nothing of it goes from one thread to another but what it shares out itself.
pub(crate) fn with_threads<T: Send>(
    threads: Option<usize>,
    command: impl FnOnce() -> Result<T, CliError> + Send,
) -> Result<T, CliError> {
    take_threads(threads)?;
    rayon::scope(|_| command())
}
