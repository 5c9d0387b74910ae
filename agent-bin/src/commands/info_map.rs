//! `loopbox info` for maps: what a map holds.

use anyhow::Context;
use map::{LoadedMap, load_map};
use std::io::{Write, stdout};
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
        writeln!(stdout(), "{text}")?;
    } else {
        write!(stdout(), "{summary}")?;
    }
    Ok(())
}

/// Loads a map and says on standard error what is missing from it.
pub(super) fn load(path: &Path) -> anyhow::Result<LoadedMap> {
    let loaded = load_map(path)?;
    for warning in &loaded.warnings {
        eprintln!("warning: {}: {warning}", path.display());
    }
    Ok(loaded)
}

/// The map at `path`, a map file or the folder of a run that holds one; warnings go to standard error.
#[cfg(any(feature = "opencv", feature = "view"))]
pub(crate) fn load_at(path: &Path) -> anyhow::Result<map::Map> {
    let file = if path.is_dir() { path.join("map.mcap") } else { path.to_owned() };
    if !file.is_file() {
        anyhow::bail!(
            "{}: there is no map\nhint: give a map.mcap, or the folder that `loopbox run` or `loopbox merge` wrote",
            file.display()
        );
    }
    Ok(load(&file)?.map)
}
