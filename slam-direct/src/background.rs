//! Work in the background: a pure function on owned values, in a thread of its own.
//!
//! The caller adopts results at fixed points of the recording (the next keyframe), and waits for them if need be. So
//! they do not depend on how fast the threads run.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// A computation under way.
pub(crate) enum Task<T> {
    /// In a thread of its own.
    Spawned(JoinHandle<Option<T>>),
    /// Done at once, where the system gave no thread.
    Done(Option<T>),
}

impl<T: Send + 'static> Task<T> {
    /// Starts `work` in the background.
    pub fn spawn(work: impl FnOnce() -> T + Send + 'static) -> Self {
        // Whoever comes to it takes it: the thread, or this one when no thread can be had.
        let work = Arc::new(Mutex::new(Some(work)));
        let once = move || {
            let work = work.lock().unwrap_or_else(PoisonError::into_inner).take();
            work.map(|work| work())
        };
        let here = once.clone();
        match std::thread::Builder::new().spawn(once) {
            Ok(thread) => Self::Spawned(thread),
            Err(_) => Self::Done(here()),
        }
    }

    /// Waits for the result. A panic of the work continues in the caller.
    pub fn join(self) -> T {
        let result = match self {
            Self::Spawned(thread) => thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)),
            Self::Done(result) => result,
        };
        result.expect("the work is taken once")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gives_the_result_of_its_work() {
        let tasks: Vec<Task<u64>> = (0..4).map(|n| Task::spawn(move || (0..=n).sum())).collect();
        assert_eq!(tasks.into_iter().map(Task::join).collect::<Vec<_>>(), [0, 1, 3, 6]);
    }

    #[test]
    #[should_panic(expected = "out of the background")]
    fn carries_a_panic_on() {
        Task::spawn(|| panic!("out of the background")).join()
    }
}
