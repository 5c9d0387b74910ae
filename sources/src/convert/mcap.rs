//! MCAP as `loopbox record` writes it.

use super::Target;
use crate::recording::{EncodedPicture, Head, RecordingWriter};
use anyhow::Result;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// An MCAP file being written.
pub struct McapTarget {
    writer: RecordingWriter<BufWriter<File>>,
    sync: File,
}

impl McapTarget {
    /// Begins it.
    pub fn create(path: &Path, head: &Head) -> Result<Self> {
        let file = File::create(path)?;
        let sync = file.try_clone()?;
        Ok(Self { writer: RecordingWriter::create(BufWriter::with_capacity(1 << 18, file), head)?, sync })
    }
}

impl Target for McapTarget {
    fn frame(&mut self, index: u64, timestamp: f64, picture: EncodedPicture) -> Result<()> {
        self.writer.frame(index, timestamp, picture)
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.writer.finish(0)?;
        Ok(self.sync.sync_all()?)
    }
}
