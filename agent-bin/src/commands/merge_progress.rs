//! What the user sees while maps are merged.

use crate::console::{tell, warning};
use crate::logging;
use indicatif::{ProgressBar, ProgressStyle};
use loopbox::merging::MergeWatcher;
use std::io::IsTerminal;
use std::time::Duration;

/// Says on standard error what is being done: in one line of a terminal, else a line for each step.
pub struct MergeProgress {
    bar: Option<ProgressBar>,
    quiet: bool,
}

impl MergeProgress {
    /// Nothing is said when `quiet`.
    pub fn new(quiet: bool) -> Self {
        let bar = (!quiet && !logging::is_on() && std::io::stderr().is_terminal()).then(|| {
            let style = ProgressStyle::with_template("{spinner} {msg}");
            let bar = ProgressBar::new_spinner();
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
            bar.enable_steady_tick(Duration::from_millis(200));
            bar
        });
        Self { bar, quiet }
    }

    /// All is done, or it has failed: what is printed next stands alone.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

impl MergeWatcher for MergeProgress {
    fn stage(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.set_message(text.to_owned()),
            None if self.quiet => {}
            None => tell!("{text}"),
        }
    }

    fn warn(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| warning!("{text}")),
            None => warning!("{text}"),
        }
    }
}

impl Drop for MergeProgress {
    fn drop(&mut self) {
        // After an error the spinner must not stand before its message.
        self.finish();
    }
}
