//! Folders of sequences.

use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};

/// The name of a sequence's folder.
pub fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The folders of `data` that are sequences with ground truth, by name.
///
/// # Errors
/// When the folder cannot be read, or holds none.
pub fn sequences(data: &Path, only: &[String]) -> Result<Vec<PathBuf>> {
    let unreadable = || format!("{}: the folder of sequences cannot be read", data.display());
    let mut found = Vec::new();
    for entry in std::fs::read_dir(data).with_context(unreadable)? {
        let path = entry.with_context(unreadable)?.path();
        let complete = path.join("groundtruth.txt").is_file() && path.join("times.txt").is_file();
        if complete && (only.is_empty() || only.contains(&name(&path))) {
            found.push(path);
        }
    }
    if found.is_empty() {
        bail!("{}: holds no sequence with times.txt and groundtruth.txt to measure", data.display());
    }
    found.sort();
    Ok(found)
}
