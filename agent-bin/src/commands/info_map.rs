//! `loopbox info` for maps: what a map holds.

use crate::console::{self, tell};
use crate::results::map_in;
use anyhow::Context;
use map::{LoadedMap, load_map};
use std::path::{Path, PathBuf};

/// Say what a map holds
#[derive(Clone, Debug, clap::Args)]
pub struct InfoMapArgs {
    /// The map: `map.mcap` of a run
    #[arg(value_name = "MAP")]
    pub map: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// Runs `loopbox info` on a map.
///
/// # Errors
/// When the map cannot be loaded.
pub fn run(args: &InfoMapArgs) -> anyhow::Result<()> {
    let loaded = load(&args.map)?;
    let bytes = std::fs::metadata(&args.map).map(|about| about.len()).ok();
    let summary = loaded.map.summary(bytes);
    if args.json {
        let text = serde_json::to_string_pretty(&summary).context("the summary cannot be written as JSON")?;
        console::print(&(text + "\n"))
    } else {
        console::print(&summary.to_string())
    }
}

/// Loads a map and says on standard error what is missing from it.
pub(super) fn load(path: &Path) -> anyhow::Result<LoadedMap> {
    let loaded = load_map(path)?;
    for warning in &loaded.warnings {
        tell!("warning: {}: {warning}", path.display());
    }
    Ok(loaded)
}

/// The file of the map at `path`: a map file, or the folder of results that holds one. What there is to know of a
/// folder's map goes to standard error.
pub(crate) fn map_file_at(path: &Path) -> anyhow::Result<PathBuf> {
    let found = if path.is_dir() { map_in(path) } else { path.is_file().then(|| (path.to_owned(), None)) };
    let Some((file, note)) = found else {
        anyhow::bail!(
            "{}: there is no map\nhint: give a map.mcap, or the folder that `loopbox run` or `loopbox merge` wrote",
            path.display()
        );
    };
    if let Some(note) = note {
        tell!("warning: {}: {note}", path.display());
    }
    Ok(file)
}

/// The map at `path`, a map file or the folder of a run that holds one; warnings go to standard error.
#[cfg(any(feature = "opencv", feature = "view"))]
pub(crate) fn load_at(path: &Path) -> anyhow::Result<map::Map> {
    Ok(load(&map_file_at(path)?)?.map)
}
