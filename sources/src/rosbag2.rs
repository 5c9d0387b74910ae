//! The folder that `ros2 bag record` makes: `metadata.yaml` beside its files.

use crate::image_list::first_existing;
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};

/// What to do about bags in SQLite.
const CONVERT: &str = "convert it to MCAP: `ros2 bag convert`, or `rosbags-convert` where there is no ROS";

/// The one MCAP file of such a folder; `None` where it is no such folder.
///
/// # Errors
/// When its file is none that is read, or there are several.
pub fn file_in(folder: &Path) -> Result<Option<PathBuf>> {
    if first_existing(folder, &["metadata.yaml"]).is_none() {
        return Ok(None);
    }
    let entries =
        std::fs::read_dir(folder).with_context(|| format!("{}: cannot be read", folder.display()))?;
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.sort();
    let of_kind =
        |kind: &str| files.iter().filter(|file| file.extension().is_some_and(|e| e == kind)).count();
    let of_mcap = || files.iter().find(|file| file.extension().is_some_and(|e| e == "mcap"));
    match (of_kind("mcap"), of_kind("db3")) {
        (0, 0) => Ok(None),
        (1, _) => Ok(of_mcap().cloned()),
        (0, _) => bail!("{}: a ROS 2 bag in SQLite, which is not read\nhint: {CONVERT}", folder.display()),
        (count, _) => bail!(
            "{}: a ROS 2 bag in {count} MCAP files\nhint: give one of them, or make one of all with `mcap merge` or `ros2 bag \
             convert`",
            folder.display()
        ),
    }
}

/// Refuses a bag in SQLite.
///
/// # Errors
/// When it is one.
pub fn refuse_sqlite(file: &Path) -> Result<()> {
    if file.extension().is_some_and(|extension| extension == "db3") {
        bail!("{}: a ROS 2 bag in SQLite, which is not read\nhint: {CONVERT}", file.display());
    }
    Ok(())
}
