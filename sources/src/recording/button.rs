//! Recording begun and ended while a run goes on.

use super::{Head, Recorder};
use anyhow::Result;
use std::path::{Path, PathBuf};

/// Begins and ends recordings beside a run's results.
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

    /// The first of `recording-1.mcap`, `recording-2.mcap`, … that is not there yet.
    fn next_path(&self) -> PathBuf {
        let numbered = |number: u32| self.folder.join(format!("recording-{number}.mcap"));
        let mut number = 1;
        while numbered(number).exists() {
            number += 1;
        }
        numbered(number)
    }

    /// Begins or ends recording; says where to, for people.
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
