//! The system's `ffmpeg` and `ffprobe`, which read and write video files in processes of their own.

use anyhow::{Context, Result, bail};
use std::ffi::OsString;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::{self, JoinHandle};

/// Where the two programs come from, for people.
const INSTALL: &str = "hint: install ffmpeg, which has ffprobe with it (Debian and Ubuntu: `apt install ffmpeg`, Fedora: \
                       `dnf install ffmpeg-free`, macOS: `brew install ffmpeg`)";
/// Lines of a log that are repeated.
const MAX_REASONS: usize = 3;
/// Bytes of a line of their log that are looked at.
const MAX_LINE: u64 = 4096;

/// The name by which ffmpeg opens this file and nothing else: `file:` keeps names such as `a:b.mp4` or `-x.mp4` from
/// being taken for an address or an option.
pub fn file_name(path: &Path) -> OsString {
    let mut name = OsString::from("file:");
    name.push(path);
    name
}

/// `ffmpeg` or `ffprobe`, without an input and without colours in its log.
pub fn command(program: &str) -> Command {
    let mut command = Command::new(program);
    command.stdin(Stdio::null()).env("AV_LOG_FORCE_NOCOLOR", "1").arg("-hide_banner");
    command
}

/// A program that runs; it is ended when this is dropped.
pub struct Running(Child);

impl Running {
    /// Starts a program.
    ///
    /// # Errors
    /// When it is not installed, with what to install.
    pub fn start(command: &mut Command) -> Result<Self> {
        match command.spawn() {
            Ok(child) => Ok(Self(child)),
            Err(error) if error.kind() == ErrorKind::NotFound => Err(missing(command)),
            Err(error) => Err(error).with_context(|| format!("{} cannot be started", name(command))),
        }
    }

    /// The process.
    pub fn child(&mut self) -> &mut Child {
        &mut self.0
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// When the system cannot say how it ended.
    pub fn wait(&mut self) -> Result<ExitStatus> {
        Ok(self.0.wait()?)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // One that has ended already is no error here, and nobody waits for another.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs a program to its end and returns what it printed.
///
/// # Errors
/// When it is not installed, or ends with an error: then with what its log says.
pub fn output(command: &mut Command) -> Result<Vec<u8>> {
    let ran = match command.stdout(Stdio::piped()).stderr(Stdio::piped()).output() {
        Ok(ran) => ran,
        Err(error) if error.kind() == ErrorKind::NotFound => return Err(missing(command)),
        Err(error) => return Err(error).with_context(|| format!("{} cannot be started", name(command))),
    };
    if !ran.status.success() {
        bail!("{}", reasons(&String::from_utf8_lossy(&ran.stderr)));
    }
    Ok(ran.stdout)
}

/// The versions of both programs.
///
/// # Errors
/// When one is not installed, with what to install.
pub fn versions() -> Result<[String; 2]> {
    let version = |program| -> Result<String> {
        Ok(version_text(program)?.split_whitespace().take(3).collect::<Vec<_>>().join(" "))
    };
    Ok([version("ffmpeg")?, version("ffprobe")?])
}

/// The version that `ffmpeg` or `ffprobe` prints.
///
/// # Errors
/// When it is not installed, or ends with an error.
pub fn version_text(program: &str) -> Result<String> {
    let printed = output(command(program).arg("-version"))?;
    Ok(String::from_utf8_lossy(&printed).into_owned())
}

/// What a log says, each of it once; the last few lines of a long one.
fn reasons(log: &str) -> String {
    let mut all: Vec<String> = log.lines().filter(|line| !line.trim().is_empty()).map(reason).collect();
    all.dedup();
    let last = &all[all.len().saturating_sub(MAX_REASONS)..];
    if last.is_empty() { "it does not say why".to_owned() } else { last.join("; ") }
}

fn name(command: &Command) -> String {
    command.get_program().to_string_lossy().into_owned()
}

fn missing(command: &Command) -> anyhow::Error {
    anyhow::anyhow!(
        "video files are read and written by {}, which is not installed\n{INSTALL}",
        name(command)
    )
}

/// A line of a log without what stands before its text: `[h264 @ 0x5581] [error] `, or the file's name.
pub fn reason(line: &str) -> String {
    let mut text = line.trim();
    while let Some((_, rest)) = text.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        text = rest.trim_start();
    }
    let after_name = text.strip_prefix("file:").and_then(|rest| rest.rsplit_once(": "));
    after_name.map_or(text, |(_, rest)| rest).to_owned()
}

/// Gives every line of a log to `take`, in a thread of its own, so that its writer never waits for its reader.
pub fn follow(
    log: impl Read + Send + 'static,
    mut take: impl FnMut(&str) + Send + 'static,
) -> JoinHandle<()> {
    thread::spawn(move || {
        let mut log = BufReader::new(log);
        let mut line = Vec::new();
        loop {
            line.clear();
            match (&mut log).take(MAX_LINE).read_until(b'\n', &mut line) {
                Ok(0) | Err(_) => return,
                Ok(_) => take(String::from_utf8_lossy(&line).trim_end()),
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_is_not_there_is_named_with_what_to_install() {
        let error = output(&mut Command::new("loopbox-has-no-such-program")).unwrap_err().to_string();
        assert!(error.contains("loopbox-has-no-such-program, which is not installed"), "{error}");
        assert!(error.contains("apt install ffmpeg"), "{error}");
        let error = Running::start(&mut Command::new("loopbox-has-no-such-program")).err().unwrap();
        assert!(error.to_string().contains("apt install ffmpeg"), "{error}");
    }

    #[test]
    fn the_reason_is_what_a_log_says_without_its_marks() {
        assert_eq!(reason("[mov,mp4 @ 0x55] [error] moov atom not found\n"), "moov atom not found");
        assert_eq!(reason("[error] file:/a: b.mp4: Invalid data found"), "Invalid data found");
        assert_eq!(reason("plain"), "plain");
        assert_eq!(
            reasons("[mov @ 0x5] moov atom not found\nfile:x.mp4: Invalid data\n"),
            "moov atom not found; Invalid data"
        );
        assert_eq!(reasons("\n"), "it does not say why");
    }

    #[test]
    fn a_name_cannot_be_taken_for_an_address_or_an_option() {
        assert_eq!(file_name(Path::new("http://x/y.mp4")), "file:http://x/y.mp4");
        assert_eq!(file_name(Path::new("-i.mp4")), "file:-i.mp4");
    }
}
