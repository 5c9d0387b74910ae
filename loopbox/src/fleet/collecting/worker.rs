//! A thread for what takes long, so that nobody waits for it.

use super::merger::on_threads;
use anyhow::{Context, Result, anyhow};
use std::sync::Arc;
use std::thread::JoinHandle;

/// Does one thing at a time, in a thread of its own and on one core. Waits for its end when it is dropped.
pub(super) struct Worker<T: Send + 'static> {
    pool: Arc<rayon::ThreadPool>,
    at_work: Option<JoinHandle<T>>,
}

impl<T: Send + 'static> Worker<T> {
    /// One that gives way to all other threads where that is asked for.
    ///
    /// # Errors
    /// When a thread cannot be started.
    pub fn new(low_priority: bool) -> Result<Self> {
        Ok(Self { pool: Arc::new(on_threads(1, low_priority)?), at_work: None })
    }

    /// Whether nothing is on its way, and nothing done that was not taken.
    pub fn is_idle(&self) -> bool {
        self.at_work.is_none()
    }

    /// Begins something; it is idle.
    ///
    /// # Errors
    /// When a thread cannot be started.
    pub fn start(&mut self, work: impl FnOnce() -> T + Send + 'static) -> Result<()> {
        debug_assert!(self.is_idle(), "one thing at a time");
        let pool = Arc::clone(&self.pool);
        let thread = std::thread::Builder::new().name("fleet-settle".into());
        self.at_work = Some(thread.spawn(move || pool.install(work)).context("cannot start a thread")?);
        Ok(())
    }

    /// What came of it, if it is done.
    ///
    /// # Errors
    /// When it broke down.
    pub fn done(&mut self) -> Result<Option<T>> {
        match &self.at_work {
            Some(thread) if !thread.is_finished() => Ok(None),
            _ => self.wait(),
        }
    }

    /// What came of it, at its end; nothing where nothing was on its way.
    ///
    /// # Errors
    /// When it broke down.
    pub fn wait(&mut self) -> Result<Option<T>> {
        let done = self.at_work.take().map(JoinHandle::join).transpose();
        done.map_err(|_| anyhow!("internal error in making the common map, please report it"))
    }
}

impl<T: Send + 'static> Drop for Worker<T> {
    fn drop(&mut self) {
        // Who wants to know what went wrong waits for it.
        let _ = self.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn what_takes_long_is_waited_for_by_nobody_who_does_not_want_it() {
        let (go, gone) = channel::<()>();
        let mut worker = Worker::new(false).unwrap();
        assert!(worker.is_idle() && worker.done().unwrap().is_none() && worker.wait().unwrap().is_none());
        worker.start(move || gone.recv().map(|()| rayon::current_num_threads())).unwrap();
        assert!(!worker.is_idle() && worker.done().unwrap().is_none());
        go.send(()).unwrap();
        assert_eq!(worker.wait().unwrap(), Some(Ok(1)));
        assert!(worker.is_idle());
    }

    #[test]
    fn a_panic_is_an_error_and_pending_work_ends_before_the_worker_is_dropped() {
        let mut worker = Worker::new(true).unwrap();
        worker.start(|| panic!("as it should")).unwrap();
        let error = worker.wait().unwrap_err();
        assert!(error.to_string().contains("internal error"), "{error}");
        let (done, ended) = channel();
        worker.start(move || done.send(()).unwrap()).unwrap();
        drop(worker);
        assert_eq!(ended.try_recv(), Ok(()));
    }
}
