//! `loopbox merge` of LiDAR maps.

use super::merge::MergeArgs;
use crate::console::{self, Ended, Ending, tell};
use crate::interrupt::stop_on_ctrl_c;
use anyhow::Result;
use loopbox::lidar::{LidarMerged, merge_maps};
use loopbox::open::map_file_at;
use map::SensorKind;
use slam_lidar::merging::MergeMethod;
use std::path::{Path, PathBuf};

/// Whether any of the maps is a LiDAR's, by the first lines of their files.
pub fn any_lidar(maps: &[PathBuf]) -> bool {
    maps.iter().any(|path| is_lidar(path))
}

fn is_lidar(path: &Path) -> bool {
    let Ok((file, _)) = map_file_at(path) else { return false };
    map::sensors_of(file).is_ok_and(|kinds| kinds.contains(&SensorKind::Lidar))
}

/// Merges them, their poses found by `method`.
///
/// # Errors
/// When a map cannot be read or is not a LiDAR's, no two of the maps met, the results cannot be written, or the user
/// ended it. Then nothing is written.
pub fn run(args: &MergeArgs, method: MergeMethod) -> Result<()> {
    let stop = stop_on_ctrl_c("stopping after this step; nothing will be written (Ctrl-C again to abort)")?;
    let mut stage = |text: &str| {
        if !args.quiet {
            tell!("{text}");
        }
    };
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
fn summary(args: &MergeArgs, merged: &LidarMerged) -> String {
    let (record, mut text) = (&merged.record, merged.verdict());
    let maps = record.files.iter().filter(|file| file.starts_with("map"));
    for (file, names) in maps.zip(&record.groups) {
        text += &format!("{}: {}\n", args.out.join(file).display(), names.join(", "));
    }
    let memory = record.cost.peak_memory_bytes.map_or(String::new(), |b| format!(", {} MiB", b >> 20));
    text + &format!("{:.2} s for the merge{memory}\n", record.cost.merge_s)
}
