//! What the decoder of raw files does with damaged ones: it may panic, which here becomes an answer.

use std::panic;
use std::sync::Once;
use std::thread;

/// Name of the threads that decode, by which their panics are known.
const DECODER: &str = "raw decoder";

/// Bytes of stack of such a thread: directories in files may lie in each other.
const STACK: usize = 8 << 20;

/// Runs `work` on a thread of its own, with all that it does in parallel; `None` where it panicked, of which nothing is printed.
///
/// The thread that asks waits and does nothing else: one of a pool would begin with the next file, and so hold many at once.
pub(super) fn guarded<T: Send>(work: impl FnOnce() -> T + Send) -> Option<T> {
    silence();
    let run = || {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .thread_name(|_| DECODER.to_owned())
            .stack_size(STACK)
            .build();
        pool.ok().map(|pool| pool.install(work))
    };
    thread::scope(|scope| {
        let builder = thread::Builder::new().name(DECODER.to_owned());
        let decoder = builder.spawn_scoped(scope, run).ok()?;
        decoder.join().ok().flatten()
    })
}

/// Sees to it that panics of these threads print nothing; those of others go where they went.
fn silence() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let tell = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if thread::current().name() != Some(DECODER) {
                tell(info);
            }
        }));
    });
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;

    use super::*;

    #[test]
    fn panics_become_answers_also_in_parallel_work() {
        assert_eq!(guarded(|| 7), Some(7));
        let all = || (0..100).into_par_iter().map(|i| i * i).sum::<usize>();
        assert_eq!(guarded(all), Some(328_350));
        let broken = || {
            (0..100)
                .into_par_iter()
                .for_each(|i| assert!(i < 50, "{i}"));
        };
        assert_eq!(guarded(broken), None);
    }
}
