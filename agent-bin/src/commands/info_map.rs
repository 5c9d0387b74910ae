//! `loopbox info` for maps: what a map holds; and maps opened for any command, with their warnings said.

use crate::console::{self, warning};
use loopbox::open::open_map;
use map::Map;
use std::path::{Path, PathBuf};

/// Says what the map at `path` holds, a map file or the folder of results that holds one.
///
/// # Errors
/// When the map cannot be loaded.
pub fn run(path: &Path, json: bool) -> anyhow::Result<()> {
    let (file, map) = load_with_file(path)?;
    let bytes = std::fs::metadata(&file).map(|about| about.len()).ok();
    let summary = map.summary(bytes);
    if json { console::print_json(&summary) } else { console::print(&summary.to_string()) }
}

/// The map at `path`, a map file or the folder of results that holds one; warnings go to standard error.
pub(crate) fn load_at(path: &Path) -> anyhow::Result<Map> {
    Ok(load_with_file(path)?.1)
}

fn load_with_file(path: &Path) -> anyhow::Result<(PathBuf, Map)> {
    let opened = open_map(path)?;
    opened.warnings.iter().for_each(|warning| warning!("{warning}"));
    Ok((opened.file, opened.map))
}
