//! Ctrl-C and SIGTERM.

use crate::console::tell;
use anyhow::{Context, Result};
use sources::Stop;

/// Exit status after a second Ctrl-C, as shells report an interrupted program.
const ABORTED: i32 = 130;

/// The wish to stop, set by the first Ctrl-C or SIGTERM, which prints `notice`; the second ends the process at once.
///
/// # Errors
/// When the handler cannot be installed.
pub fn stop_on_ctrl_c(notice: &'static str) -> Result<Stop> {
    let stop = Stop::default();
    let of_handler = stop.clone();
    ctrlc::set_handler(move || {
        if of_handler.request() {
            std::process::exit(ABORTED);
        }
        tell!("{notice}");
    })
    .context("cannot listen for Ctrl-C")?;
    Ok(stop)
}
