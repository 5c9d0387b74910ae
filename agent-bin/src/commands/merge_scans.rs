//! `loopbox merge` of LiDAR maps.

use crate::console::{self, Ended, Ending, tell};
use crate::interrupt::stop_on_ctrl_c;
use anyhow::Result;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use loopbox::lidar::{LidarMerged, merge_maps};
use loopbox::open::map_file_at;
use map::SensorKind;
use slam_lidar::merging::MergeMethod;
use std::path::{Path, PathBuf};

/// What `loopbox merge` is asked for, whatever the maps' sensors.
#[derive(Debug, clap::Args)]
pub struct MergeScansArgs {
    /// The maps: each a map.mcap, or the folder of a run. Those that met join the world of the first
    #[arg(required = true, value_name = "MAP")]
    pub maps: Vec<PathBuf>,
    /// Folder for the results; made if it is not there
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Replace results of a run in that folder, once the new ones are complete
    #[arg(long)]
    pub force: bool,
    /// How the pose between two maps is found: pieces, loopbox's own, or emr, the paper's
    #[arg(long, value_name = "METHOD", value_parser = method_parser())]
    pub method: Option<MergeMethod>,
    /// Print all numbers as JSON, as they are in merge.json, instead of the verdicts
    #[arg(long)]
    pub json: bool,
    /// Show no progress
    #[arg(long)]
    pub quiet: bool,
}

fn method_parser() -> impl TypedValueParser<Value = MergeMethod> {
    PossibleValuesParser::new(MergeMethod::ALL.map(MergeMethod::name))
        .map(|name| MergeMethod::ALL.into_iter().find(|method| method.name() == name).unwrap_or_default())
}

/// Whether any of the maps is a LiDAR's, by the first lines of their files.
pub fn any_lidar(maps: &[PathBuf]) -> bool {
    maps.iter().any(|path| is_lidar(path))
}

fn is_lidar(path: &Path) -> bool {
    let Ok((file, _)) = map_file_at(path) else { return false };
    map::sensors_of(file).is_ok_and(|kinds| kinds.contains(&SensorKind::Lidar))
}

/// Merges them.
///
/// # Errors
/// When a map cannot be read or is not a LiDAR's, no two of the maps met, the results cannot be written, or the user
/// ended it. Then nothing is written.
pub fn run(args: &MergeScansArgs) -> Result<()> {
    let stop = stop_on_ctrl_c("stopping after this step; nothing will be written (Ctrl-C again to abort)")?;
    let mut stage = |text: &str| {
        if !args.quiet {
            tell!("{text}");
        }
    };
    let method = args.method.unwrap_or_default();
    let merged = merge_maps(&args.maps, &args.out, args.force, method, &stop, &mut stage)?;
    merged.warnings.iter().for_each(|warning| tell!("warning: {warning}"));
    if args.json {
        console::print(&(serde_json::to_string_pretty(&merged.record)? + "\n"))?;
    }
    if !merged.merging.anything_met() {
        let reasons = merged.verdict();
        let text = format!("no two of the maps met, so there is no common map\n{}", reasons.trim_end());
        return Err(Ended { ending: Ending::NotMet, text }.into());
    }
    if args.json { Ok(()) } else { console::print(&summary(args, &merged)) }
}

/// What came of it, for people.
fn summary(args: &MergeScansArgs, merged: &LidarMerged) -> String {
    let (record, mut text) = (&merged.record, merged.verdict());
    let maps = record.files.iter().filter(|file| file.starts_with("map"));
    for (file, names) in maps.zip(&record.groups) {
        text += &format!("{}: {}\n", args.out.join(file).display(), names.join(", "));
    }
    let memory = record.cost.peak_memory_bytes.map_or(String::new(), |b| format!(", {} MiB", b >> 20));
    text + &format!("{:.2} s for the merge{memory}\n", record.cost.merge_s)
}
