//! The sources of frames, and their storage: folders, MCAP files, ROS bags, videos and cameras, one file per kind of
//! recording behind [`FrameSource`]. [`ahead`] decodes frames in a thread, [`correction`] undoes the lens,
//! [`recording`] stores what was captured, and [`convert`] writes it in other formats.

pub mod ahead;
pub mod bag;
mod bag_recording;
pub mod camera;
mod camera_topics;
pub mod convert;
pub mod correction;
mod damage;
mod euroc;
mod ffmpeg;
mod folder_kind;
#[cfg(test)]
mod format_tests;
pub mod forward;
mod found_calibration;
mod image_list;
mod image_table;
mod input;
mod kinds;
mod kitti;
mod mcap_recording;
pub mod messages;
pub mod notice;
mod numbered;
mod parts;
pub mod pictures;
mod presets;
mod recalibrated;
pub mod recording;
mod rosbag2;
mod salvage;
mod scan_recording;
mod sidecar_calibration;
mod stop;
mod survey;
pub mod time;
mod timed;
mod topic_recording;
mod topics;
mod tum;
mod tum_mono;
mod video;

pub use ffmpeg::versions as ffmpeg_versions;
pub use folder_kind::FolderKind;
pub use found_calibration::FoundCalibration;
pub use image_list::{images_in, is_image};
pub use image_table::timed_images;
pub use input::Input;
pub use scan_recording::{ScanRecording, open_scans, scans_looked_for};
pub use sidecar_calibration::sidecar_calibrations;
pub use stop::Stop;

use crate::pictures::{Picture, StatedFocal};
use anyhow::{Result, bail};
use calib::CameraHint;
use forward::Forward;
use geometry::Camera;
use kinds::check_kind;
use notice::Listener;
use rosbag2::Files;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// A frame as its source has it.
#[derive(Debug)]
pub struct SourceFrame {
    /// Index in the recording, from 0.
    pub index: u64,
    /// Seconds, as recorded.
    pub timestamp: f64,
    /// When the image was taken, of a live source.
    pub captured: Option<Instant>,
    /// The picture, not yet decoded.
    pub picture: Picture,
}

/// The description of a recording, known before its frames are read.
#[derive(Clone, Debug)]
pub struct SourceInfo {
    /// The kind, for people: `TUM RGB-D folder`.
    pub kind: &'static str,
    /// Its path.
    pub path: PathBuf,
    /// How many frames it has, if the source can tell.
    pub frame_count: Option<u64>,
    /// Seconds from the first to the last frame, if the source can tell.
    pub duration: Option<f64>,
    /// A calibration that came with it.
    pub calibration: Option<FoundCalibration>,
    /// Which camera took the frames, as far as known, for calibration files that hold several.
    pub camera: CameraHint,
    /// For the recording of a live run: the number of frames that its mapping took, which a replay repeats
    /// ([`slam_direct`'s `mapping.lag`](slam_direct::Params)).
    pub lag: Option<usize>,
}

impl SourceInfo {
    /// The description of frames of which nothing is known before they come, with their kind and origin for people.
    pub fn new(kind: &'static str, path: impl Into<PathBuf>) -> Self {
        let (frame_count, duration, calibration, camera, lag) = Default::default();
        Self { kind, path: path.into(), frame_count, duration, calibration, camera, lag }
    }
}

/// A recording, frame by frame.
pub trait FrameSource: Send {
    /// Its description.
    fn info(&self) -> &SourceInfo;

    /// The next frame in the order of the recording; `None` at the end.
    fn next_frame(&mut self) -> Option<SourceFrame>;

    /// A problem of the recording as a whole, found while it was read; a truncated file, for example.
    fn warning(&self) -> Option<String> {
        None
    }

    /// Skips frames that lie more than a moment before `start` seconds after the first, if that is cheaper than
    /// reading them; returns the first frame's time stamp then. To be called before the first frame is read.
    fn skip_to(&mut self, _start: f64) -> Option<f64> {
        None
    }

    /// Sets the camera of its images. From now on an image that the recording attributes to another camera becomes
    /// [`Picture::OfOther`]. To be called before the first frame is read.
    fn expect_camera(&mut self, _camera: &Camera) {}

    /// Problems that are visible before the frames are read in turn.
    fn problems(&self) -> Vec<String> {
        Vec::new()
    }

    /// The focal length that the recording, apart from its pictures, states for images of this width and height.
    fn stated_focal(&self, _size: (usize, usize)) -> Option<StatedFocal> {
        None
    }

    /// Other facts about it, as label and text.
    fn facts(&self) -> Vec<(&'static str, String)> {
        Vec::new()
    }

    /// Whether each picture is decoded when it is read, so that reading all of them takes as long as a run.
    fn decodes(&self) -> bool {
        false
    }

    /// Whether frames arrive by themselves, and the source cannot wait for its reader.
    fn is_live(&self) -> bool {
        false
    }

    /// Frames that a live source could not deliver so far.
    fn missed(&self) -> u64 {
        0
    }

    /// Why a live source ended though the user did not stop it, once there is no next frame.
    fn failure(&self) -> Option<String> {
        None
    }

    /// A flag that ends the wait in [`FrameSource::next_frame`] when it is set, for sources that may wait long.
    fn stopper(&self) -> Option<Arc<AtomicBool>> {
        None
    }

    /// Sends notices to `listener` from now on.
    fn listen(&mut self, listener: Listener) {
        let _ = listener;
    }
}

/// Options for opening a source.
#[derive(Clone, Debug, Default)]
pub struct SourceOptions {
    /// Frames per second of images without time stamps.
    pub fps: Option<f64>,
    /// The topic to take from a recording with several.
    pub topic: Option<String>,
    /// Also take frames that the recorded run dropped.
    pub all_frames: bool,
}

/// Opens the recording at `path`, whatever its kind. The source makes its time grow and gives all pictures one range
/// of grey levels ([`forward`]).
///
/// # Errors
/// When there is nothing there, or nothing that is a recording; says which files were looked for.
pub fn open(path: &Path, options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    if let Some(fps) = options.fps
        && !(fps.is_finite() && fps > 0.0)
    {
        bail!("--fps {fps} is not a frame rate\nhint: give frames per second, such as --fps 30");
    }
    Ok(Box::new(Forward::new(open_any(path, options)?)))
}

/// Opens the recording with the stamps and pictures that it has.
fn open_any(path: &Path, options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    check_kind(path)?;
    if path.is_dir() {
        return match rosbag2::files_at(path)? {
            Some(files) => open_files(path, &files, options),
            None => open_folder(path, options),
        };
    }
    if let Some(files) = rosbag2::files_at(path)? {
        return open_files(path, &files, options);
    }
    if mcap_recording::is_mcap(path) {
        return open_mcap(path, options);
    }
    if bag_recording::is_bag(path) {
        return open_bag(path, options);
    }
    open_video(path, options)
}

fn open_files(path: &Path, files: &Files, options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    match files {
        Files::Mcap(files) => parts::open(path, files, options, open_mcap),
        Files::Sqlite(files) => open_sqlite(path, files, options),
    }
}

fn open_mcap(path: &Path, options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    mcap_recording::open(Input::File(path.to_owned()), options)
}

fn open_bag(path: &Path, options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    bag_recording::open(Input::File(path.to_owned()), options)
}

/// Opens a recording in memory: an MCAP file or a ROS 1 bag.
///
/// # Errors
/// As [`open`].
pub fn open_bytes(bytes: &[u8], options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    let input = Input::Memory("memory".into(), Arc::from(bytes));
    if bytes.starts_with(bag_recording::MAGIC) {
        return Ok(Box::new(Forward::new(bag_recording::open(input, options)?)));
    }
    Ok(Box::new(Forward::new(mcap_recording::open(input, options)?)))
}

#[cfg(feature = "sqlite")]
fn open_sqlite(path: &Path, files: &[PathBuf], options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    rosbag2::open(path, files, options)
}

#[cfg(not(feature = "sqlite"))]
fn open_sqlite(_path: &Path, files: &[PathBuf], _options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    rosbag2::refuse(files)
}

fn open_video(path: &Path, options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    let video = video::open(path, options.fps)?;
    refuse_topic(path, options)?;
    Ok(Box::new(video))
}

fn open_folder(path: &Path, options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    let list = if let Some(list) = kitti::open(path)? {
        list
    } else if let Some(list) = tum_mono::open(path)? {
        list
    } else if let Some(list) = timed::open(path, &timed::OWN)? {
        list
    } else if let Some(list) = tum::open(path)? {
        list
    } else if let Some(list) = euroc::open(path)? {
        list
    } else if let Some(list) = timed::open(path, &timed::OTHERS)? {
        list
    } else if options.fps.is_none()
        && let Some(list) = timed::open_any(path)?
    {
        list
    } else if let Some(list) = numbered::open(path, options.fps)? {
        list
    } else if let Some(files) = rosbag2::loose_files(path)? {
        return open_files(path, &files, options);
    } else if let bags = rosbag2::files_with(path, "bag")?
        && !bags.is_empty()
    {
        return parts::open(path, &bags, options, open_bag);
    } else if let [video] = &folder_kind::videos_in(path)[..] {
        return open_video(video, options);
    } else {
        return Err(folder_kind::nothing_in(path));
    };
    refuse_topic(path, options)?;
    Ok(Box::new(list.with_rate(options.fps)?))
}

/// Refuses to choose among the topics of a recording that has none.
fn refuse_topic(path: &Path, options: &SourceOptions) -> Result<()> {
    match &options.topic {
        Some(topic) => bail!(
            "{}: has no topics, so not {topic} either\nhint: leave --topic out; it is for MCAP files and bags",
            path.display()
        ),
        None => Ok(()),
    }
}
