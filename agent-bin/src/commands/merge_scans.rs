//! `loopbox merge` of LiDAR maps, and of maps that hold both kinds of sensors.

use super::merge_args::MergeArgs;
use super::merge_progress::MergeProgress;
use crate::console::{self, Ended, Ending, warning};
use crate::interrupt::stop_on_ctrl_c;
use anyhow::Result;
use loopbox::lidar::merging::LidarMergeParams;
use loopbox::lidar::{LidarMergeOptions, LidarMerged, merge_maps};
use loopbox::merging::{MixedOptions, merge_mixed};
use loopbox::results::MANIFEST;

/// Merges them.
///
/// # Errors
/// When a map cannot be read or is not a LiDAR's, no two of the maps met, the results cannot be written, or the user
/// ended it. Then nothing but verdicts is written.
pub fn run(args: &MergeArgs, params: LidarMergeParams) -> Result<()> {
    let stop = stop_on_ctrl_c("stopping after this step; no map will be written (Ctrl-C again to abort)")?;
    let mut stage = |text: &str| console::step(args.quiet, text);
    let options = LidarMergeOptions {
        out: args.out.clone(),
        force: args.force,
        params,
        verdicts: args.judging.verdicts.clone(),
        confirm: args.judging.confirm.clone(),
        without: args.without.clone(),
        map: !args.no_map,
    };
    let merged = merge_maps(&args.maps, &options, &stop, &mut stage)?;
    merged.warnings.iter().for_each(|warning| warning!("{warning}"));
    if args.json {
        console::print(&(serde_json::to_string_pretty(&merged.record)? + "\n"))?;
    }
    if !merged.merging.any_joined() {
        let reasons = merged.verdict();
        let text = format!("no two of the maps met, so there is no common map\n{}", reasons.trim_end());
        return Err(Ended { ending: Ending::NotMet, text }.into());
    }
    if args.json { Ok(()) } else { console::print(&summary(args, &merged)) }
}

/// Merges maps of which one at least has agents of both kinds, as `options` say.
///
/// # Errors
/// As [`run`].
pub fn run_mixed(args: &MergeArgs, options: &MixedOptions) -> Result<()> {
    let stop = stop_on_ctrl_c("stopping after this step; no map will be written (Ctrl-C again to abort)")?;
    let progress = MergeProgress::new(args.quiet);
    let merged = merge_mixed(&args.maps, options, &stop, &progress)?;
    progress.finish();
    merged.warnings.iter().for_each(|warning| warning!("{warning}"));
    if args.json {
        console::print(&(serde_json::to_string_pretty(&merged.record)? + "\n"))?;
    }
    let mut text = merged.verdict();
    if !merged.any_joined() {
        let text = format!("no two of the maps met, so there is no new common map\n{}", text.trim_end());
        return Err(Ended { ending: Ending::NotMet, text }.into());
    }
    if args.json {
        return Ok(());
    }
    text += &groups(args, &merged.record.files, &merged.record.groups);
    console::print(&text)
}

/// What came of it, for people.
fn summary(args: &MergeArgs, merged: &LidarMerged) -> String {
    let record = &merged.record;
    let text = merged.verdict() + &groups(args, &record.files, &record.groups);
    let memory = record.cost.peak_memory_bytes.map_or(String::new(), |b| format!(", {} MiB", b >> 20));
    text + &format!("{:.2} s for the merge{memory}\n", record.cost.merge_s)
}

/// Who hangs together, and in which file of results.
fn groups(args: &MergeArgs, files: &[String], groups: &[Vec<String>]) -> String {
    let mut maps = files.iter().filter(|file| file.starts_with("map"));
    let line = |names: &Vec<String>| {
        let file = maps.next().map_or(MANIFEST, |file| file);
        format!("{}: {}\n", args.out.join(file).display(), names.join(", "))
    };
    groups.iter().map(line).collect()
}
