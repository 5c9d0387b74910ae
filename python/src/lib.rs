//! loopbox for Python: what the package `loopbox` in this folder is made of.
//!
//! `commands` runs, merges and evaluates recordings in files, `agent` takes frames one by one, `maps` shows maps as
//! NumPy arrays, without copies where the map has them in memory.

mod agent;
mod arrays;
mod commands;
mod maps;

use pyo3::create_exception;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

create_exception!(
    loopbox,
    LoopboxError,
    PyRuntimeError,
    "What loopbox could not do; the text says why, and how to mend it."
);

/// An error as Python sees it.
fn failed(error: impl Into<anyhow::Error>) -> PyErr {
    LoopboxError::new_err(loopbox::explained(&error.into()))
}

/// Does something on threads of its own, so many or one per core: a process that was forked has none of those that its parent
/// used before, and would wait for them.
fn on_threads<T: Send>(
    threads: Option<usize>,
    work: impl FnOnce() -> anyhow::Result<T> + Send,
) -> anyhow::Result<T> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).build()?;
    pool.install(work)
}

#[pymodule]
mod _loopbox {
    #[pymodule_export]
    use super::LoopboxError;
    #[pymodule_export]
    use super::agent::{Agent, Frame};
    #[pymodule_export]
    use super::commands::{evaluate, keep_verdict, merge, propose, recordings, run, verdict};
    #[pymodule_export]
    use super::maps::{Cloud, Keyframe, Map};
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
