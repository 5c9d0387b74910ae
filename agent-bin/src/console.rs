//! What the program says: whoever listens may leave, and the work goes on.

use crate::logging;
use anyhow::{Context, Result};
use loopbox::Level;
use serde::Serialize;
use std::fmt::Arguments;
use std::io::{self, BufWriter, ErrorKind, Write, stdout};
use std::path::Path;
use std::process::{Command, ExitCode, Stdio};

/// Says a line on standard output. Whether anybody reads it changes nothing.
macro_rules! say {
    ($($part:tt)*) => { $crate::console::say_line(format_args!($($part)*)) };
}

/// Says a line on standard error. Whether anybody reads it changes nothing.
macro_rules! tell {
    ($($part:tt)*) => { $crate::console::tell_line(format_args!($($part)*)) };
}

/// Says a warning on standard error.
macro_rules! warning {
    ($($part:tt)*) => { $crate::logging::write(loopbox::Level::Warn, "warning: ", format_args!($($part)*)) };
}

/// Says a step on standard error, where a log is to have these.
macro_rules! debug {
    ($($part:tt)*) => { $crate::logging::write(loopbox::Level::Debug, "", format_args!($($part)*)) };
}

pub(crate) use {debug, say, tell, warning};

/// Says what comes next, unless that is to be quiet.
pub fn step(quiet: bool, text: &str) {
    if !quiet {
        tell!("{text}");
    }
}

/// Shows a file in the program that its owner has for such files; where there is none, that is said.
pub fn show(file: &Path) {
    let program = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let mut command = Command::new(program);
    command.arg(file).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    if let Err(error) = command.spawn() {
        warning!("{} cannot be shown: {program}: {error}", file.display());
    }
}

/// What [`say!`] does.
pub(crate) fn say_line(text: Arguments<'_>) {
    let _ = writeln!(stdout(), "{text}");
}

/// What [`tell!`] does.
pub(crate) fn tell_line(text: Arguments<'_>) {
    logging::write(Level::Info, "", text);
}

/// Prints what a command was asked for. A reader that has closed the pipe (`| head`) has seen enough.
///
/// # Errors
/// When it cannot be written, into a file on a full disk say.
pub(crate) fn print(text: &str) -> Result<()> {
    print_by(|out| out.write_all(text.as_bytes()))
}

/// Prints JSON bit by bit, of what may be more than there is memory for.
///
/// # Errors
/// Those of [`print`].
pub(crate) fn print_streamed(value: &impl Serialize) -> Result<()> {
    print_by(|out| {
        serde_json::to_writer_pretty(&mut *out, value)?;
        out.write_all(b"\n")
    })
}

fn print_by(write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    let mut out = BufWriter::new(stdout().lock());
    match write(&mut out).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(error).context("standard output cannot be written to")
        }
        _ => Ok(()),
    }
}

/// What is printed as JSON: the version of the program, then the fields of `value` (book/src/reference/json.md).
#[derive(Serialize)]
struct Versioned<'a, T> {
    version: &'static str,
    #[serde(flatten)]
    value: &'a T,
}

/// Prints a value that has fields as JSON, with the version of the program.
///
/// # Errors
/// Those of [`print`].
pub(crate) fn print_json(value: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(&Versioned { version: env!("CARGO_PKG_VERSION"), value })?;
    print(&(text + "\n"))
}

/// How the program ends, as its exit code tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ending {
    /// Something failed.
    Failed = 1,
    /// The arguments make no sense; clap's own code for those that it refuses.
    Usage = 2,
    /// All went well, but no two of the maps met.
    NotMet = 3,
    /// What was tracked is saved, but it is less than was asked for.
    TooLittleTracked = 4,
    /// The agent that was asked after is not well, or not there.
    NotWell = 5,
}

/// An error that is told by an exit code of its own.
#[derive(Debug)]
pub(crate) struct Ended {
    pub ending: Ending,
    pub text: String,
}

impl std::fmt::Display for Ended {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for Ended {}

/// What was checked of the arguments: an error ends the program as wrong usage does.
///
/// # Errors
/// That of `checked`.
pub fn usage<T>(checked: Result<T>) -> Result<T> {
    checked.map_err(|error| Ended { ending: Ending::Usage, text: loopbox::explained(&error) }.into())
}

/// Tells an error on standard error and how the program ends by it.
pub fn report(error: &anyhow::Error) -> ExitCode {
    logging::write(Level::Error, "error: ", format_args!("{}", loopbox::explained(error)));
    let ending = error.downcast_ref::<Ended>().map_or(Ending::Failed, |ended| ended.ending);
    ExitCode::from(ending as u8)
}
