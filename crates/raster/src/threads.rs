//! The pool of threads that a computation runs on.
//!
//! Not rayon's global pool: that one does not survive a `fork` (as `DataLoader` workers do), and
//! deadlocks. Pools are kept for each process and number of threads; a forked child makes its own.
//! Callers on several threads share a pool, but for work on a single thread each is a pool of its own:
//! they would wait for one another, and handing a small image to another thread and back takes
//! longer than drawing it. Such a caller needs a stack of 256 KiB, which threads have unless they were
//! given less.

use std::cell::OnceCell;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::{Error, Result};

/// More threads than this are refused: nobody means it.
pub const MAX_THREADS: usize = 1024;

/// So many threads of a process may become a pool: each takes about 13 kB, for good. Beyond, work is
/// handed over.
const MOST_OWN: usize = 256;

/// An image of at most so many pixels is not shared out among threads, but in soft masks.
pub const SMALL_IMAGE: usize = 1 << 18;

/// How long the number of cores is taken for what it was: asking costs as much as a small image.
const FRESH: Duration = Duration::from_secs(1);

/// Pools of one process.
struct Pools {
    process: u32,
    /// How many cores it may use, and when that was asked.
    cores: Option<(usize, Instant)>,
    shared: Vec<(usize, Arc<ThreadPool>)>,
    /// Pools of one thread that nobody uses.
    idle: Vec<ThreadPool>,
}

static POOLS: Mutex<Option<Pools>> = Mutex::new(None);

/// Threads that are a pool.
static OWN_COUNT: AtomicUsize = AtomicUsize::new(0);

thread_local! {
    /// The pool that this thread is, which no fork takes away; `None` if it cannot be one.
    static OWN: OnceCell<Option<&'static ThreadPool>> = const { OnceCell::new() };
}

/// Run `work` on a pool of `threads` threads; 0 means one for each core that this process may use
/// (control groups and affinity are respected, a change of them after a second at most).
///
/// Results never depend on the number: work is split by index and sums are added in index order.
///
/// # Errors
/// [`Error::Argument`] above [`MAX_THREADS`], or if the threads cannot be started.
pub fn install<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Result<T> {
    let count = if threads == 0 { cores().min(MAX_THREADS) } else { threads };
    if count > MAX_THREADS {
        return Err(Error::argument(
            "threads",
            format!("found {count}, expected at most {MAX_THREADS}"),
        ));
    }
    if count == 1 {
        if let Some(own) = OWN.with(|own| *own.get_or_init(|| become_a_pool(MOST_OWN))) {
            return Ok(own.install(work));
        }
        let pool = match with_pools(|kept| kept.idle.pop()) {
            Some(Some(pool)) => pool,
            _ => build(1)?,
        };
        let result = pool.install(work);
        with_pools(|kept| kept.idle.push(pool));
        return Ok(result);
    }
    Ok(shared(count)?.install(work))
}

/// The number of threads that was asked for; where that was left open (0) and there is little to do,
/// 1: the caller does it.
#[must_use]
pub fn or_one(asked: usize, little: bool) -> usize {
    if asked == 0 && little { 1 } else { asked }
}

/// Make the calling thread a pool, unless it is in one already or `most` threads are. Rayon keeps it
/// for good.
fn become_a_pool(most: usize) -> Option<&'static ThreadPool> {
    let count = OWN_COUNT.fetch_add(1, Ordering::Relaxed);
    let pool = (count < most && rayon::current_thread_index().is_none())
        .then(|| ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().ok())
        .flatten();
    if pool.is_none() {
        OWN_COUNT.fetch_sub(1, Ordering::Relaxed);
    }
    pool.map(|pool| &*Box::leak(Box::new(pool)))
}

/// How many cores this process may use.
fn cores() -> usize {
    let now = Instant::now();
    if let Some(Some(count)) = with_pools(|kept| still_true(kept.cores, now)) {
        return count;
    }
    let count = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    with_pools(|kept| kept.cores = Some((count, now)));
    count
}

/// What was found, unless it was too long ago.
fn still_true(found: Option<(usize, Instant)>, now: Instant) -> Option<usize> {
    found.filter(|(_, then)| now.saturating_duration_since(*then) < FRESH).map(|(count, _)| count)
}

/// What is kept of this process; `None` where somebody else holds it.
///
/// Never waits: after a fork the lock may be held by a thread that does not exist here. Then a pool
/// of one's own does as well.
fn with_pools<T>(work: impl FnOnce(&mut Pools) -> T) -> Option<T> {
    let process = std::process::id();
    let mut kept = POOLS.try_lock().ok()?;
    if let Some(inherited) = kept.take_if(|p| p.process != process) {
        // The parent's threads are not in this process; dropping their pools would wait for them.
        std::mem::forget(inherited);
    }
    let new = || Pools { process, cores: None, shared: Vec::new(), idle: Vec::new() };
    Some(work(kept.get_or_insert_with(new)))
}

/// The kept pool of a size, or a new one.
fn shared(count: usize) -> Result<Arc<ThreadPool>> {
    let found = with_pools(|kept| {
        if let Some((_, pool)) = kept.shared.iter().find(|p| p.0 == count) {
            return Ok(Arc::clone(pool));
        }
        let pool = Arc::new(build(count)?);
        kept.shared.push((count, Arc::clone(&pool)));
        Ok(pool)
    });
    found.unwrap_or_else(|| build(count).map(Arc::new))
}

fn build(count: usize) -> Result<ThreadPool> {
    ThreadPoolBuilder::new()
        .num_threads(count)
        .thread_name(|i| format!("dronepose-{i}"))
        .build()
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
    fn callers_with_one_thread_each_do_not_wait_for_one_another() {
        use std::sync::{Barrier, mpsc};
        use std::time::Duration;
        let (both, (sender, receiver)) = (Arc::new(Barrier::new(2)), mpsc::channel());
        for _ in 0..2 {
            let (both, sender) = (Arc::clone(&both), sender.clone());
            // Either waits inside until the other is inside too.
            std::thread::spawn(move || {
                let ran = install(1, || both.wait().is_leader()).is_ok();
                sender.send(ran)
            });
        }
        for _ in 0..2 {
            assert!(receiver.recv_timeout(Duration::from_secs(20)).expect("both run at a time"));
        }
    }

    #[test]
    fn work_on_one_thread_stays_on_that_of_the_caller() {
        let here = || std::thread::current().id();
        for _ in 0..2 {
            assert_eq!(install(1, here).expect("startable"), here());
        }
        // Also inside of itself; and from there a pool of more threads is to be had.
        let inside = install(1, || (install(1, here), install(2, rayon::current_num_threads)));
        let (inside, two) = inside.expect("startable");
        assert_eq!((inside.expect("startable"), two.expect("startable")), (here(), 2));
        // A thread of a pool cannot be another one: it hands over.
        let other =
            install(2, || (install(1, rayon::current_num_threads), install(1, here), here()));
        let (one, there, from) = other.expect("startable");
        assert_eq!(one.expect("startable"), 1);
        assert_ne!(there.expect("startable"), from);
    }

    #[test]
    fn no_more_threads_than_that_become_pools() {
        let turn = |most| std::thread::spawn(move || become_a_pool(most).is_some()).join();
        assert!(turn(MOST_OWN).expect("no panic"));
        assert!(!turn(0).expect("no panic"));
    }

    #[test]
    fn little_is_for_the_caller_unless_threads_were_asked_for() {
        assert_eq!([or_one(0, true), or_one(0, false)], [1, 0]);
        assert_eq!([or_one(2, true), or_one(2, false)], [2, 2]);
    }

    #[test]
    fn the_number_of_cores_is_asked_for_again_after_a_second() {
        let then = Instant::now();
        let found = Some((3, then));
        assert_eq!(still_true(found, then + Duration::from_millis(900)), Some(3));
        assert_eq!(still_true(found, then + Duration::from_millis(1100)), None);
        assert_eq!(still_true(None, then), None);
        let all = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        for _ in 0..2 {
            assert_eq!(cores(), all);
        }
    }

    #[test]
    fn an_absurd_number_is_refused() {
        let error = install(1_000_000, || ()).expect_err("too many").to_string();
        assert!(error.starts_with("threads: found 1000000"), "{error}");
    }
}
