//! Ctrl-C and SIGTERM.

use crate::console::tell;
use anyhow::{Context, Result};
use sources::Stop;
use std::sync::atomic::{AtomicBool, Ordering};

/// Exit status after a second Ctrl-C, as shells report an interrupted program.
const ABORTED: i32 = 130;

/// Whether only a page is left that shows the results.
static RESULTS_ARE_SAVED: AtomicBool = AtomicBool::new(false);

/// Says nothing more of what is saved when the user stops the program: all is.
#[cfg(feature = "view")]
pub fn only_a_page_is_left() {
    RESULTS_ARE_SAVED.store(true, Ordering::Relaxed);
}

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
        if !RESULTS_ARE_SAVED.load(Ordering::Relaxed) {
            tell!("{notice}");
        }
    })
    .context("cannot listen for Ctrl-C")?;
    Ok(stop)
}
