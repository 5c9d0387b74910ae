//! Work done side by side.

use anyhow::Result;
use std::panic::resume_unwind;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What comes of every job, in their order, as many at once as there are cores; none is begun after one that failed.
///
/// # Errors
/// That of the first job that failed.
pub fn side_by_side<J: Sync, T: Send>(jobs: &[J], work: impl Fn(&J) -> Result<T> + Sync) -> Result<Vec<T>> {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let work_off = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = jobs.get(index) else { return };
            let result = work(job);
            if result.is_err() {
                next.store(jobs.len(), Ordering::Relaxed);
            }
            // Another worker's panic leaves the list as whole as it was.
            done.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push((index, result));
        }
    };
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..workers).map(|_| scope.spawn(work_off)).collect();
        workers.into_iter().for_each(|worker| worker.join().unwrap_or_else(|panic| resume_unwind(panic)));
    });
    let mut done = done.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::bail;

    #[test]
    fn results_come_in_the_order_of_their_jobs_and_an_error_ends_it() {
        let jobs: Vec<usize> = (0..100).collect();
        assert_eq!(side_by_side(&jobs, |job| Ok(job * 2)).unwrap(), (0..200).step_by(2).collect::<Vec<_>>());
        let (many, begun) = (vec![1; 10_000], AtomicUsize::new(0));
        let failed = side_by_side(&many, |_| {
            if begun.fetch_add(1, Ordering::Relaxed) == 0 {
                bail!("the first");
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
            Ok(())
        });
        assert_eq!(failed.unwrap_err().to_string(), "the first");
        assert!(begun.into_inner() < many.len(), "others were begun after it");
        assert!(side_by_side(&[] as &[usize], |_| Ok(())).unwrap().is_empty());
    }
}
