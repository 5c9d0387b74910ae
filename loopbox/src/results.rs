//! A folder of results: replaced whole once the new ones are complete, and written by one program at a time.
//!
//! What is on its way lies in folders of the same file system within it, and only takes the place of earlier results
//! when all of it is there. So whatever ends a program, the earlier results or the new ones are whole:
//!
//! | name | what it is |
//! |---|---|
//! | `partial.tmp` | results being written; of no use when the program ended |
//! | `complete.tmp` | results that are whole and being moved to their names; who comes next moves the rest |
//! | `unfinished` | the live map of a run over a folder that holds results: what is left of a killed one |
//! | `unfinished-before` | that of the run before, until this one ends: when two are killed, the later one's stays |
//!
//! In a folder without results, the live map has its final name, `map.mcap`, from the beginning.

pub(crate) mod digest;
mod earlier;
pub(crate) mod file_names;

pub use earlier::{MANIFEST, Owner, map_file_at, map_in};

use anyhow::{Context, Error, Result, bail};
use file_names::MAP;
use map::MapError;
use std::fs::{self, File, TryLockError};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// The folder, among the results of a station, of what LiDARs' maps make: the common map beside it is of cameras.
pub(crate) const COMMON_OF_LIDARS: &str = "lidar";
const PARTIAL: &str = "partial.tmp";
const COMPLETE: &str = "complete.tmp";
const UNFINISHED: &str = "unfinished";
const UNFINISHED_BEFORE: &str = "unfinished-before";
const HINT: &str = "hint: --out must name a folder that can be made and written to";

/// Whether an error is the disk's, which passes.
pub(crate) fn is_of_the_disk(error: &Error) -> bool {
    let kinds = [ErrorKind::StorageFull, ErrorKind::QuotaExceeded, ErrorKind::ReadOnlyFilesystem];
    let reason = |cause: &'_ (dyn std::error::Error + 'static)| match cause.downcast_ref::<MapError>() {
        Some(MapError::Write { reason, .. }) => Some(reason.kind()),
        _ => cause.downcast_ref::<std::io::Error>().map(std::io::Error::kind),
    };
    error.chain().filter_map(reason).any(|kind| kinds.contains(&kind))
}

/// A folder of results that this program writes.
pub struct Results {
    folder: PathBuf,
    /// The outermost folder that was made for this; nothing where the folder was there before.
    made: Option<PathBuf>,
    /// What is written, by names relative to the folder.
    files: Vec<PathBuf>,
    /// Where the live map lies, once there is one.
    live_map: Option<PathBuf>,
    /// Keeps other programs out as long as it is open; the system lets go of it when this program is killed.
    _lock: Option<File>,
}

impl Results {
    /// Makes the folder, keeps other programs from writing there, and makes sure that it can be written to. The results
    /// that are there stay until [`commit`](Self::commit).
    ///
    /// # Errors
    /// When it cannot be made or written to, another program writes there, or it holds results of something else than
    /// `owner`, which only `force` replaces.
    pub fn create(folder: &Path, owner: &Owner, force: bool) -> Result<Self> {
        let missing = folder.ancestors().filter(|part| !part.as_os_str().is_empty() && !part.exists());
        let made = missing.last().map(Path::to_owned);
        fs::create_dir_all(folder)
            .with_context(|| format!("{}: the folder cannot be made\n{HINT}", folder.display()))?;
        let lock = lock(folder)?;
        let results =
            Self { folder: folder.to_owned(), made, files: Vec::new(), live_map: None, _lock: lock };
        if results.at(COMPLETE).is_dir() {
            results.put_in_place()?;
        }
        if !force {
            earlier::refuse_others(folder, owner)?;
        }
        results.make_partial()?;
        Ok(results)
    }

    /// Forgets what was written since the last [`commit`](Self::commit): an attempt that failed leaves files that are none of
    /// the next one's, and takes their room.
    ///
    /// # Errors
    /// When the folder cannot be written to.
    #[cfg(feature = "fleet")]
    pub fn start_over(&mut self) -> Result<()> {
        self.files.clear();
        self.make_partial()
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Whether earlier results are there, others than those `besides`.
    pub fn holds_earlier(&self, besides: &[&str]) -> bool {
        let own = self.live_map.as_deref();
        let others = |name: &PathBuf| !besides.iter().any(|besides| name == Path::new(besides));
        let is_earlier = |name: &PathBuf| others(name) && Some(self.at(name).as_path()) != own;
        earlier::files(&self.folder).iter().any(is_earlier)
    }

    /// Where the map is to grow while the run goes on: what a killed run leaves.
    ///
    /// # Errors
    /// When its folder cannot be made.
    pub fn live_map(&mut self) -> Result<&Path> {
        if self.live_map.is_none() {
            let home = if self.holds_earlier(&[]) { self.make_unfinished()? } else { self.folder.clone() };
            self.live_map = Some(home.join(MAP));
        }
        Ok(self.live_map.as_deref().unwrap_or(&self.folder))
    }

    /// Forgets the live map: nothing came of it.
    pub fn discard_live_map(&mut self) {
        if let Some(path) = self.live_map.take() {
            // Nobody is hurt by what stays: it says itself what it is.
            let _ = fs::remove_file(&path);
            if path.parent() == Some(self.at(UNFINISHED).as_path()) {
                let _ = fs::remove_dir(self.at(UNFINISHED));
                let _ = fs::rename(self.at(UNFINISHED_BEFORE), self.at(UNFINISHED));
            }
        }
    }

    /// Leaves the live map as the result.
    pub fn keep_live_map(&mut self) {
        (self.made, self.live_map) = (None, None);
    }

    /// Where to write the file `name`, relative to the folder; its own folder is made.
    ///
    /// # Errors
    /// When that cannot be made.
    pub fn file(&mut self, name: impl AsRef<Path>) -> Result<PathBuf> {
        let path = self.at(PARTIAL).join(&name);
        let parent = path.parent().unwrap_or(&path);
        fs::create_dir_all(parent).with_context(|| format!("{}: cannot be made", parent.display()))?;
        self.files.push(name.as_ref().to_owned());
        Ok(path)
    }

    /// The names of the files so far.
    pub fn names(&self) -> Vec<String> {
        self.files.iter().map(|name| name.display().to_string()).collect()
    }

    /// Puts the new results in the place of the earlier ones.
    ///
    /// # Errors
    /// Names the file that cannot be moved; what is not yet in place stays in `complete.tmp`.
    pub fn commit(&mut self) -> Result<()> {
        let (partial, complete) = (self.at(PARTIAL), self.at(COMPLETE));
        // The names are on the disk before they take the place of others.
        let synced = File::open(&partial).and_then(|folder| folder.sync_all());
        synced
            .and_then(|()| fs::rename(&partial, &complete))
            .with_context(|| format!("{}: cannot be written", complete.display()))?;
        self.put_in_place()?;
        self.made = None;
        self.live_map = None;
        self.files.clear();
        Ok(())
    }

    /// Removes the earlier results and moves the complete ones to their names.
    fn put_in_place(&self) -> Result<()> {
        let complete = self.at(COMPLETE);
        let new = within(&complete).with_context(|| format!("{}: cannot be read", complete.display()))?;
        for name in earlier::files(&self.folder).into_iter().filter(|name| !new.contains(name)) {
            let path = self.at(&name);
            fs::remove_file(&path)
                .with_context(|| format!("{}: the earlier result cannot be replaced", path.display()))?;
            if let Some(parent) = path.parent().filter(|parent| *parent != self.folder) {
                // Only what is empty goes.
                let _ = fs::remove_dir(parent);
            }
        }
        for name in &new {
            let (from, to) = (complete.join(name), self.at(name));
            to.parent()
                .map_or(Ok(()), fs::create_dir_all)
                .and_then(|()| fs::rename(&from, &to))
                .with_context(|| format!("{}: cannot be written", to.display()))?;
        }
        for name in [UNFINISHED, UNFINISHED_BEFORE] {
            // A map that was never finished has its successor now.
            self.remove_unfinished(name);
        }
        fs::remove_dir_all(&complete).with_context(|| format!("{}: cannot be removed", complete.display()))
    }

    /// Makes the folder for a map that grows beside earlier results; what a killed run left there steps aside.
    fn make_unfinished(&self) -> Result<PathBuf> {
        let home = self.at(UNFINISHED);
        if home.join(MAP).is_file() {
            self.remove_unfinished(UNFINISHED_BEFORE);
            fs::rename(&home, self.at(UNFINISHED_BEFORE))
                .with_context(|| format!("{}: cannot be moved aside", home.display()))?;
        }
        fs::create_dir_all(&home).with_context(|| format!("{}: cannot be made", home.display()))?;
        Ok(home)
    }

    /// Removes an unfinished map; of its folder only what is empty goes.
    fn remove_unfinished(&self, name: &str) {
        let _ = fs::remove_file(self.at(name).join(MAP));
        let _ = fs::remove_dir(self.at(name));
    }

    /// An empty folder for what is on its way.
    fn make_partial(&self) -> Result<()> {
        self.clear_partial()?;
        let context = || format!("{}: the folder cannot be written to\n{HINT}", self.folder.display());
        fs::create_dir(self.at(PARTIAL)).with_context(context)
    }

    fn clear_partial(&self) -> Result<()> {
        let partial = self.at(PARTIAL);
        match fs::remove_dir_all(&partial) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(error).with_context(|| format!("{}: cannot be removed", partial.display()))
            }
            _ => Ok(()),
        }
    }

    fn at(&self, name: impl AsRef<Path>) -> PathBuf {
        self.folder.join(name)
    }
}

impl Drop for Results {
    fn drop(&mut self) {
        // What cannot be removed is named as what it is.
        let _ = self.clear_partial();
        if let Some(made) = &self.made {
            let within = self.folder.ancestors().take_while(|part| part.starts_with(made));
            // Only what is empty goes: others may have come to use it.
            within.for_each(|part| drop(fs::remove_dir(part)));
        }
    }
}

/// Refuses to write where a map to be read is: its file would be replaced.
///
/// # Errors
/// When the folder is that of one of `maps`, files or folders of runs.
pub fn keep_from(folder: &Path, maps: &[PathBuf]) -> Result<()> {
    let Ok(out) = folder.canonicalize() else { return Ok(()) };
    for map in maps {
        let Ok(found) = map.canonicalize() else { continue };
        let home = if found.is_dir() { Some(found.as_path()) } else { found.parent() };
        if home == Some(&out) {
            bail!(
                "{}: holds {}, which the results would replace\nhint: give --out another folder",
                folder.display(),
                map.display()
            );
        }
    }
    Ok(())
}

/// Keeps others from writing into a folder. Nothing where its file system has no locks.
///
/// # Errors
/// When another program writes there.
pub(crate) fn lock(folder: &Path) -> Result<Option<File>> {
    let Ok(file) = File::open(folder) else { return Ok(None) };
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => bail!(
            "{}: another loopbox is writing its results there\nhint: wait until it has ended, or give another folder \
             (--out, or `out` in an agent's file)",
            folder.display()
        ),
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// The files of a folder and of those within it, by names relative to it, in order.
fn within(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    let mut open = vec![PathBuf::new()];
    while let Some(part) = open.pop() {
        for entry in fs::read_dir(folder.join(&part))? {
            let entry = entry?;
            let name = part.join(entry.file_name());
            if entry.file_type()?.is_dir() { open.push(name) } else { found.push(name) }
        }
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests;
