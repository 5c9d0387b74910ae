//! `loopbox info`: what a recording or a map holds.

use super::info_map;
use super::info_scans;
use super::run_scans::{self, ScanArgs};
use crate::console;
use anyhow::Result;
use clap::Args;
use loopbox::results::map_in;
use serde::Serialize;
use sources::{FoundCalibration, FrameSource, SourceOptions};
use std::fmt;
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
    if let Some(scans) = run_scans::open(&args.path, args.topic.as_deref(), &ScanArgs::default())? {
        return info_scans::run(scans, args.json);
    }
    let options = SourceOptions { fps: args.fps, topic: args.topic.clone(), all_frames: false };
    let mut source = sources::open(&args.path, &options)?;
    let recording = Recording::new(source.as_mut());
    if args.json {
        console::print_json(&recording)?;
    } else {
        console::print(&recording.to_string())?;
    }
    Ok(())
}

/// What can be said of a recording without reading all of it.
#[derive(Debug, Serialize)]
struct Recording {
    path: String,
    kind: &'static str,
    frames: Option<u64>,
    duration_s: Option<f64>,
    frames_per_s: Option<f64>,
    size: Option<(usize, usize)>,
    calibration: Option<String>,
    /// What else there is to say, as label and text.
    facts: Vec<(&'static str, String)>,
    /// What is wrong with it.
    problems: Vec<String>,
}

impl Recording {
    fn new(source: &mut dyn FrameSource) -> Self {
        let info = source.info().clone();
        let mut problems = Vec::new();
        let size = match source.next_frame().map(|frame| frame.picture.into_grey()) {
            Some(Ok(image)) => Some((image.width(), image.height())),
            Some(Err(reason)) => {
                problems.push(format!("the first image is unreadable: {reason}"));
                None
            }
            None => {
                problems.push("there is no image".to_owned());
                None
            }
        };
        let calibration = match &info.calibration {
            Some(FoundCalibration::File(path)) => Some(path.display().to_string()),
            Some(
                FoundCalibration::Inside { origin, .. }
                | FoundCalibration::Preset { origin, .. }
                | FoundCalibration::Recorded { origin, .. },
            ) => Some(origin.clone()),
            Some(FoundCalibration::Unusable { origin, reason }) => {
                problems.push(format!("{origin}: the calibration is unusable: {reason}"));
                None
            }
            None => None,
        };
        problems.extend(source.problems());
        problems.extend(source.warning());
        let frames_per_s = match (info.frame_count, info.duration) {
            (Some(count), Some(duration)) if count > 1 && duration > 0.0 => {
                Some((count - 1) as f64 / duration)
            }
            _ => None,
        };
        Self {
            path: info.path.display().to_string(),
            kind: info.kind,
            frames: info.frame_count,
            duration_s: info.duration,
            frames_per_s,
            size,
            calibration,
            facts: source.facts(),
            problems,
        }
    }
}

impl fmt::Display for Recording {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let unknown = || "unknown".to_owned();
        let number = |value: Option<f64>, unit| value.map_or_else(unknown, |v| format!("{v:.2} {unit}"));
        writeln!(f, "recording    {}", self.path)?;
        writeln!(f, "kind         {}", self.kind)?;
        writeln!(f, "frames       {}", self.frames.map_or_else(unknown, |n| n.to_string()))?;
        writeln!(f, "duration     {}", number(self.duration_s, "s"))?;
        writeln!(f, "rate         {}", number(self.frames_per_s, "frames/s"))?;
        writeln!(f, "size         {}", self.size.map_or_else(unknown, |(w, h)| format!("{w}×{h}")))?;
        writeln!(
            f,
            "calibration  {}",
            self.calibration
                .as_deref()
                .unwrap_or("none came with it: `run` finds one from the images, or takes that of --calib")
        )?;
        self.facts.iter().try_for_each(|(label, text)| writeln!(f, "{label:<12} {text}"))?;
        self.problems.iter().try_for_each(|problem| writeln!(f, "problem      {problem}"))
    }
}
