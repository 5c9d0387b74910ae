//! How many threads a command works with.

use crate::console::usage;
use anyhow::{Context, Result, anyhow};

/// The argument for it.
#[derive(Clone, Copy, clap::Args, Debug)]
pub struct ThreadsArg {
    /// Threads to work with; default: one per core. The result does not depend on it
    #[arg(short = 'j', long, value_name = "COUNT", allow_negative_numbers = true)]
    threads: Option<usize>,
}

impl ThreadsArg {
    /// Has all that follows work with so many.
    ///
    /// # Errors
    /// When there are to be none, or they cannot be started.
    pub fn start(self) -> Result<()> {
        let Some(threads) = self.threads else { return Ok(()) };
        if threads == 0 {
            let none = anyhow!("--threads must be 1 or more\nhint: without it there is one per core");
            return usage(Err(none));
        }
        rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("cannot start threads")
    }
}
