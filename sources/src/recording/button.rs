//! Starts and stops recording during a run.

use super::{Head, Recorder};
use anyhow::Result;
use std::path::{Path, PathBuf};

/// Starts and stops recordings in a run's folder of results. Clones control the same recorder.
#[derive(Clone)]
pub struct RecordButton {
    recorder: Recorder,
    head: Head,
    folder: PathBuf,
}

impl RecordButton {
    /// Records with `recorder` into new files of `folder`.
    pub fn new(recorder: &Recorder, head: Head, folder: &Path) -> Self {
        Self { recorder: recorder.clone(), head, folder: folder.to_owned() }
    }

    /// `recording-1.mcap`, `recording-2.mcap`, …: the one after the last that is there.
    fn next_path(&self) -> PathBuf {
        let names = std::fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let numbers = names.filter_map(|entry| number_of(&entry.file_name().to_string_lossy()));
        let number = numbers.max().unwrap_or_default().saturating_add(1);
        self.folder.join(format!("recording-{number}.mcap"))
    }

    /// The file that is being recorded to.
    pub fn path(&self) -> Option<PathBuf> {
        self.recorder.path()
    }

    /// Whether writing failed; ending the recording returns the reason.
    pub fn has_failed(&self) -> bool {
        self.recorder.has_failed()
    }

    /// Starts or stops recording; returns a message with the file for people.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn set(&mut self, on: bool) -> Result<String> {
        match (on, self.recorder.is_recording()) {
            (true, true) => Ok("a recording goes on already".into()),
            (false, false) => Ok("nothing is being recorded".into()),
            (true, false) => {
                let path = self.next_path();
                self.recorder.start(&path, &self.head)?;
                Ok(format!("recording to {}", path.display()))
            }
            (false, true) => Ok(self.recorder.stop()?.text()),
        }
    }

    /// Whether frames are being recorded.
    pub fn is_on(&self) -> bool {
        self.recorder.is_recording()
    }
}

/// The number of a recording in a run's folder of results, by its name.
pub fn number_of(name: &str) -> Option<u32> {
    name.strip_prefix("recording-")?.strip_suffix(".mcap")?.parse().ok()
}
