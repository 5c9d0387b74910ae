//! `loopbox verdict` and `loopbox propose`: one pair of maps, and which pairs are worth it.

use super::judging::JudgingArgs;
use super::merge_progress::MergeProgress;
use super::params::ParameterArgs;
use crate::console::{self, Ended, Ending};
use crate::interrupt::stop_on_ctrl_c;
use anyhow::Result;
use clap::Args;
use loopbox::blobs::local_pair;
use loopbox::open::{Sensors, sensors_at};
use loopbox::pairs::{find_verdict, listed_pairs, propose_pairs};
use std::path::PathBuf;

/// Tell whether two maps show one place, and keep the verdict for others; exit code 3 where they are not joined
///
/// A verdict depends on both maps and the parameters alone. With --verdicts it is kept under their SHA-256, so that pairs can be judged
/// by many processes on many machines: `loopbox propose` lists them, `loopbox merge --verdicts` joins what they found.
#[derive(Debug, Args)]
pub struct VerdictArgs {
    /// A map: a map.mcap, the folder of a run, or such by its URI (s3://BUCKET/FOLDER)
    a: PathBuf,
    /// The other map
    b: PathBuf,
    #[command(flatten)]
    judging: JudgingArgs,
    /// Print all numbers as JSON, as among the encounters of merge.json
    #[arg(long)]
    json: bool,
    /// Show no progress
    #[arg(short, long)]
    quiet: bool,
}

/// List the pairs of maps that may show one place, the likeliest first
///
/// A line each: likeness of their likeliest place (0 to 1), and both maps, with tabs between. Of LiDARs every two.
#[derive(Debug, Args)]
pub struct ProposeArgs {
    /// The maps: each a map.mcap, the folder of a run, or such by its URI (s3://BUCKET/FOLDER; s3://BUCKET/FOLDER/* are all there)
    #[arg(required = true, value_name = "MAP")]
    maps: Vec<PathBuf>,
    #[command(flatten)]
    parameters: ParameterArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Show no progress
    #[arg(short, long)]
    quiet: bool,
}

/// Runs `loopbox verdict`.
///
/// # Errors
/// When a map cannot be read, they cannot be compared, the verdict cannot be kept, they are not joined, or the user ended it.
pub fn run(args: &VerdictArgs) -> Result<()> {
    let maps = local_pair(&[args.a.clone(), args.b.clone()], &|text| console::step(args.quiet, text))?;
    let options = args.judging.of_either(sensors_at(&maps) == Sensors::Lidars)?;
    let stop = stop_on_ctrl_c("stopping after this step; no verdict will be kept (Ctrl-C again to abort)")?;
    let progress = MergeProgress::new(args.quiet);
    let found = find_verdict(&maps, &options, &stop, &progress)?;
    progress.finish();
    if args.json {
        console::print(&(serde_json::to_string_pretty(&found.pair_results)? + "\n"))?;
    }
    if !found.joins {
        let text = format!("the maps are not joined\n{}", found.text.trim_end());
        return Err(Ended { ending: Ending::NotMet, text }.into());
    }
    if args.json { Ok(()) } else { console::print(&found.text) }
}

/// Runs `loopbox propose`.
///
/// # Errors
/// When a map cannot be read, or the user ended it.
pub fn propose(args: &ProposeArgs) -> Result<()> {
    let params = args.parameters.of_merging()?;
    let stop = stop_on_ctrl_c("stopping after this step (Ctrl-C again to abort)")?;
    let progress = MergeProgress::new(args.quiet);
    let pairs = propose_pairs(&args.maps, &params, &stop, &progress)?;
    progress.finish();
    let text = if args.json { serde_json::to_string_pretty(&pairs)? + "\n" } else { listed_pairs(&pairs) };
    console::print(&text)
}
