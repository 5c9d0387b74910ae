//! The program under test, run as its users do.

use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;
use std::fs::{self, File};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

const PROGRAM: &str = "/bin/loopbox";
const SCRATCH: &str = "/tmp";
/// Nobody in particular.
pub const SOME_USER: u32 = 1000;
/// Longer than anything here takes, emulated on a busy machine.
const PATIENCE: Duration = Duration::from_secs(240);

/// A call of the program that goes on.
pub struct Running {
    child: Child,
    out: PathBuf,
}

/// A call that ended.
pub struct Ended {
    /// How.
    pub status: ExitStatus,
    /// What it printed for people.
    pub messages: String,
    /// What it printed for programs.
    pub output: String,
    /// Its folder for results.
    pub out: PathBuf,
}

/// Starts the program; `OUT` among the arguments stands for an empty folder named after the check.
///
/// # Errors
/// When it cannot be started.
pub fn start(name: &str, arguments: &[&str], user: u32) -> Result<Running> {
    let folder = Path::new(SCRATCH).join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder)?;
    std::os::unix::fs::chown(&folder, Some(user), Some(user))?;
    let out = folder.join("out");
    let place = out.display().to_string();
    let arguments =
        arguments.iter().map(|&argument| if argument == "OUT" { place.as_str() } else { argument });
    let mut command = Command::new(PROGRAM);
    command.args(arguments).stdin(Stdio::null());
    command.stdout(File::create(folder.join("stdout"))?).stderr(File::create(folder.join("stderr"))?);
    if user != 0 {
        command.uid(user).gid(user);
    }
    Ok(Running { child: command.spawn().context(PROGRAM)?, out })
}

/// Runs the program to its end, as root.
///
/// # Errors
/// When it cannot be started or does not end.
pub fn run(name: &str, arguments: &[&str]) -> Result<Ended> {
    start(name, arguments, 0)?.wait()
}

impl Running {
    /// Sends a signal, by the name that `kill` knows.
    ///
    /// # Errors
    /// When the program has ended.
    pub fn signal(&self, signal: &str) -> Result<()> {
        let status = Command::new("/bin/kill").args([signal, &self.child.id().to_string()]).status()?;
        ensure!(status.success(), "{}", self.described("the program has ended"));
        Ok(())
    }

    /// Waits until its messages or its output contain a text.
    ///
    /// # Errors
    /// When it ends before, or takes too long.
    pub fn wait_for_text(&mut self, text: &str) -> Result<()> {
        let start = Instant::now();
        loop {
            if self.text("stdout").contains(text) || self.text("stderr").contains(text) {
                return Ok(());
            }
            if self.child.try_wait()?.is_some() {
                bail!("{}", self.described(&format!("the program ended without '{text}'")));
            }
            if start.elapsed() > PATIENCE {
                bail!("{}", self.described(&format!("the program does not say '{text}'")));
            }
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// How often its output contains a text by now.
    pub fn count(&self, text: &str) -> usize {
        self.text("stdout").matches(text).count()
    }

    /// The time stamp of the frame that it processed last, as its log says.
    pub fn last_frame(&self) -> Option<f64> {
        let text = self.text("stdout");
        let lines = text.lines().rev().filter_map(|line| serde_json::from_str::<Value>(line).ok());
        lines.into_iter().find(|line| line["event"] == "frame")?["frame"]["timestamp"].as_f64()
    }

    /// Waits until it has processed a frame later than `time`.
    ///
    /// # Errors
    /// When it ends before, or takes too long.
    pub fn wait_for_frame(&mut self, time: f64) -> Result<()> {
        let start = Instant::now();
        while self.last_frame().is_none_or(|last| last <= time) {
            if !self.is_running()? {
                bail!("{}", self.described("the program has ended"));
            }
            if start.elapsed() > PATIENCE {
                bail!("{}", self.described("the program processes no frames"));
            }
            thread::sleep(Duration::from_millis(25));
        }
        Ok(())
    }

    /// Whether it still runs.
    ///
    /// # Errors
    /// When the system cannot say.
    pub fn is_running(&mut self) -> Result<bool> {
        Ok(self.child.try_wait()?.is_none())
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// When it does not end in time.
    pub fn wait(mut self) -> Result<Ended> {
        let start = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait()? {
                break status;
            }
            if start.elapsed() > PATIENCE {
                self.child.kill()?;
                bail!("{}", self.described("the program does not end"));
            }
            thread::sleep(Duration::from_millis(10));
        };
        Ok(Ended {
            status,
            messages: self.text("stderr"),
            output: self.text("stdout"),
            out: self.out.clone(),
        })
    }

    fn text(&self, stream: &str) -> String {
        let bytes = fs::read(self.out.with_file_name(stream)).unwrap_or_default();
        String::from_utf8_lossy(&bytes).into_owned()
    }

    fn described(&self, problem: &str) -> String {
        format!(
            "{problem}; its messages:\n{}\n{}",
            end_of(&self.text("stderr")),
            end_of(&self.text("stdout"))
        )
    }
}

impl Ended {
    /// Requires success.
    ///
    /// # Errors
    /// When it failed.
    pub fn succeeded(self) -> Result<Self> {
        ensure!(self.status.success(), "{}:\n{}", self.status, end_of(&self.messages));
        Ok(self)
    }

    /// Requires an orderly refusal whose message has all these words and a hint.
    ///
    /// # Errors
    /// When it succeeded, crashed or said something else.
    pub fn refused(self, words: &[&str]) -> Result<Self> {
        ensure!(self.status.code() == Some(1), "{}:\n{}", self.status, end_of(&self.messages));
        for word in words.iter().chain(&["hint: "]) {
            ensure!(self.messages.contains(word), "no '{word}' in:\n{}", end_of(&self.messages));
        }
        ensure!(!self.messages.contains("panicked"), "{}", self.messages);
        Ok(self)
    }

    /// The numbers in `run.json`.
    ///
    /// # Errors
    /// When there are none.
    pub fn numbers(&self) -> Result<Value> {
        let path = self.out.join("run.json");
        let bytes = fs::read(&path).with_context(|| format!("{}:\n{}", path.display(), self.messages))?;
        Ok(serde_json::from_slice(&bytes)?)
    }
}

/// The last lines of a text.
fn end_of(text: &str) -> String {
    let lines: Vec<&str> = text.lines().collect();
    lines[lines.len().saturating_sub(20)..].join("\n")
}
