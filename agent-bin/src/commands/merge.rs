//! `loopbox merge`: several agents' maps into one.

use crate::merging::{Input, MergingParams, merge, method_parser};
use anyhow::{Result, bail};
use clap::Args;
use merge::method::Method;
use place_recog::Vocabulary;
use std::path::PathBuf;

/// Merge the maps of several agents into one common map
#[derive(Debug, Args)]
pub struct MergeArgs {
    /// The maps: each a map.mcap, or the folder of a run. Those that met join the world of the first
    #[arg(required = true, num_args = 2.., value_name = "MAP")]
    maps: Vec<PathBuf>,
    /// Folder for the results
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// How maps are joined where they met; all but loop-box are there to compare it with
    #[arg(long, value_name = "METHOD", default_value_t, value_parser = method_parser())]
    method: Method,
}

/// Runs `loopbox merge`.
///
/// # Errors
/// When a map cannot be read or the common map cannot be made or written, or no two of the maps met.
pub fn run(args: &MergeArgs) -> Result<()> {
    let vocabulary = Vocabulary::shipped();
    let inputs: Vec<Input> =
        args.maps.iter().map(|path| Input::load(path, &vocabulary)).collect::<Result<_>>()?;
    let params = MergingParams { method: args.method, ..MergingParams::default() };
    let merging = merge(&inputs, &vocabulary, &params, &mut |text| eprintln!("{text}"))?;
    if merging.fused.iter().all(|fused| fused.agents.len() == 1) {
        bail!("no two of the maps met");
    }
    std::fs::create_dir_all(&args.out)?;
    for fused in &merging.fused {
        map::save_map(args.out.join("map.mcap"), &fused.map)?;
    }
    Ok(())
}
