//! `loopbox merge`: several agents' maps into one.

use super::merge_args::MergeArgs;
use super::merge_progress::MergeProgress;
use super::merge_scans;
use crate::console::{self, Ended, Ending, warning};
use crate::interrupt::stop_on_ctrl_c;
use anyhow::{Result, bail};
use geometry::Se3;
use loopbox::blobs::local_files;
use loopbox::merging::{MergeOptions, Merged, merge_maps_watched, merge_rig};
use loopbox::open::{Sensors, sensors_at};
use loopbox::results::MANIFEST;

/// Runs `loopbox merge`.
///
/// # Errors
/// When a map cannot be read, no two of the maps met, the common map cannot be made or written, or the user ended
/// it. Then nothing but verdicts is written.
pub fn run(args: &mut MergeArgs) -> Result<()> {
    args.threads.start()?;
    args.maps = local_files(&args.maps, &|text| console::step(args.quiet, text))?;
    let args = &*args;
    if let Some(lidar_from_camera) = &args.extrinsic {
        return args.of_a_rig(lidar_from_camera);
    }
    match sensors_at(&args.maps) {
        Sensors::Mixed => return merge_scans::run_mixed(args, &args.mixed()?),
        Sensors::Lidars => {
            args.check_lidar_options()?;
            return merge_scans::run(args, args.judging.how.of_lidars()?);
        }
        Sensors::Cameras => {}
    }
    let mut params = args.judging.how.of_cameras()?;
    if args.optimise {
        (params.joint, params.joint_keyframes) = (true, usize::MAX);
    }
    params.joint &= !args.no_optimise;
    if args.optimise && params.method.baseline().is_some() {
        bail!(
            "a common map is optimised jointly (--optimise) where maps are joined by --method direct, the default"
        );
    }
    let verdicts = args.judging.verdicts.clone();
    let confirm = args.judging.confirm.clone();
    let (out, without, map) = (args.out.clone(), args.without.clone(), !args.no_map);
    let options = MergeOptions { out, force: args.force, params, verdicts, confirm, without, map };
    let stop = stop_on_ctrl_c("stopping after this step; no map will be written (Ctrl-C again to abort)")?;
    let progress = MergeProgress::new(args.quiet);
    let merged = merge_maps_watched(&args.maps, options, &stop, &progress)?;
    progress.finish();
    if args.json {
        console::print_streamed(&merged.record)?;
    }
    if !merged.any_joined() {
        let reasons = merged.verdict();
        let text = format!("no two of the maps met, so there is no common map\n{}", reasons.trim_end());
        return Err(Ended { ending: Ending::NotMet, text }.into());
    }
    if args.json {
        return Ok(());
    }
    merged.verdicts().try_for_each(|verdict| console::print(&verdict))?;
    console::print(&summary(args, &merged))
}

impl MergeArgs {
    /// The same for the maps of a camera and a LiDAR on one robot.
    fn of_a_rig(&self, lidar_from_camera: &Se3) -> Result<()> {
        let stop =
            stop_on_ctrl_c("stopping after this step; nothing will be written (Ctrl-C again to abort)")?;
        let progress = MergeProgress::new(self.quiet);
        let merged = merge_rig(&self.maps, lidar_from_camera, (&self.out, self.force), &stop, &progress)?;
        progress.finish();
        merged.warnings.iter().for_each(|warning| warning!("{warning}"));
        let record = &merged.record;
        if self.json {
            return console::print(&(serde_json::to_string_pretty(record)? + "\n"));
        }
        let names: Vec<&str> = record.inputs.iter().map(|input| &*input.name).collect();
        console::print(&format!(
            "{}: tied at {} keyframes, {} of them not believed\n  {} images, {:.2} m about their middle: the ways are {:.3} m \
             and {:.2}° apart (median), a unit of the camera's map is {:.4} m\n{}: {}\n",
            names.join(" + "),
            record.ties,
            record.suppressed,
            record.images,
            record.reach_m,
            record.distance_m,
            record.angle_deg,
            record.metres_per_unit,
            self.out.join("map.mcap").display(),
            names.join(", "),
        ))
    }
}

/// What came of it besides the verdicts, for people.
fn summary(args: &MergeArgs, merged: &Merged) -> String {
    let (record, mut text) = (&merged.record, String::new());
    for (group, agents) in record.groups.iter().zip(merged.merging.groups()) {
        let file = if args.no_map { MANIFEST } else { &group.map };
        text += &format!("{}: {}\n", args.out.join(file).display(), merged.names.list(agents));
    }
    let memory = record.cost.peak_memory_bytes.map_or(String::new(), |b| format!(", {} MiB", b >> 20));
    let found = match record.inputs.iter().map(|input| input.features_found).sum::<usize>() {
        0 => "all features were in the maps".to_owned(),
        count => format!(
            "features of {count} keyframes were not in the maps and took {:.2} s",
            record.cost.features_s
        ),
    };
    text + &format!(
        "{:.2} s in all: {:.2} s for the merge; {found}{memory}\n",
        merged.seconds, record.cost.merge_s
    )
}
