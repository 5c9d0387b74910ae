//! `loopbox info`: what a recording or a map holds.

use crate::sources::{self, FoundCalibration, SourceOptions};
use anyhow::Result;
use clap::Args;
use std::path::PathBuf;

/// Arguments of `loopbox info`.
#[derive(Args, Debug)]
pub struct InfoArgs {
    /// A recording (folder, MCAP or video file) or a map (map.mcap)
    path: PathBuf,
    /// Frames per second of images without time stamps
    #[arg(long, value_name = "RATE")]
    fps: Option<f64>,
    /// Topic of an MCAP recording with several
    #[arg(long)]
    topic: Option<String>,
}

/// Describes it.
///
/// # Errors
/// When it is neither.
pub fn execute(args: &InfoArgs) -> Result<()> {
    let options = SourceOptions { fps: args.fps, topic: args.topic.clone() };
    let mut source = sources::open(&args.path, &options)?;
    let info = source.info().clone();
    println!("recording    {}", info.path.display());
    println!("kind         {}", info.kind);
    match info.frame_count {
        Some(count) => println!("frames       {count}"),
        None => println!("frames       unknown before it is read"),
    }
    if let Some(duration) = info.duration {
        println!("duration     {duration:.2} s");
    }
    if let (Some(count), Some(duration)) = (info.frame_count, info.duration)
        && duration > 0.0
    {
        println!("rate         {:.2} frames/s", (count - 1) as f64 / duration);
    }
    match source.next_frame().map(|frame| frame.picture.into_grey()) {
        Some(Ok(image)) => println!("size         {}×{}", image.width(), image.height()),
        Some(Err(reason)) => println!("size         unknown: the first image is unreadable ({reason})"),
        None => println!("size         unknown: there is no image"),
    }
    match &info.calibration {
        Some(FoundCalibration::File(path)) => println!("calibration  {}", path.display()),
        Some(FoundCalibration::Inside { origin, .. }) => println!("calibration  {origin}"),
        Some(FoundCalibration::Unusable { origin, reason }) => {
            println!("calibration  {origin} is unusable: {reason}")
        }
        None => println!("calibration  none came with it"),
    }
    if let Some(warning) = source.warning() {
        println!("warning      {warning}");
    }
    Ok(())
}
