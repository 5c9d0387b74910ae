//! The log of programs that run for long: what happens, on standard error, with its time and how much it matters.
//!
//! Who chooses no level reads the same messages as people read them at a terminal, without times.

use crate::console::usage;
use anyhow::{Result, anyhow};
use loopbox::Level;
use std::fmt::Arguments;
use std::io::{Write, stderr};
use std::sync::OnceLock;
use std::time::{SystemTime, UNIX_EPOCH};

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
    usage(of_environment()).map(|_| ())
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
            writeln!(stderr(), "{} {:5} {text}", time(SystemTime::now()), level.name().to_uppercase())
        }
        None if level < Level::Debug => writeln!(stderr(), "{mark}{text}"),
        _ => Ok(()),
    };
}

/// An instant as ISO 8601 has it, in UTC, to the millisecond: `2026-11-28T11:50:48.123Z`.
fn time(at: SystemTime) -> String {
    let since = at.duration_since(UNIX_EPOCH).unwrap_or_default();
    let (seconds, millis) = (since.as_secs(), since.subsec_millis());
    let (days, second) = (seconds / 86_400, seconds % 86_400);
    let (year, month, day) = date(days);
    let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{millis:03}Z")
}

/// Year, month and day of the Gregorian calendar, so many days after 1970-01-01. Years begin in March here, so that the leap day is the last
/// of one; 400 of them have 146,097 days.
fn date(days: u64) -> (u64, u64, u64) {
    // 1970-01-01 is day 719,468 since 0000-03-01.
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    // Five months from March on, and from August on, have 153 days.
    let from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    (era * 400 + year + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn instants_are_written_as_calendars_have_them() {
        let at = |seconds, millis| time(UNIX_EPOCH + Duration::new(seconds, millis * 1_000_000));
        assert_eq!(at(0, 0), "1970-01-01T00:00:00.000Z");
        assert_eq!(at(951_782_399, 999), "2000-02-28T23:59:59.999Z");
        assert_eq!(at(951_782_400, 1), "2000-02-29T00:00:00.001Z");
        assert_eq!(at(1_709_251_199, 0), "2024-02-29T23:59:59.000Z");
        assert_eq!(at(1_764_331_261, 7), "2025-11-28T12:01:01.007Z");
        assert_eq!(at(4_107_542_400, 0), "2100-03-01T00:00:00.000Z");
    }
}
