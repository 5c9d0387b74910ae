//! The damage in a recording that is read all the same.

use std::fmt::Display;
use std::path::Path;

/// The damages so far.
#[derive(Clone, Debug, Default)]
pub struct Damage {
    first: Option<String>,
    count: u64,
}

impl Damage {
    /// One more.
    pub fn note(&mut self, what: &impl Display) {
        self.count += 1;
        self.first.get_or_insert_with(|| what.to_string());
    }

    /// The warning about a file of which only `read` of `count` images or scans could be read; `None` if all were
    /// read.
    pub fn text(&self, path: &Path, what: &str, read: u64, count: u64) -> Option<String> {
        let first = self.first.as_ref()?;
        let missing = match count.saturating_sub(read) {
            0 => String::new(),
            missing => format!(", {missing} are missing"),
        };
        let places = match self.count {
            1 => String::new(),
            places => format!(", and {} places more", places - 1),
        };
        Some(format!(
            "{}: the file is damaged or ends early; its {read} whole {what} are used{missing} ({first}{places})",
            path.display()
        ))
    }
}
