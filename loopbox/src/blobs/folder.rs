//! Objects as files.

use super::Blobs;
use anyhow::{Context, Result};
use std::fs;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

/// Objects as files in a folder, which several processes may share: a file has its name once all of it is on the disk.
#[derive(Clone, Debug)]
pub struct FolderBlobs {
    folder: PathBuf,
}

impl FolderBlobs {
    /// Those in `folder`, which is made if it is not there.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn at(folder: &Path) -> Result<Self> {
        fs::create_dir_all(folder).with_context(|| {
            format!(
                "{}: the folder cannot be made\nhint: name one that can be made and written to",
                folder.display()
            )
        })?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// Those in `folder`, which is made once an object is put.
    pub fn not_yet_at(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }

    /// The file of an object.
    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }
}

impl Blobs for FolderBlobs {
    fn get(&self, name: &str) -> Result<Option<Vec<u8>>> {
        match fs::read(self.file(name)) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error).with_context(|| format!("{}: cannot be read", self.address(name))),
        }
    }

    fn has(&self, name: &str) -> Result<bool> {
        self.file(name).try_exists().with_context(|| format!("{}: cannot be read", self.address(name)))
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.file(name);
        let written = || -> io::Result<()> {
            let folder = path.parent().unwrap_or(&self.folder);
            fs::create_dir_all(folder)?;
            let mut file = tempfile::NamedTempFile::new_in(folder)?;
            file.write_all(bytes)?;
            file.as_file().sync_all()?;
            match file.persist_noclobber(&path) {
                // Another process put it meanwhile, and the same.
                Err(refused) if refused.error.kind() == ErrorKind::AlreadyExists => Ok(()),
                Err(refused) => Err(refused.error),
                Ok(_) => Ok(()),
            }
        };
        written().with_context(|| format!("{}: cannot be written", path.display()))
    }

    fn list(&self, prefix: &str) -> Result<Vec<String>> {
        let first = prefix.rsplit_once('/').map_or(String::new(), |(folder, _)| format!("{folder}/"));
        let (mut names, mut folders) = (Vec::new(), vec![first]);
        while let Some(within) = folders.pop() {
            let entries = fs::read_dir(self.file(&within)).and_then(Iterator::collect::<io::Result<Vec<_>>>);
            if entries.as_ref().is_err_and(|error| error.kind() == ErrorKind::NotFound) && !within.is_empty()
            {
                continue;
            }
            for entry in entries.with_context(|| format!("{}: cannot be read", self.address(&within)))? {
                // What is on its way begins with a dot.
                let Some(last) =
                    entry.file_name().to_str().filter(|last| !last.starts_with('.')).map(str::to_owned)
                else {
                    continue;
                };
                let name = format!("{within}{last}");
                match entry.path().is_dir() {
                    true => folders.push(name + "/"),
                    false => names.push(name),
                }
            }
        }
        names.retain(|name| name.starts_with(prefix));
        names.sort();
        Ok(names)
    }

    fn address(&self, name: &str) -> String {
        self.file(name).display().to_string()
    }
}
