//! The results that lie in a folder: whose they are, which files they are.

use super::{COMMON_OF_LIDARS, COMPLETE, MAP, UNFINISHED, UNFINISHED_BEFORE};
use anyhow::{Result, bail};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Component, Path, PathBuf};

const RUN: &str = "run.json";
const MERGE: &str = "merge.json";
const UNMERGE: &str = "unmerge.json";
/// The file that says what a common map is made of.
pub const MANIFEST: &str = "manifest.json";
/// Every file that a run, a merge or taking a merge apart writes under this name.
const NAMES: [&str; 8] = [MAP, "trajectory.txt", "cloud.ply", "report.html", RUN, MERGE, UNMERGE, MANIFEST];

/// Whose results a folder holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Owner {
    /// Those of a run over this source.
    Run(PathBuf),
    /// Those of a merge.
    Merge,
    /// Those of a merge that was taken apart.
    Unmerge,
}

impl Owner {
    /// Whose results are in a folder; nothing where there are none, or nobody says whose.
    fn of(folder: &Path) -> Option<Self> {
        if folder.join(MERGE).is_file() || folder.join(MANIFEST).is_file() {
            return Some(Self::Merge);
        }
        if folder.join(UNMERGE).is_file() {
            return Some(Self::Unmerge);
        }
        // The numbers alone are those of a run that came to nothing.
        let source = read_json(&folder.join(RUN))["source"]["path"].as_str().map(PathBuf::from)?;
        folder.join(MAP).is_file().then_some(Self::Run(source))
    }

    fn is_like(&self, other: &Self) -> bool {
        let whole = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
        match (self, other) {
            (Self::Run(one), Self::Run(two)) => whole(one) == whole(two),
            _ => self == other,
        }
    }
}

impl std::fmt::Display for Owner {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Run(source) => write!(f, "a run over {}", source.display()),
            Self::Merge => write!(f, "a merge"),
            Self::Unmerge => write!(f, "a merge that was taken apart"),
        }
    }
}

/// Refuses to replace results of something else.
///
/// # Errors
/// Says whose they are.
pub fn refuse_others(folder: &Path, owner: &Owner) -> Result<()> {
    match Owner::of(folder) {
        Some(there) if !there.is_like(owner) => bail!(
            "{}: holds the results of {there}\nhint: give --out another folder; --force replaces them, once the new ones \
             are complete",
            folder.display()
        ),
        _ => Ok(()),
    }
}

/// The results that are in a folder, by names relative to it.
pub fn files(folder: &Path) -> BTreeSet<PathBuf> {
    let mut names: BTreeSet<PathBuf> = NAMES.map(PathBuf::from).into();
    for list in [RUN, MERGE, UNMERGE] {
        let record = read_json(&folder.join(list));
        let listed = record["files"].as_array().into_iter().flatten().filter_map(|name| name.as_str());
        names.extend(listed.map(PathBuf::from).filter(|name| is_result(name)));
    }
    names.retain(|name| folder.join(name).is_file());
    names
}

/// Whether a listed name may be that of a result: the list may say anything.
fn is_result(name: &Path) -> bool {
    let parts: Vec<Component> = name.components().collect();
    match parts[..] {
        [Component::Normal(_)] => true,
        // An agent's own map.
        [Component::Normal(_), Component::Normal(file)] => file == MAP,
        _ => false,
    }
}

/// The map among the results in a folder, and what the user should know of it. Of results that are not in place yet
/// it is the new one; where none was written, the manifest that makes one; without any it is what a run left that did not end.
pub fn map_in(folder: &Path) -> Option<(PathBuf, Option<String>)> {
    let map_of = |homes: &[[&str; 2]]| {
        homes.iter().map(|[home, name]| folder.join(home).join(name)).find(|path| path.is_file())
    };
    let whole = map_of(&[[COMPLETE, MAP], ["", MAP], [COMPLETE, MANIFEST], ["", MANIFEST]]);
    let left = map_of(&[[UNFINISHED, MAP], [UNFINISHED_BEFORE, MAP]]);
    let note = left.as_ref().map(|left| {
        let older = if whole.is_some() { "; this one is older" } else { "" };
        format!("{} is the map of a run that has not ended{older}", left.display())
    });
    whole.or(left).map(|path| (path, note))
}

/// The file of the map at `path`: a map file or a manifest, or the folder of results that holds one; with what there is to know of a
/// folder's map.
///
/// # Errors
/// When there is no map.
pub fn map_file_at(path: &Path) -> Result<(PathBuf, Option<String>)> {
    let found = if path.is_dir() { map_in(path) } else { path.is_file().then(|| (path.to_owned(), None)) };
    let Some((file, note)) = found else {
        let of_lidars = path.join(COMMON_OF_LIDARS);
        if map_in(&of_lidars).is_some() {
            let (path, of_lidars) = (path.display(), of_lidars.display());
            bail!("{path}: there is no map of cameras\nhint: that of the LiDARs is in {of_lidars}");
        }
        bail!(
            "{}: there is no map\nhint: give a map.mcap, or the folder that `loopbox run` or `loopbox merge` wrote",
            path.display()
        );
    };
    Ok((file, note.map(|note| format!("{}: {note}", path.display()))))
}

fn read_json(path: &Path) -> Value {
    fs::read(path).ok().and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default()
}
