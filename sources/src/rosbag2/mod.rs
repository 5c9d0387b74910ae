//! ROS 2 bags: the folder that `ros2 bag record` makes, `metadata.yaml` beside its files, and files in SQLite.

#[cfg(feature = "sqlite")]
mod recording;
#[cfg(feature = "sqlite")]
mod sqlite;

#[cfg(feature = "sqlite")]
pub use recording::open;
#[cfg(feature = "sqlite")]
pub use sqlite::{Message, SqliteBag};

use crate::image_list::first_existing;
use anyhow::{Context, Result, bail};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// What starts every SQLite database (its file format, §1.3).
const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";

/// The files of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Files {
    /// One MCAP file.
    Mcap(PathBuf),
    /// Databases, several where the bag was split.
    Sqlite(Vec<PathBuf>),
}

/// The bag that a path means: a folder of one, or a file in SQLite. `None` where it is neither.
///
/// # Errors
/// When it is one of a form that is not read.
pub fn files_at(path: &Path) -> Result<Option<Files>> {
    if path.is_dir() {
        return files_in(path);
    }
    if path.extension().is_some_and(|extension| extension == "zstd") {
        bail!(
            "{}: a file of a ROS 2 bag, compressed as a whole\nhint: `zstd -d {}` gives the file that is read",
            path.display(),
            path.display()
        );
    }
    Ok(is_sqlite(path).then(|| Files::Sqlite(vec![path.to_owned()])))
}

/// Whether the file starts as databases do.
fn is_sqlite(path: &Path) -> bool {
    let mut start = [0; SQLITE_MAGIC.len()];
    File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start == SQLITE_MAGIC
}

/// The files of a folder; `None` where it is no such folder.
fn files_in(folder: &Path) -> Result<Option<Files>> {
    if first_existing(folder, &["metadata.yaml"]).is_none() {
        return Ok(None);
    }
    let entries =
        std::fs::read_dir(folder).with_context(|| format!("{}: cannot be read", folder.display()))?;
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.sort();
    let of_kind = |kind: &str| -> Vec<PathBuf> {
        files.iter().filter(|file| file.extension().is_some_and(|e| e == kind)).cloned().collect()
    };
    let (mut mcap, sqlite, packed) = (of_kind("mcap"), of_kind("db3"), of_kind("zstd"));
    match (mcap.len(), sqlite.len(), packed.first()) {
        (0, 0, None) => Ok(None),
        (0, 0, Some(file)) => bail!(
            "{}: a ROS 2 bag whose files are compressed as a whole\nhint: `zstd -d {}`, and so each of them, gives files that \
             are read",
            folder.display(),
            file.display()
        ),
        (0, ..) => Ok(Some(Files::Sqlite(sqlite))),
        (1, ..) => Ok(mcap.pop().map(Files::Mcap)),
        (count, ..) => bail!(
            "{}: a ROS 2 bag in {count} MCAP files\nhint: give one of them, or make one of all with `mcap merge` or `ros2 bag \
             convert`",
            folder.display()
        ),
    }
}

/// Refuses a bag in SQLite, which this program was built without.
///
/// # Errors
/// Always.
#[cfg(not(feature = "sqlite"))]
pub fn refuse<T>(files: &[PathBuf]) -> Result<T> {
    let path = files.first().map(|file| file.display().to_string()).unwrap_or_default();
    bail!(
        "{path}: a ROS 2 bag in SQLite, and this program was built without (feature `sqlite`)\n\
         hint: convert it to MCAP: `ros2 bag convert`, or `rosbags-convert` where there is no ROS"
    )
}
