//! MCAP recordings with Foxglove or ROS 2 images.

use super::messages::{self, Content};
use super::{FoundCalibration, FrameSource, SourceFrame, SourceInfo};
use crate::pictures::Picture;
use anyhow::{Context, Result, bail};
use mcap::McapError;
use mcap::io::MessageReader;
use mcap::sans_io::{LinearReaderOptions, SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

/// What starts every MCAP file.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";

type Messages = MessageReader<BufReader<File>>;

/// A recording in an MCAP file: the images of one topic.
pub struct McapRecording {
    info: SourceInfo,
    topic: String,
    messages: Messages,
    next_index: u64,
    warning: Option<String>,
}

/// Whether the file starts as MCAP files do.
pub fn is_mcap(path: &Path) -> bool {
    let mut start = [0; MAGIC.len()];
    File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start == MAGIC
}

/// Opens an MCAP file, at `topic` if it has several with images.
///
/// # Errors
/// When it cannot be read, or has no images or not exactly one topic to take them from.
pub fn open(path: &Path, topic: Option<&str>) -> Result<McapRecording> {
    let survey = Survey::of(path)?;
    let (topic, count) = survey.choose(path, topic)?;
    let calibration =
        survey.calibration_topic(&topic).map(|wanted| first_calibration(path, &wanted)).transpose()?;
    let info = SourceInfo {
        kind: "MCAP recording",
        path: path.to_owned(),
        frame_count: Some(count),
        duration: survey.duration(),
        calibration: calibration.flatten(),
    };
    Ok(McapRecording { info, topic, messages: reader(path)?, next_index: 0, warning: None })
}

impl FrameSource for McapRecording {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        loop {
            let message = match self.messages.next()? {
                Ok(message) => message,
                Err(error) => {
                    self.warning = Some(format!(
                        "{}: the file is damaged or ends early; its {} whole images are used ({error})",
                        self.info.path.display(),
                        self.next_index
                    ));
                    return None;
                }
            };
            if message.channel.topic != self.topic {
                continue;
            }
            let Some(Content::Image(form)) = content(&message.channel) else { continue };
            let index = self.next_index;
            self.next_index += 1;
            let log_time = seconds(message.log_time);
            let (timestamp, picture) = match messages::read_image(form, &message.data) {
                Ok(image) => (image.stamp.unwrap_or(log_time), image.picture),
                Err(error) => (log_time, Picture::Broken(format!("{error:#}"))),
            };
            return Some(SourceFrame { index, timestamp, captured: None, picture });
        }
    }

    fn warning(&self) -> Option<String> {
        self.warning.clone()
    }
}

fn content(channel: &mcap::Channel) -> Option<Content> {
    Content::of(&channel.schema.as_ref()?.name, &channel.message_encoding)
}

fn seconds(nanoseconds: u64) -> f64 {
    super::euroc::seconds_from_ns(nanoseconds)
}

fn open_file(path: &Path) -> Result<(File, u64)> {
    let file = File::open(path).with_context(|| format!("{}: cannot be opened", path.display()))?;
    let size = file.metadata().with_context(|| format!("{}: cannot be read", path.display()))?.len();
    Ok((file, size))
}

/// The longest record to believe in: a damaged length must not ask for all memory, though what a file
/// unpacks to may be longer than the file.
fn record_limit(file_size: u64) -> usize {
    const ANY_IMAGE: u64 = 256 << 20;
    file_size.max(ANY_IMAGE) as usize
}

fn reader(path: &Path) -> Result<Messages> {
    let (file, size) = open_file(path)?;
    let options = LinearReaderOptions::default().with_record_length_limit(record_limit(size));
    Ok(MessageReader::new_with_options(BufReader::new(file), options))
}

/// What is on a topic.
struct Topic {
    content: Content,
    count: u64,
}

/// The topics with images and calibrations, by name.
#[derive(Default)]
struct Survey {
    topics: BTreeMap<String, Topic>,
    /// Log times of the first and last message, nanoseconds.
    span: Option<(u64, u64)>,
}

impl Survey {
    /// From the summary at the file's end, or from all its messages where there is none.
    fn of(path: &Path) -> Result<Self> {
        let (mut file, size) = open_file(path)?;
        match read_summary(&mut file, size) {
            Ok(Some(summary)) if summary.stats.is_some() => Ok(Self::from_summary(&summary)),
            // A truncated file has no summary; the messages tell what it was.
            _ => Self::from_messages(reader(path)?),
        }
    }

    fn from_summary(summary: &mcap::Summary) -> Self {
        let mut survey = Self::default();
        let Some(statistics) = &summary.stats else { return survey };
        for (id, channel) in &summary.channels {
            survey.count(channel, statistics.channel_message_counts.get(id).copied().unwrap_or(0));
        }
        survey.span = Some((statistics.message_start_time, statistics.message_end_time));
        survey
    }

    fn from_messages(messages: Messages) -> Result<Self> {
        let mut survey = Self::default();
        // What follows the first error cannot be read; the reader says so again when frames are taken.
        for message in messages.map_while(Result::ok) {
            survey.count(&message.channel, 1);
            let (first, last) = survey.span.unwrap_or((message.log_time, message.log_time));
            survey.span = Some((first.min(message.log_time), last.max(message.log_time)));
        }
        Ok(survey)
    }

    fn count(&mut self, channel: &mcap::Channel, messages: u64) {
        if messages > 0
            && let Some(content) = content(channel)
        {
            self.topics.entry(channel.topic.clone()).or_insert(Topic { content, count: 0 }).count += messages;
        }
    }

    fn images(&self) -> impl Iterator<Item = (&String, u64)> {
        let images = self.topics.iter().filter(|(_, topic)| matches!(topic.content, Content::Image(_)));
        images.map(|(name, topic)| (name, topic.count))
    }

    /// The topic to take images from and how many there are.
    fn choose(&self, path: &Path, wanted: Option<&str>) -> Result<(String, u64)> {
        let names =
            || -> Vec<String> { self.images().map(|(name, n)| format!("{name} ({n} images)")).collect() };
        let mut candidates = self.images().filter(|(name, _)| wanted.is_none_or(|wanted| *name == wanted));
        match (candidates.next(), candidates.next(), wanted) {
            (Some((name, count)), None, _) => Ok((name.clone(), count)),
            (None, _, Some(wanted)) if !names().is_empty() => {
                bail!(
                    "{}: no images on topic {wanted}\nhint: there are {}",
                    path.display(),
                    names().join(", ")
                )
            }
            (None, _, _) => bail!(
                "{}: no images in this MCAP file\nhint: looked for foxglove.CompressedImage and foxglove.RawImage \
                 (protobuf or JSON) and sensor_msgs/msg/Image and CompressedImage (CDR)",
                path.display()
            ),
            (Some(_), Some(_), _) => bail!(
                "{}: images on several topics\nhint: choose one with --topic: {}",
                path.display(),
                names().join(", ")
            ),
        }
    }

    /// The calibration topic whose name shares the most with the images' topic, as
    /// `/cam0/camera_info` with `/cam0/image_raw`.
    fn calibration_topic(&self, images: &str) -> Option<String> {
        let shared = |name: &str| name.bytes().zip(images.bytes()).take_while(|(a, b)| a == b).count();
        let calibrations = self.topics.iter().filter(|(_, t)| matches!(t.content, Content::Calibration(_)));
        calibrations.map(|(name, _)| name).max_by_key(|name| shared(name)).cloned()
    }

    fn duration(&self) -> Option<f64> {
        self.span.map(|(first, last)| last.saturating_sub(first) as f64 * 1e-9)
    }
}

fn read_summary(file: &mut File, size: u64) -> Result<Option<mcap::Summary>, McapError> {
    let options =
        SummaryReaderOptions::default().with_file_size(size).with_record_length_limit(record_limit(size));
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(count) => {
                let read = file.read(reader.insert(count))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
        }
    }
    Ok(reader.finish())
}

/// The first calibration on `topic`.
fn first_calibration(path: &Path, topic: &str) -> Result<Option<FoundCalibration>> {
    for message in reader(path)?.map_while(Result::ok).filter(|message| message.channel.topic == topic) {
        let Some(Content::Calibration(form)) = content(&message.channel) else { continue };
        let origin = format!("topic {topic} of {}", path.display());
        return Ok(Some(match messages::read_calibration(form, &message.data) {
            Ok(camera) => FoundCalibration::Inside { origin, camera: Box::new(camera) },
            Err(error) => FoundCalibration::Unusable { origin, reason: format!("{error:#}") },
        }));
    }
    Ok(None)
}
