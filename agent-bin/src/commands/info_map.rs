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
