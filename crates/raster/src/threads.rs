//! The pool of threads that a computation runs on.

use crate::error::{Error, Result};

/// Run `work` on a pool of `threads` threads; 0 means one for each core that this process may use
/// (control groups and affinity are respected).
///
/// Results never depend on the number: work is split by index and sums are added in index order.
///
/// # Errors
/// [`Error::Argument`] if the threads cannot be started.
pub fn install<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Result<T> {
    let available = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let count = if threads == 0 { available } else { threads };
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(count)
        .thread_name(|i| format!("dronepose-{i}"))
        .build()
        .map_err(|e| Error::argument("threads", format!("{count} cannot be started: {e}")))?;
    Ok(pool.install(work))
}
