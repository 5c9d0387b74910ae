//! ROS 1 bags as sources.

use super::camera_topics::Match;
use super::input::{Bytes, Input};
use super::messages::{self, Content};
use super::topic_recording::{self, Stamped};
use super::topics::Topics;
use super::{FoundCalibration, FrameSource, SourceInfo, SourceOptions};
pub use crate::bag::MAGIC;
use crate::bag::{self, BagReader, Message};
use anyhow::{Context, Result};
use calib::CameraHint;
use geometry::limits::MAX_BYTES;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// What would do as images, for people.
const LOOKED_FOR: &str = "sensor_msgs/Image and sensor_msgs/CompressedImage";

type Reader = BagReader<BufReader<Box<dyn Bytes>>>;

/// Whether the file starts as bags do.
pub fn is_bag(path: &Path) -> bool {
    let mut start = [0; MAGIC.len()];
    File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start == MAGIC
}

/// Opens a bag, at the topic of `options` if it has several with images.
///
/// # Errors
/// When it cannot be read, or has no images or not exactly one topic to take them from.
pub fn open(input: Input, options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    let mut messages = reader(&input)?;
    let topics = match messages.content() {
        Some(content) => of_index(&content),
        None => of_messages(reader(&input)?),
    };
    let (topic, count) = topics.choose(input.path(), options.topic.as_deref(), LOOKED_FOR)?;
    let matched = topics.calibration(&topic);
    let of_camera = matched.found();
    let calibration = match matched {
        Match::Found(wanted) => first_calibration(&input, &wanted, &topic)?,
        Match::Unclear(names) => Some(FoundCalibration::unclear(&names, input.path(), &topic)),
        Match::Others(_) => None,
    };
    let info = SourceInfo {
        kind: "ROS 1 bag",
        path: input.path().to_owned(),
        frame_count: Some(count),
        duration: topics.duration(),
        calibration,
        camera: CameraHint { topic: Some(topic.clone()), ..CameraHint::default() },
        lag: None,
    };
    let content = topics.content(&topic);
    // What cannot be read has no topic, and is told.
    let is_wanted = move |name: &str| name == topic || of_camera.as_deref() == Some(name);
    let wanted =
        messages.filter(move |m| m.as_ref().map_or(true, |message| is_wanted(&message.connection.topic)));
    let stamped = wanted.map(|message| {
        let Message { connection, time, data } = message?;
        let calibration = self::content(&connection.kind).and_then(Content::calibration);
        Ok(Stamped { time, data, calibration })
    });
    topic_recording::open(info, topics.facts(), content, stamped)
}

/// The topics of a bag.
///
/// # Errors
/// When it cannot be opened.
pub fn topics(input: &Input) -> Result<Topics> {
    Ok(match reader(input)?.content() {
        Some(content) => of_index(&content),
        None => of_messages(reader(input)?),
    })
}

fn reader(input: &Input) -> Result<Reader> {
    let (file, _) = input.open()?;
    BagReader::new(file, MAX_BYTES)
        .with_context(|| format!("{}: the bag cannot be read", input.path().display()))
}

fn content(kind: &str) -> Option<Content> {
    Content::of(kind, "ros1")
}

fn of_index(index: &bag::Content) -> Topics {
    let mut topics = Topics::default();
    topics.span = index.span;
    for (connection, count) in &index.connections {
        topics.count(&connection.topic, &connection.kind, content(&connection.kind), *count);
    }
    topics
}

fn of_messages(messages: Reader) -> Topics {
    let mut topics = Topics::default();
    // What is damaged is told when frames are taken.
    for Message { connection, time, .. } in messages.flatten() {
        topics.count(&connection.topic, &connection.kind, content(&connection.kind), 1);
        topics.at(time);
    }
    topics
}

/// The first calibration on `topic`.
fn first_calibration(input: &Input, topic: &str, images: &str) -> Result<Option<FoundCalibration>> {
    let of_topic = reader(input)?.flatten().filter(|message| message.connection.topic == topic);
    let infos = of_topic.filter_map(|message| {
        let form = content(&message.connection.kind)?.calibration()?;
        Some(messages::read_calibration(form, &message.data))
    });
    Ok(FoundCalibration::of_messages(topic, input.path(), images, infos))
}
