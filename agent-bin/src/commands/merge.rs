//! `loopbox merge`: several agents' maps into one.

use super::merge_progress::MergeProgress;
use super::method::method_parser;
use super::params;
use crate::console::{self, Ended, Ending};
use crate::interrupt::stop_on_ctrl_c;
use anyhow::{Result, anyhow, bail};
use clap::Args;
use loopbox::merging::{
    Input, MergeRecord, Merging, MergingParams, Names, keep_from, listed, merge, verdict, without_company,
    write_results,
};
use loopbox::results::{Owner, Results};
use merge::method::Method;
use place_recog::Vocabulary;
use std::path::PathBuf;
use std::sync::Arc;

/// Merge the maps of several agents into one common map
#[derive(Debug, Args)]
pub struct MergeArgs {
    /// The maps: each a map.mcap, or the folder of a run. Those that met join the world of the first
    #[arg(required = true, value_name = "MAP")]
    maps: Vec<PathBuf>,
    /// Folder for the results; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Replace results of a run in that folder, once the new ones are complete
    #[arg(long)]
    force: bool,
    /// How maps are joined where they met, in place of the parameter file's: direct, loopbox's own, aligns the images
    /// of all pairs that agree; the others, loop-box of the paper among them, are there to compare it with
    #[arg(long, value_name = "METHOD", value_parser = method_parser())]
    method: Option<Method>,
    /// Parameter file (TOML); `loopbox params --merge` prints the defaults
    #[arg(long, value_name = "FILE")]
    params: Option<PathBuf>,
    /// Print all numbers as JSON, as they are in merge.json, instead of the verdicts
    #[arg(long)]
    json: bool,
    /// Show no progress
    #[arg(long)]
    quiet: bool,
}

/// Runs `loopbox merge`.
///
/// # Errors
/// When a map cannot be read, no two of the maps met, the common map cannot be made or written, or the user ended
/// it. Then nothing is written.
pub fn run(args: &MergeArgs) -> Result<()> {
    if let [map] = &args.maps[..] {
        bail!(
            "{}: is one map; there is nothing to merge it with\nhint: give two or more: loopbox merge A B --out DIR",
            map.display()
        );
    }
    let mut params: MergingParams =
        args.params.as_deref().map(params::read_merging).transpose()?.unwrap_or_default();
    params.method = args.method.unwrap_or(params.method);
    keep_from(&args.out, &args.maps)?;
    let mut output = Results::create(&args.out, &Owner::Merge, args.force)?;
    let stop = stop_on_ctrl_c("stopping after this step; nothing will be written (Ctrl-C again to abort)")?;
    let progress = MergeProgress::new(args.quiet);
    let go_on = || if stop.requested() { Err(anyhow!("interrupted: nothing was written")) } else { Ok(()) };
    let mut stage = |text: &str| {
        progress.stage(text);
        go_on()
    };
    let vocabulary = Vocabulary::shipped();
    let inputs = load(args, &vocabulary, &progress, &mut stage)?;
    let merging = merge(&inputs, &vocabulary, &params, &mut stage)?;
    let names = Names::new(&merging.common);
    let mut record = MergeRecord::new(&inputs, &merging, &params, &names)?;
    if !merging.anything_met() {
        progress.finish();
        if args.json {
            print(args, &inputs, &merging, &names, &record)?;
        }
        let reasons = verdict(&inputs, &merging);
        let text = format!("no two of the maps met, so there is no common map\n{}", reasons.trim_end());
        return Err(Ended { ending: Ending::NotMet, text }.into());
    }
    stage("writing the results")?;
    write_results(&mut output, &inputs, &merging, &names, &mut record)?;
    go_on()?;
    output.commit()?;
    let lonely = without_company(&merging, &names);
    if !lonely.is_empty() {
        let lonely: Vec<&str> = lonely.iter().map(String::as_str).collect();
        progress.warn(&format!("{} met none of the others", listed(&lonely)));
    }
    progress.finish();
    print(args, &inputs, &merging, &names, &record)
}

/// Reads the maps and finds their features. Maps of one name are told apart.
fn load(
    args: &MergeArgs,
    vocabulary: &Arc<Vocabulary>,
    progress: &MergeProgress,
    stage: &mut dyn FnMut(&str) -> Result<()>,
) -> Result<Vec<Input>> {
    let mut inputs: Vec<Input> = Vec::new();
    for path in &args.maps {
        stage(&format!("reading {} and finding its features", path.display()))?;
        let mut input = Input::load(path, vocabulary)?;
        input.warnings.iter().for_each(|warning| progress.warn(warning));
        let name = input.name.clone();
        let mut number = 2;
        while inputs.iter().any(|other| other.name == input.name) {
            input.name = format!("{name}-{number}");
            number += 1;
        }
        inputs.push(input);
    }
    Ok(inputs)
}

/// Says what came of it on standard output.
fn print(
    args: &MergeArgs,
    inputs: &[Input],
    merging: &Merging,
    names: &Names,
    record: &MergeRecord,
) -> Result<()> {
    let mut text =
        if args.json { serde_json::to_string_pretty(record)? + "\n" } else { verdict(inputs, merging) };
    if !args.json {
        for (group, agents) in record.groups.iter().zip(merging.groups()) {
            text += &format!("{}: {}\n", args.out.join(&group.map).display(), names.list(agents));
        }
        let memory = record.cost.peak_memory_bytes.map_or(String::new(), |b| format!(", {} MiB", b >> 20));
        text += &format!(
            "{:.2} s for the merge, {:.2} s for features, {:.2} s to read{memory}\n",
            record.cost.merge_s, record.cost.features_s, record.cost.reading_s
        );
    }
    console::print(&text)
}
