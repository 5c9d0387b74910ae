//! Scans of a LiDAR in MCAP files and ROS bags.

use crate::bag::{self, BagReader};
use crate::input::Input;
use crate::rosbag2::Files;
use crate::topics::Topics;
use crate::{bag_recording, mcap_recording, rosbag2, time};
use anyhow::{Context, Result, bail};
use geometry::limits::MAX_BYTES;
use scans::{Encoding, MessageKind, NextScan, ScanError, ScanInfo, ScanSource};
use std::path::{Path, PathBuf};

/// What would do as scans, for people.
const LOOKED_FOR: &str =
    "sensor_msgs/PointCloud2 (ROS 1 and 2), foxglove.PointCloud (protobuf) and Livox's CustomMsg";

/// A message of any topic.
struct Raw {
    topic: String,
    kind: Option<(MessageKind, Encoding)>,
    /// When it was logged, nanoseconds.
    time: u64,
    data: Vec<u8>,
}

type Messages = Box<dyn Iterator<Item = Result<Raw>> + Send>;

/// A recording of scans in a file: those of one topic.
pub struct ScanRecording {
    info: ScanInfo,
    topic: String,
    messages: Messages,
    next: u64,
    ended: bool,
}

/// Opens the scans in the MCAP file or bag at `path`, those of `topic` where there are several. `None` when it is no such
/// file, or one of images whose `topic` is not one of scans.
///
/// # Errors
/// When the file cannot be read, or has several topics with scans and `topic` names none of them.
pub fn open_scans(path: &Path, topic: Option<&str>) -> Result<Option<ScanRecording>> {
    // What is wrong with a folder is told by who opens it as images.
    let of_ros2 = if path.exists() { rosbag2::files_at(path).ok().flatten() } else { None };
    if let Some(Files::Mcap(file)) = &of_ros2 {
        return open_scans(file, topic);
    }
    let input = Input::File(path.to_owned());
    if of_ros2.is_none() && (!path.is_file() || map::is_map_file(path)) {
        return Ok(None);
    }
    let (kind, topics): (_, Topics) = if let Some(Files::Sqlite(files)) = &of_ros2 {
        let Some(topics) = topics_of_sqlite(files)? else { return Ok(None) };
        ("ROS 2 bag", topics)
    } else if mcap_recording::is_mcap(path) {
        ("MCAP recording", mcap_recording::topics(&input)?)
    } else if bag_recording::is_bag(path) {
        ("ROS 1 bag", bag_recording::topics(&input)?)
    } else {
        return Ok(None);
    };
    let with_scans = topics.of_schema(|schema| MessageKind::of_schema(schema).is_some());
    let is_wanted = |name: &str| topic.is_none_or(|wanted| wanted == name);
    let wanted: Vec<&(String, u64)> = with_scans.iter().filter(|(name, _)| is_wanted(name)).collect();
    if wanted.is_empty() || topic.is_none() && topics.has_images() {
        return Ok(None);
    }
    let [(topic, count)] = wanted[..] else {
        let names: Vec<String> = with_scans.iter().map(|(name, n)| format!("{name} ({n} scans)")).collect();
        bail!(
            "{}: scans on several topics\nhint: choose one with --topic: {}",
            path.display(),
            names.join(", ")
        );
    };
    let messages = match (&of_ros2, kind) {
        (Some(Files::Sqlite(files)), _) => of_sqlite(files, topic)?,
        (_, "ROS 1 bag") => of_bag(&input)?,
        _ => of_mcap(&input)?,
    };
    let info = ScanInfo {
        path: path.to_owned(),
        kind: format!("{kind} of scans"),
        count: Some(*count),
        duration: topics.duration(),
    };
    Ok(Some(ScanRecording { info, topic: topic.clone(), messages, next: 0, ended: false }))
}

/// What is read of scans, for messages about files that hold none.
pub fn scans_looked_for() -> &'static str {
    LOOKED_FOR
}

/// How messages are written, by what recordings call it.
fn encoding_of(name: &str) -> Option<Encoding> {
    match name {
        "cdr" => Some(Encoding::Cdr),
        "ros1" => Some(Encoding::Ros1),
        "protobuf" => Some(Encoding::Protobuf),
        _ => None,
    }
}

fn of_mcap(input: &Input) -> Result<Messages> {
    let raw = |message: mcap::Message<'static>| {
        let channel = &message.channel;
        let kind = channel.schema.as_ref().and_then(|schema| MessageKind::of_schema(&schema.name));
        let encoding = encoding_of(&channel.message_encoding);
        Raw {
            topic: channel.topic.clone(),
            kind: kind.zip(encoding),
            time: message.log_time,
            data: message.data.into_owned(),
        }
    };
    let messages = mcap_recording::linear(input)?;
    Ok(Box::new(messages.map(move |message| message.map(raw).map_err(anyhow::Error::from))))
}

/// The topics of a bag in SQLite; `None` where this program was built without.
#[cfg(feature = "sqlite")]
fn topics_of_sqlite(files: &[PathBuf]) -> Result<Option<Topics>> {
    Ok(Some(rosbag2::SqliteBag::open(files)?.topics()))
}

#[cfg(not(feature = "sqlite"))]
fn topics_of_sqlite(_files: &[PathBuf]) -> Result<Option<Topics>> {
    Ok(None)
}

#[cfg(feature = "sqlite")]
fn of_sqlite(files: &[PathBuf], topic: &str) -> Result<Messages> {
    let name = topic.to_owned();
    let raw = move |message: rosbag2::Message| Raw {
        topic: name.clone(),
        kind: MessageKind::of_schema(&message.kind).zip(encoding_of(&message.encoding)),
        time: message.time,
        data: message.data,
    };
    let messages = rosbag2::SqliteBag::open(files)?.messages(topic);
    Ok(Box::new(messages.map(move |message| message.map(&raw))))
}

#[cfg(not(feature = "sqlite"))]
fn of_sqlite(files: &[PathBuf], _topic: &str) -> Result<Messages> {
    rosbag2::refuse(files)
}

fn of_bag(input: &Input) -> Result<Messages> {
    let (file, _) = input.open()?;
    let reader = BagReader::new(file, MAX_BYTES)
        .with_context(|| format!("{}: the bag cannot be read", input.path().display()))?;
    let raw = |message: bag::Message| Raw {
        topic: message.connection.topic.clone(),
        kind: MessageKind::of_schema(&message.connection.kind).map(|kind| (kind, Encoding::Ros1)),
        time: message.time,
        data: message.data,
    };
    Ok(Box::new(reader.map(move |message| message.map(raw))))
}

impl ScanRecording {
    /// A message's scan.
    fn scan(&mut self, message: &Raw) -> NextScan {
        let index = self.next;
        self.next += 1;
        let name = format!("{}: scan {index}", self.info.path.display());
        let logged = time::seconds(message.time);
        let Some((kind, encoding)) = message.kind else {
            let what = format!("its encoding is not read; known are {LOOKED_FOR}");
            return NextScan { index, stamp: logged, scan: Err(ScanError::Format { name, what }) };
        };
        let mut scan = kind.read(encoding, &message.data, &name);
        // A header without time has that of the recorder.
        let stamped = scan
            .as_ref()
            .map_or_else(|_| kind.stamp(encoding, &message.data).unwrap_or_default(), |scan| scan.stamp);
        let stamp = if stamped > 0.0 { stamped } else { logged };
        if let Ok(scan) = &mut scan {
            scan.stamp = stamp;
        }
        NextScan { index, stamp, scan }
    }
}

impl ScanSource for ScanRecording {
    fn info(&self) -> &ScanInfo {
        &self.info
    }

    fn next_scan(&mut self) -> Option<NextScan> {
        while !self.ended {
            match self.messages.next()? {
                Ok(message) if message.topic == self.topic => return Some(self.scan(&message)),
                Ok(_) => {}
                Err(error) => {
                    self.ended = true;
                    let name = self.info.path.display().to_string();
                    let what = format!(
                        "the file is damaged or ends early; its {} whole scans are used ({error:#})",
                        self.next
                    );
                    let scan = Err(ScanError::Format { name, what });
                    return Some(NextScan { index: self.next, stamp: f64::INFINITY, scan });
                }
            }
        }
        None
    }
}
