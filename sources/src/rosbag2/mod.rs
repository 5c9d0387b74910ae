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
use scans::tables::sort_by_name;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// What starts every SQLite database (its file format, §1.3).
const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";

/// The files of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Files {
    /// MCAP files in their order, several where the bag was split.
    Mcap(Vec<PathBuf>),
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

/// The files of a folder of a bag; `None` where it is no such folder.
fn files_in(folder: &Path) -> Result<Option<Files>> {
    if first_existing(folder, &["metadata.yaml"]).is_none() {
        return Ok(None);
    }
    loose_files(folder)
}

/// The files of a bag in a folder that need not have `metadata.yaml`; `None` where it has none.
///
/// # Errors
/// When they are of a form that is not read.
pub fn loose_files(folder: &Path) -> Result<Option<Files>> {
    let (mut mcap, sqlite) = (files_with(folder, "mcap")?, files_with(folder, "db3")?);
    // Results of a run are no recording.
    mcap.retain(|file| !map::is_map_file(file));
    let packed = files_with(folder, "zstd")?;
    match (mcap.is_empty(), sqlite.is_empty(), packed.first()) {
        (false, ..) => Ok(Some(Files::Mcap(mcap))),
        (_, false, _) => Ok(Some(Files::Sqlite(sqlite))),
        (.., None) => Ok(None),
        (.., Some(file)) => bail!(
            "{}: a ROS 2 bag whose files are compressed as a whole\nhint: `zstd -d {}`, and so each of them, gives files that \
             are read",
            folder.display(),
            file.display()
        ),
    }
}

/// The files of a folder whose names end so, in natural order.
///
/// # Errors
/// When the folder cannot be read.
pub fn files_with(folder: &Path, ending: &str) -> Result<Vec<PathBuf>> {
    let entries =
        std::fs::read_dir(folder).with_context(|| format!("{}: cannot be read", folder.display()))?;
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    let is_visible =
        |file: &Path| file.file_name().is_some_and(|name| !name.to_string_lossy().starts_with('.'));
    files.retain(|file| file.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending)) && is_visible(file));
    sort_by_name(&mut files);
    Ok(files)
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
