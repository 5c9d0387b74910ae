//! The log of programs that run for long: what happens, on standard error, with its time and how much it matters.
//!
//! Who chooses no level reads the same messages as people read them at a terminal, without times.

use anyhow::{Result, anyhow};
use loopbox::Level;
use std::fmt::Arguments;
use std::io::{Write, stderr};
use std::sync::OnceLock;
use std::time::SystemTime;

/// The environment's word for it, for every command.
const VARIABLE: &str = "LOOPBOX_LOG";

/// What is written at the most; nothing where no level was chosen.
static LIMIT: OnceLock<Option<Level>> = OnceLock::new();

/// The argument for it.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct LogArg {
    /// Write what happens to standard error with its time (UTC) and level, of this level and those before it: error, warn, info, debug.
    /// Without it LOOPBOX_LOG says which; without both, all but debug is written, without times
    #[arg(long, value_name = "LEVEL")]
    log: Option<Level>,
}

impl LogArg {
    /// Has all that follows written as it says.
    pub fn start(self) {
        if self.log.is_some() {
            // Nothing was written yet.
            let _ = LIMIT.set(self.log);
        }
    }
}

/// What the environment says; nothing where it says nothing.
fn of_environment() -> Result<Option<Level>> {
    let Some(text) = std::env::var_os(VARIABLE).filter(|text| !text.is_empty()) else { return Ok(None) };
    text.to_string_lossy().parse().map(Some).map_err(|why: String| anyhow!("{VARIABLE}: {why}"))
}

/// Makes sure that what the environment says is a level.
///
/// # Errors
/// When it is none.
pub fn check_environment() -> Result<()> {
    of_environment().map(|_| ())
}

/// What is written at the most; nothing where no level was chosen.
fn limit() -> Option<Level> {
    *LIMIT.get_or_init(|| of_environment().unwrap_or_default())
}

/// Whether a level was chosen.
pub(crate) fn is_on() -> bool {
    limit().is_some()
}

/// Writes a message, which stands behind `mark` where no level was chosen. Whether anybody reads it changes nothing.
pub(crate) fn write(level: Level, mark: &str, text: Arguments<'_>) {
    let _ = match limit() {
        Some(limit) if level <= limit => {
            // A message is a line, whatever is in it.
            let text = text.to_string().replace('\n', "; ");
            let time = humantime::format_rfc3339_millis(SystemTime::now());
            writeln!(stderr(), "{time} {:5} {text}", level.name().to_uppercase())
        }
        None if level < Level::Debug => writeln!(stderr(), "{mark}{text}"),
        _ => Ok(()),
    };
}
