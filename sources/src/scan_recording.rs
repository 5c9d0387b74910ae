//! Scans of a LiDAR in MCAP files and ROS bags.

use crate::bag::{self, BagReader};
use crate::damage::Damage;
use crate::forward::LOOKED_AHEAD;
use crate::input::Input;
use crate::messages::unpacked;
use crate::rosbag2::Files;
use crate::topics::Topics;
use crate::{bag_recording, mcap_recording, rosbag2, time};
use anyhow::{Context, Result, bail};
use geometry::limits::MAX_BYTES;
use scans::{Encoding, MessageKind, NextScan, ScanError, ScanInfo, ScanSource};
use std::borrow::Cow;
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
    damage: Damage,
    ended: bool,
    /// Whether stamps stand still, so that scans have the times at which they were logged.
    by_log: bool,
}

/// Opens the scans in the MCAP file or bag at `path`, those of `topic` where there are several. `None` when it is no such
/// file, or one of images whose `topic` is not one of scans.
///
/// # Errors
/// When the file cannot be read, or has several topics with scans and `topic` names none of them.
pub fn open_scans(path: &Path, topic: Option<&str>) -> Result<Option<ScanRecording>> {
    let Some(files) = Container::at(path) else { return Ok(None) };
    let Some(topics) = files.topics()? else { return Ok(None) };
    let kind = files.kind();
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
    let mut messages = files.messages(topic)?;
    let (ahead, by_log) = first_messages(&mut messages, topic);
    let messages = Box::new(ahead.into_iter().map(Ok).chain(messages));
    let info = ScanInfo {
        path: path.to_owned(),
        kind: format!("{kind} of scans"),
        count: Some(*count),
        duration: topics.duration(),
        is_kitti: false,
        facts: topics.facts(),
    };
    let damage = Damage::default();
    Ok(Some(ScanRecording { info, topic: topic.clone(), messages, next: 0, damage, ended: false, by_log }))
}

/// The files of a recording of messages.
enum Container {
    Mcap(Vec<Input>),
    Bag(Vec<Input>),
    Sqlite(Vec<PathBuf>),
}

impl Container {
    /// The recording at a path: a file, or a folder of the files of one that was split. What is wrong with a folder is told by who
    /// opens it as images.
    fn at(path: &Path) -> Option<Self> {
        let inputs = |files: Vec<PathBuf>| files.into_iter().map(Input::File).collect();
        let of_ros2 = if path.exists() { rosbag2::files_at(path).ok().flatten() } else { None };
        let of_ros2 =
            of_ros2.or_else(|| path.is_dir().then(|| rosbag2::loose_files(path).ok().flatten()).flatten());
        match of_ros2 {
            Some(Files::Mcap(files)) => return Some(Self::Mcap(inputs(files))),
            Some(Files::Sqlite(files)) => return Some(Self::Sqlite(files)),
            None => {}
        }
        if path.is_dir() {
            let files = rosbag2::files_with(path, "bag").ok().filter(|files| !files.is_empty())?;
            return Some(Self::Bag(inputs(files)));
        }
        let one = vec![Input::File(path.to_owned())];
        match path.is_file() && !map::is_map_file(path) {
            true if mcap_recording::is_mcap(path) => Some(Self::Mcap(one)),
            true if bag_recording::is_bag(path) => Some(Self::Bag(one)),
            _ => None,
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Mcap(_) => "MCAP recording",
            Self::Bag(_) => "ROS 1 bag",
            Self::Sqlite(_) => "ROS 2 bag",
        }
    }

    /// The topics of all files; `None` where this program was built without what reads them.
    fn topics(&self) -> Result<Option<Topics>> {
        let all = |inputs: &[Input], topics: fn(&Input) -> Result<Topics>| {
            let mut whole = Topics::default();
            for input in inputs {
                whole.add(topics(input)?);
            }
            Ok(Some(whole))
        };
        match self {
            Self::Mcap(inputs) => all(inputs, mcap_recording::topics),
            Self::Bag(inputs) => all(inputs, bag_recording::topics),
            Self::Sqlite(files) => topics_of_sqlite(files),
        }
    }

    fn messages(&self, topic: &str) -> Result<Messages> {
        let all = |inputs: &[Input], messages: fn(&Input) -> Result<Messages>| -> Messages {
            let inputs = inputs.to_vec();
            // A file is opened when its turn comes.
            let of_each = inputs.into_iter().map(move |input| messages(&input));
            Box::new(of_each.flat_map(|messages| match messages {
                Ok(messages) => messages,
                Err(error) => Box::new(std::iter::once(Err(error))),
            }))
        };
        match self {
            Self::Mcap(inputs) => Ok(all(inputs, of_mcap)),
            Self::Bag(inputs) => Ok(all(inputs, of_bag)),
            Self::Sqlite(files) => of_sqlite(files, topic),
        }
    }
}

/// The first messages of a topic, and whether they say one and the same time, though they were logged one after the other.
fn first_messages(messages: &mut Messages, topic: &str) -> (Vec<Raw>, bool) {
    let is_wanted = |message: &Raw| message.topic == topic;
    let first: Vec<Raw> = messages.flatten().filter(is_wanted).take(1 + LOOKED_AHEAD).collect();
    let stamp = |message: &Raw| message.kind.and_then(|(kind, encoding)| kind.stamp(encoding, &message.data));
    let stamps: Vec<Option<f64>> = first.iter().map(stamp).collect();
    let is_constant =
        stamps.len() > LOOKED_AHEAD && stamps.iter().all(|stamp| stamp.is_some() && *stamp == stamps[0]);
    (first, is_constant)
}

/// The formats of scans, for messages about files without any.
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
            data: match unpacked(&message.data) {
                Ok(Cow::Owned(plain)) => plain,
                // What does not unpack is no message, and is refused as such.
                _ => message.data.into_owned(),
            },
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
    let messages = rosbag2::SqliteBag::open(files)?.messages(&[topic.to_owned()]);
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
        let stamp = if stamped > 0.0 && !self.by_log { stamped } else { logged };
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

    fn remarks(&self) -> Vec<String> {
        let what = "scans have the times at which they were logged: their own stand still";
        if self.by_log { vec![what.to_owned()] } else { Vec::new() }
    }

    fn next_scan(&mut self) -> Option<NextScan> {
        while !self.ended {
            match self.messages.next() {
                Some(Ok(message)) if message.topic == self.topic => return Some(self.scan(&message)),
                Some(Ok(_)) => {}
                Some(Err(error)) => self.damage.note(&format!("{error:#}")),
                None => {
                    self.ended = true;
                    let count = self.info.count.unwrap_or(0);
                    let damage = self.damage.text(&self.info.path, "scans", self.next, count)?;
                    let (name, what) = damage.split_once(": ").unwrap_or(("", &damage));
                    let scan = Err(ScanError::Format { name: name.into(), what: what.into() });
                    return Some(NextScan { index: self.next, stamp: f64::INFINITY, scan });
                }
            }
        }
        None
    }
}
