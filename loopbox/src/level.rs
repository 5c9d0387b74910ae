//! How much a message matters.

use std::fmt;
use std::str::FromStr;

/// How much a message of a program that runs for long matters to who looks after it; the first matters most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// The program ends by it, or leaves out what it was asked for.
    Error,
    /// Something is not as it should be, and the program goes on.
    Warn,
    /// What happens.
    Info,
    /// Each step, for who looks for a fault.
    Debug,
}

impl Level {
    /// All, in this order.
    pub const ALL: [Self; 4] = [Self::Error, Self::Warn, Self::Info, Self::Debug];

    /// Its name, as it is chosen by.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Error => "error",
            Self::Warn => "warn",
            Self::Info => "info",
            Self::Debug => "debug",
        }
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Level {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|level| level.name() == text);
        found.ok_or_else(|| format!("{text} is no level of a log: error, warn, info, debug"))
    }
}
