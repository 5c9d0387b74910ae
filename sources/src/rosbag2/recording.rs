//! ROS 2 bags in SQLite as sources.

use super::{Message, SqliteBag};
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
    let matched = topics.calibration(&topic);
    let of_camera = matched.found();
    let calibration = match matched {
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
    let wanted: Vec<String> = std::iter::once(topic).chain(of_camera).collect();
    let stamped = bag.messages(&wanted).map(|message| {
        let Message { kind, encoding, time, data } = message?;
        let calibration = Content::of(&kind, &encoding).and_then(Content::calibration);
        Ok(Stamped { time, data, calibration })
    });
    topic_recording::open(info, topics.facts(), content, stamped)
}

/// The first calibration on `topic`.
fn first_calibration(
    path: &Path,
    files: &[PathBuf],
    topic: &str,
    images: &str,
) -> Result<Option<FoundCalibration>> {
    let messages = SqliteBag::open(files)?.messages(&[topic.to_owned()]);
    let infos = messages.filter_map(|message| {
        let read = |message: Message| {
            let form = Content::of(&message.kind, &message.encoding)?.calibration()?;
            Some(messages::read_calibration(form, &message.data))
        };
        message.map(read).transpose().map(|info| info?)
    });
    Ok(FoundCalibration::of_messages(topic, path, images, infos))
}
