//! `loopbox info`: what a recording or a map holds.

use super::info_map;
use super::run_scans::{self, ScanArgs, SensorChoice};
use super::survey::Survey;
use crate::console;
use anyhow::Result;
use clap::Args;
use loopbox::blobs::local_recording;
use loopbox::open::is_map;
use sources::SourceOptions;
use sources::correction::CameraOptions;
use std::path::PathBuf;

/// Arguments of `loopbox info`.
#[derive(Args, Debug)]
pub struct InfoArgs {
    /// A recording (folder of images or scans, MCAP file, ROS 1 or ROS 2 bag, or video file) or a map (map.mcap, or the folder of a run);
    /// or the URI of one in a bucket
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
/// When it is neither, and of a recording of which a run would be refused.
pub fn execute(args: &InfoArgs) -> Result<()> {
    let path = local_recording(&args.path, &|text| console::step(args.json, text))?;
    if is_map(&path) {
        return info_map::run(&path, args.json);
    }
    let wanted = ScanArgs { sensor: args.sensor, ..ScanArgs::default() };
    if let Some(scans) = run_scans::open(&path, args.topic.as_deref(), &wanted)? {
        return Survey::of_scans(scans).print(args.json);
    }
    let options = SourceOptions { fps: args.fps, topic: args.topic.clone(), all_frames: false };
    let source = sources::open(&path, &options)?;
    Survey::of_images(source, &path, &CameraOptions::default(), None).print(args.json)
}
