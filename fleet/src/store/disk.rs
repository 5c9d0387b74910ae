//! What a store does with a disk.

#[cfg(test)]
pub(crate) mod cut;

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

/// Files and folders that are synced one by one; more of them together, by one call for all that the file system holds back.
const FEW: usize = 3;

/// Files in folders.
pub trait Disk: Send + Sync + 'static {
    /// All files in a folder and those within, with their lengths. The folder is made if it is not there.
    ///
    /// # Errors
    /// When the system refuses.
    fn files(&self, folder: &Path) -> io::Result<Vec<(PathBuf, u64)>>;

    /// A file's content.
    ///
    /// # Errors
    /// When there is none, or it cannot be read.
    fn read(&self, path: &Path) -> io::Result<Vec<u8>>;

    /// Writes a file, perhaps not to the disk yet. The folder is made if it is not there.
    ///
    /// # Errors
    /// When the system refuses, on a full disk say.
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;

    /// Gives a file another name, perhaps not on the disk yet. The folder is made if it is not there.
    ///
    /// # Errors
    /// When the system refuses.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Removes a file, if it is there.
    fn remove(&self, path: &Path);

    /// Brings the content of files, and the names in folders, to the disk.
    ///
    /// # Errors
    /// When the system refuses: then none of it may be there, and what was written is to be written again.
    fn sync(&self, paths: &[PathBuf]) -> io::Result<()>;
}

/// The system's.
#[derive(Clone, Copy, Debug, Default)]
pub struct System;

impl Disk for System {
    fn files(&self, folder: &Path) -> io::Result<Vec<(PathBuf, u64)>> {
        fs::create_dir_all(folder)?;
        let (mut files, mut folders) = (Vec::new(), vec![folder.to_owned()]);
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder)? {
                let entry = entry?;
                let about = entry.metadata()?;
                match about.is_dir() {
                    true => folders.push(entry.path()),
                    false => files.push((entry.path(), about.len())),
                }
            }
        }
        Ok(files)
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        fs::read(path)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        path.parent().map_or(Ok(()), fs::create_dir_all)?;
        let written = fs::write(path, bytes);
        if written.is_err() {
            // It takes no room that is needed.
            let _ = fs::remove_file(path);
        }
        written
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        to.parent().map_or(Ok(()), fs::create_dir_all)?;
        fs::rename(from, to)
    }

    fn remove(&self, path: &Path) {
        // It may be gone already.
        let _ = fs::remove_file(path);
    }

    fn sync(&self, paths: &[PathBuf]) -> io::Result<()> {
        #[cfg(target_os = "linux")]
        if paths.len() > FEW {
            // Says since Linux 5.8 (syncfs(2)) whether anything could not be written.
            return Ok(rustix::fs::syncfs(File::open(&paths[0])?)?);
        }
        paths.iter().try_for_each(|path| File::open(path)?.sync_all())
    }
}
