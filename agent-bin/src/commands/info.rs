//! `loopbox info`: what a recording or a map holds.

use super::info_map;
use super::info_scans;
use super::run_scans::{self, ScanArgs, SensorChoice};
use crate::console;
use anyhow::Result;
use clap::Args;
use loopbox::results::map_in;
use loopbox::run::Outlook;
use sources::correction::CameraOptions;
use sources::{FolderKind, SourceOptions};
use std::path::PathBuf;

/// Arguments of `loopbox info`.
#[derive(Args, Debug)]
pub struct InfoArgs {
    /// A recording (folder of images or scans, MCAP file, ROS 1 bag or video file) or a map (map.mcap, or the folder of a run)
    path: PathBuf,
    /// Frames per second of images without time stamps
    #[arg(long, value_name = "RATE")]
    fps: Option<f64>,
    /// Topic of an MCAP file or a bag with several
    #[arg(long)]
    topic: Option<String>,
    /// Of a folder that holds both: describe the scans or the images
    #[arg(long, value_enum, value_name = "WHICH")]
    sensor: Option<SensorChoice>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Describes it.
///
/// # Errors
/// When it is neither.
pub fn execute(args: &InfoArgs) -> Result<()> {
    let is_results = args.path.is_dir() && map_in(&args.path).is_some();
    if is_results || map::is_map_file(&args.path) {
        return info_map::run(&args.path, args.json);
    }
    let wanted = ScanArgs { sensor: args.sensor, ..ScanArgs::default() };
    if let Some(scans) = run_scans::open(&args.path, args.topic.as_deref(), &wanted)? {
        return info_scans::run(scans, args.json);
    }
    let options = SourceOptions { fps: args.fps, topic: args.topic.clone(), all_frames: false };
    let mut source = sources::open(&args.path, &options)?;
    let mut outlook = Outlook::of(source.as_mut(), &CameraOptions::default(), None);
    outlook.facts.extend(FolderKind::of(&args.path).other().map(|other| ("also", other)));
    if args.json { console::print_json(&outlook) } else { console::print(&outlook.to_string()) }
}
