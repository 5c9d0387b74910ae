//! Bytes of a recording: a file, or memory for tests and fuzzing.

use anyhow::{Context, Result};
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The place of a recording's bytes.
#[derive(Clone, Debug)]
pub enum Input {
    /// In a file.
    File(PathBuf),
    /// In memory; the path is a name for people.
    Memory(PathBuf, Arc<[u8]>),
}

/// A stream with random access.
pub trait Bytes: Read + Seek + Send {}
impl<T: Read + Seek + Send> Bytes for T {}

impl Input {
    /// A stream from the start, and its length.
    ///
    /// # Errors
    /// When the file cannot be opened.
    pub fn open(&self) -> Result<(BufReader<Box<dyn Bytes>>, u64)> {
        let (bytes, size): (Box<dyn Bytes>, u64) = match self {
            Self::File(path) => {
                let file =
                    File::open(path).with_context(|| format!("{}: cannot be opened", path.display()))?;
                let about = file.metadata().with_context(|| format!("{}: cannot be read", path.display()))?;
                (Box::new(file), about.len())
            }
            Self::Memory(_, bytes) => (Box::new(Cursor::new(Arc::clone(bytes))), bytes.len() as u64),
        };
        Ok((BufReader::with_capacity(1 << 16, bytes), size))
    }

    /// The path, or the name that stands for it.
    pub fn path(&self) -> &Path {
        match self {
            Self::File(path) | Self::Memory(path, _) => path,
        }
    }
}
