//! ROS 2 bags in SQLite as sources.

use super::SqliteBag;
use crate::camera_topics::Match;
use crate::messages::{self, Content};
use crate::topic_recording::{self, Stamped};
use crate::{FoundCalibration, FrameSource, SourceInfo, SourceOptions};
use anyhow::Result;
use calib::CameraHint;
use std::path::{Path, PathBuf};

/// What would do as images, for people.
const LOOKED_FOR: &str = "sensor_msgs/msg/Image and sensor_msgs/msg/CompressedImage";

/// Opens a bag by its files, at the topic of `options` if it has several with images; `path` is what the user named.
///
/// # Errors
/// When it cannot be read, or has no images or not exactly one topic to take them from.
pub fn open(path: &Path, files: &[PathBuf], options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    let bag = SqliteBag::open(files)?;
    let topics = bag.topics();
    let (topic, count) = topics.choose(path, options.topic.as_deref(), LOOKED_FOR)?;
    let calibration = match topics.calibration(&topic) {
        Match::Found(wanted) => first_calibration(path, files, &wanted, &topic)?,
        Match::Unclear(names) => Some(FoundCalibration::unclear(&names, path, &topic)),
        Match::Others(_) => None,
    };
    let info = SourceInfo {
        kind: "ROS 2 bag",
        path: path.to_owned(),
        frame_count: Some(count),
        duration: topics.duration(),
        calibration,
        camera: CameraHint { topic: Some(topic.clone()), ..CameraHint::default() },
        lag: None,
    };
    let content = topics.content(&topic);
    let stamped = bag
        .messages(&topic)
        .map(|message| message.map(|message| Stamped { time: message.time, data: message.data }));
    topic_recording::open(info, topics.facts(), content, stamped)
}

/// The first calibration on `topic`.
fn first_calibration(
    path: &Path,
    files: &[PathBuf],
    topic: &str,
    images: &str,
) -> Result<Option<FoundCalibration>> {
    for message in SqliteBag::open(files)?.messages(topic) {
        let message = message?;
        let Some(Content::Calibration(form)) = Content::of(&message.kind, &message.encoding) else {
            continue;
        };
        let info = messages::read_calibration(form, &message.data);
        return Ok(Some(FoundCalibration::of_message(topic, path, images, info)));
    }
    Ok(None)
}
