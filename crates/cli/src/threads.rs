//! The pool that a command runs in.

use crate::error::CliError;

/// More than any machine that a microscope stands beside has cores.
const MAX_THREADS: usize = 256;

/// Runs `command` on so many threads, or on all cores.
pub(crate) fn with_threads<T: Send>(
    threads: Option<usize>,
    command: impl FnOnce() -> Result<T, CliError> + Send,
) -> Result<T, CliError> {
    let mut pool = rayon::ThreadPoolBuilder::new();
    if let Some(threads) = threads {
        if !(1..=MAX_THREADS).contains(&threads) {
            return Err(CliError::Usage(format!(
                "--threads must be from 1 to {MAX_THREADS}; without it all cores are used"
            )));
        }
        pool = pool.num_threads(threads);
    }
    pool.build()
        .map_err(|e| CliError::Internal(format!("no threads could be started: {e}")))?
        .install(command)
}
