//! Work beside the tracking: a pure function on owned values in a thread of its own.
//!
//! Results are taken up at fixed points of the recording (the next keyframe), waited for if need be, so that
//! they do not depend on how fast the threads run.

use std::thread::JoinHandle;

/// A computation under way.
pub(crate) struct Task<T>(JoinHandle<T>);

impl<T: Send + 'static> Task<T> {
    /// Starts `work` in the background.
    pub fn spawn(work: impl FnOnce() -> T + Send + 'static) -> Self {
        Self(std::thread::spawn(work))
    }

    /// Waits for the result. A panic of the work goes on in the caller.
    pub fn join(self) -> T {
        self.0.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
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
