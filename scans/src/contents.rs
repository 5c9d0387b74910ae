//! Which files of a folder are scans, told by their content where their names do not.

use crate::ScanError;
use crate::tables::sort_by_name;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// File names that end so may be scans.
const ENDINGS: [&str; 3] = ["bin", "pcd", "ply"];

/// The scans of a folder, and what looks like some and is not taken.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FolderContents {
    /// Where the scans lie: the folder, or one in it.
    pub folder: PathBuf,
    /// Files of scans, all of one ending.
    pub scans: Vec<PathBuf>,
    /// Files of other endings, of which there are fewer, by ending.
    pub others: BTreeMap<String, Vec<PathBuf>>,
}

/// Where in a folder the scans of a recording may lie.
const PLACES: [&str; 4] = ["velodyne", ".", "velodyne_points/data", "data"];

/// The scans of a folder, or of its `velodyne`, `velodyne_points/data` or `data`, in the order in which people count.
///
/// # Errors
/// When the folder cannot be read.
pub fn folder_contents(path: &Path) -> Result<FolderContents, ScanError> {
    for place in PLACES {
        let folder = if place == "." { path.to_owned() } else { path.join(place) };
        if !folder.is_dir() {
            continue;
        }
        let found = contents_of(folder)?;
        if !found.scans.is_empty() {
            return Ok(found);
        }
    }
    contents_of(path.to_owned())
}

fn contents_of(folder: PathBuf) -> Result<FolderContents, ScanError> {
    let io = |source| ScanError::Io { name: folder.display().to_string(), source };
    let mut by_ending: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    for entry in std::fs::read_dir(&folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let ending = path.extension().unwrap_or_default().to_ascii_lowercase().to_string_lossy().into_owned();
        if ENDINGS.contains(&ending.as_str()) && !is_hidden(&path) && is_scan(&path, &ending) {
            by_ending.entry(ending).or_default().push(path);
        }
    }
    // Of as many of both those that say most of their points.
    let rank = |ending: &str| ["bin", "ply", "pcd"].iter().position(|other| *other == ending);
    let most =
        by_ending.iter().max_by_key(|(ending, files)| (files.len(), rank(ending))).map(|(e, _)| e.clone());
    let mut scans = most.and_then(|most| by_ending.remove(&most)).unwrap_or_default();
    sort_by_name(&mut scans);
    Ok(FolderContents { folder, scans, others: by_ending })
}

/// Whether a file's name begins with a dot: what other systems leave beside files (`._000001.bin`), and not the recording's.
pub(crate) fn is_hidden(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'))
}

/// Whether a file begins as those of its ending do; `.bin` has no beginning of its own.
fn is_scan(path: &Path, ending: &str) -> bool {
    let mut start = [0; 64];
    let Ok(mut file) = File::open(path) else { return path.is_file() };
    let read = file.read(&mut start).unwrap_or(0);
    let text = String::from_utf8_lossy(&start[..read]);
    match ending {
        // What is empty or damaged is told when it is read.
        _ if read == 0 => path.is_file(),
        "ply" => text.starts_with("ply"),
        "pcd" => text.starts_with('#') || text.starts_with("VERSION") || text.starts_with("FIELDS"),
        _ => path.is_file(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        files.iter().for_each(|(name, text)| std::fs::write(folder.path().join(name), text).unwrap());
        folder
    }

    fn names(files: &[PathBuf]) -> Vec<String> {
        files.iter().map(|path| path.file_name().unwrap().to_string_lossy().into_owned()).collect()
    }

    #[test]
    fn the_most_of_one_kind_are_the_scans_and_the_others_are_reported() {
        let dir = folder(&[
            ("1.bin", "xxxx"),
            ("0.bin", "xxxx"),
            ("cloud.ply", "ply\n"),
            ("._0.bin", "x"),
            ("a.txt", ""),
        ]);
        let found = folder_contents(dir.path()).unwrap();
        assert_eq!(names(&found.scans), ["0.bin", "1.bin"]);
        assert_eq!(found.others.keys().collect::<Vec<_>>(), ["ply"]);
        // Files that are called so and are something else.
        let dir = folder(&[
            ("0.ply", "ply\n"),
            ("1.ply", "a polygon"),
            ("map.pcd", "<html>"),
            ("2.pcd", "# .PCD v0.7\n"),
        ]);
        let found = folder_contents(dir.path()).unwrap();
        assert_eq!((names(&found.scans), found.others.len()), (vec!["2.pcd".to_owned()], 1));
    }
}
