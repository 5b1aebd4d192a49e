//! The pool of threads that a computation runs on.
//!
//! Not rayon's global pool: that one does not survive a `fork` (as `DataLoader` workers do), and
//! deadlocks. Pools are kept for each process and number of threads; a forked child makes its own.

use std::sync::{Arc, Mutex};

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::{Error, Result};

/// More threads than this are refused: nobody means it.
pub const MAX_THREADS: usize = 1024;

/// Pools of one process.
struct Pools {
    process: u32,
    pools: Vec<(usize, Arc<ThreadPool>)>,
}

static POOLS: Mutex<Option<Pools>> = Mutex::new(None);

/// Run `work` on a pool of `threads` threads; 0 means one for each core that this process may use
/// (control groups and affinity are respected).
///
/// Results never depend on the number: work is split by index and sums are added in index order.
///
/// # Errors
/// [`Error::Argument`] above [`MAX_THREADS`], or if the threads cannot be started.
pub fn install<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Result<T> {
    let available = || std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let count = if threads == 0 { available().min(MAX_THREADS) } else { threads };
    if count > MAX_THREADS {
        return Err(Error::argument(
            "threads",
            format!("found {count}, expected at most {MAX_THREADS}"),
        ));
    }
    Ok(pool(count)?.install(work))
}

/// The kept pool of a size, or a new one.
fn pool(count: usize) -> Result<Arc<ThreadPool>> {
    let process = std::process::id();
    // Never wait: after a fork the lock may be held by a thread that does not exist here. Then a
    // pool of our own does as well.
    let Ok(mut kept) = POOLS.try_lock() else { return build(count) };
    if let Some(inherited) = kept.take_if(|p| p.process != process) {
        // The parent's threads are not in this process; dropping their pools would wait for them.
        std::mem::forget(inherited);
    }
    let pools = &mut kept.get_or_insert_with(|| Pools { process, pools: Vec::new() }).pools;
    if let Some((_, pool)) = pools.iter().find(|p| p.0 == count) {
        return Ok(Arc::clone(pool));
    }
    let pool = build(count)?;
    pools.push((count, Arc::clone(&pool)));
    Ok(pool)
}

fn build(count: usize) -> Result<Arc<ThreadPool>> {
    ThreadPoolBuilder::new()
        .num_threads(count)
        .thread_name(|i| format!("dronepose-{i}"))
        .build()
        .map(Arc::new)
        .map_err(|e| Error::argument("threads", format!("{count} cannot be started: {e}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_runs_on_as_many_threads_as_asked_for() {
        for count in [1, 2, 7] {
            assert_eq!(install(count, rayon::current_num_threads).expect("startable"), count);
        }
        assert!(install(0, rayon::current_num_threads).expect("startable") >= 1);
    }

    #[test]
    fn an_absurd_number_is_refused() {
        let error = install(1_000_000, || ()).expect_err("too many").to_string();
        assert!(error.starts_with("threads: found 1000000"), "{error}");
    }
}
