//! MCAP recordings: loopbox's own, and others with Foxglove or ROS 2 images.

mod linear;
mod seek;
mod survey;

use super::camera_topics::Match;
use super::input::Input;
use super::messages::{self, Content};
use super::topic_recording::{self, Stamped};
use super::topics::Topics;
use super::{FoundCalibration, FrameSource, SourceFrame, SourceInfo, SourceOptions, time};
use crate::damage::Damage;
use crate::forward::{LOOKED_AHEAD, StampVerdict, check_stamps};
use crate::messages::unpacked;
use crate::pictures::{GreyRange, Picture};
use crate::recalibrated::Recalibration;
use crate::recording::{GREY_RANGE, NumberSet, RecordedHead, read_head};
use anyhow::Result;
use calib::CameraHint;
use geometry::Camera;
use geometry::limits::MAX_BYTES;
use linear::Linear;
use mcap::McapResult;
use seek::MessagesFrom;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use survey::{Survey, content};

/// What starts every MCAP file.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// What would do as images, for people.
const LOOKED_FOR: &str = "foxglove.CompressedImage, RawImage and CompressedVideo (protobuf or JSON) and \
     sensor_msgs/msg/Image and CompressedImage (CDR)";

/// Messages in the order of the file. An error is a damage, after which there may be more.
pub type Messages = Box<dyn Iterator<Item = McapResult<mcap::Message<'static>>> + Send>;

/// A recording in an MCAP file: the images of one topic.
struct McapRecording {
    input: Input,
    info: SourceInfo,
    facts: Vec<(&'static str, String)>,
    topic: String,
    messages: Messages,
    summary: Option<mcap::Summary>,
    /// Whether loopbox wrote it: then messages bear the numbers of their frames.
    is_ours: bool,
    /// Numbers of frames to leave out.
    left_out: NumberSet,
    /// Images seen, and how many there should be.
    seen: u64,
    count: u64,
    damage: Damage,
    /// The range of samples of more than eight bits that the recorded run saw.
    range: Option<GreyRange>,
    /// Whether stamps stand still, so that images have the times at which they were logged.
    by_log: bool,
    /// The topic of the calibration of these images, and what it says as they go.
    calibration: Option<String>,
    recalibration: Recalibration,
    /// A message that was read to see what lies behind an image.
    next: Option<mcap::Message<'static>>,
}

/// Whether the file starts as MCAP files do.
pub fn is_mcap(path: &Path) -> bool {
    let mut start = [0; MAGIC.len()];
    File::open(path).and_then(|mut file| file.read_exact(&mut start)).is_ok() && start == MAGIC
}

/// Opens an MCAP file, at the topic of `options` if it has several with images.
///
/// # Errors
/// When it cannot be read, or has no images or not exactly one topic to take them from.
pub fn open(input: Input, options: &SourceOptions) -> Result<Box<dyn FrameSource>> {
    let (file, _) = input.open()?;
    let head = read_head(file, MAX_BYTES);
    let survey = Survey::of(&input, head.is_ours)?;
    let (topic, count) = survey.topics.choose(input.path(), options.topic.as_deref(), LOOKED_FOR)?;
    let info = SourceInfo {
        kind: if head.is_ours { "recording of loopbox" } else { "MCAP recording" },
        path: input.path().to_owned(),
        frame_count: Some(if options.all_frames {
            count
        } else {
            count.saturating_sub(survey.dropped.count())
        }),
        duration: survey.topics.duration(),
        calibration: calibration(&input, &head, &survey, &topic)?,
        camera: CameraHint { topic: Some(topic.clone()), ..CameraHint::default() },
        lag: head.lag().filter(|_| !options.all_frames),
    };
    let of_camera = survey.topics.calibration(&topic).found().filter(|_| !head.is_ours);
    if let Some(video @ Content::Video(_)) = survey.topics.content(&topic) {
        let messages = linear_with(&input, survey.summary.as_ref())?;
        // What cannot be read has no topic, and is told.
        let of_topic = messages.filter(move |m| m.as_ref().map_or(true, |m| m.channel.topic == topic));
        let stamped = of_topic.map(|message| {
            let message = message?;
            let (time, data) = (message.log_time, message.data.into_owned());
            Ok(Stamped { time, data, calibration: None })
        });
        return topic_recording::open(info, facts(&head, &survey), Some(video), stamped);
    }
    let range = head.is_ours.then(|| survey.ending.get(GREY_RANGE)).flatten();
    let messages = linear_with(&input, survey.summary.as_ref())?;
    let mut recording = McapRecording {
        facts: facts(&head, &survey),
        messages,
        range: range.and_then(|text| GreyRange::parse(text)),
        summary: survey.summary,
        is_ours: head.is_ours,
        calibration: of_camera,
        next: None,
        recalibration: Recalibration::of(&topic),
        left_out: if options.all_frames { NumberSet::default() } else { survey.dropped },
        input,
        info,
        topic,
        seen: 0,
        count,
        damage: Damage::default(),
        by_log: false,
    };
    recording.by_log = !recording.is_ours && recording.stamps_are_constant();
    Ok(Box::new(recording))
}

impl McapRecording {
    /// The frame in a message, unless it is another topic's or to be left out.
    fn frame(&mut self, message: &mcap::Message) -> Option<SourceFrame> {
        let form = match content(&message.channel) {
            Some(Content::Image(form)) => form,
            Some(Content::Calibration(form)) => {
                self.see(form, message);
                return None;
            }
            _ => return None,
        };
        if message.channel.topic != self.topic {
            return None;
        }
        let index = if self.is_ours { message.sequence.into() } else { self.seen };
        self.seen += 1;
        if self.is_ours && self.left_out.contains(message.sequence) {
            return None;
        }
        let log_time = time::seconds(message.log_time);
        let (stamp, picture) =
            match unpacked(&message.data).and_then(|data| messages::read_image(form, &data)) {
                Ok(image) => (image.stamp, image.picture),
                Err(error) => (None, Picture::Broken(format!("{error:#}"))),
            };
        let picture = match self.range {
            Some(range) if self.is_ours => Picture::Ranged(Box::new(picture), range),
            _ => picture,
        };
        let timestamp = stamp.filter(|_| !self.by_log).unwrap_or(log_time);
        let before = self.recalibration.current();
        self.see_behind();
        let around = [before, self.recalibration.current()];
        let picture = self.recalibration.judge(picture, (index, timestamp), &around);
        Some(SourceFrame { index, timestamp, captured: None, picture })
    }

    /// Takes a calibration in, where it is that of these images.
    fn see(&mut self, form: messages::Form, message: &mcap::Message) {
        if self.calibration.as_ref() == Some(&message.channel.topic) {
            let info = unpacked(&message.data).and_then(|data| messages::read_calibration(form, &data));
            self.recalibration.see(info);
        }
    }

    /// Takes in the calibration that lies behind an image, before the next one.
    fn see_behind(&mut self) {
        let Some(calibration) = self.calibration.clone() else { return };
        while let Some(message) = self.message() {
            if message.channel.topic == calibration {
                if let Some(Content::Calibration(form)) = content(&message.channel) {
                    self.see(form, &message);
                }
                return;
            }
            if message.channel.topic == self.topic {
                self.next = Some(message);
                return;
            }
        }
    }

    /// The next message that can be read.
    fn message(&mut self) -> Option<mcap::Message<'static>> {
        if let Some(message) = self.next.take() {
            return Some(message);
        }
        loop {
            match self.messages.next()? {
                Ok(message) => return Some(message),
                Err(error) => self.damage.note(&error),
            }
        }
    }

    /// What the first frames are; the recording is at its start again afterwards.
    fn first_frames(&mut self) -> Vec<SourceFrame> {
        let frames = std::iter::from_fn(|| self.next_frame()).take(1 + LOOKED_AHEAD).collect();
        if let Ok(messages) = linear_with(&self.input, self.summary.as_ref()) {
            (self.seen, self.damage, self.messages) = (0, Damage::default(), messages);
            (self.recalibration, self.next) = (Recalibration::of(&self.topic), None);
        }
        frames
    }

    /// Time stamp of the first frame whose stamp is the clock's.
    fn first_timestamp(&mut self) -> Option<f64> {
        let stamps: Vec<f64> = self.first_frames().iter().map(|frame| frame.timestamp).collect();
        check_stamps(&stamps)
            .0
            .into_iter()
            .find_map(|one| if let StampVerdict::At(time) = one { Some(time) } else { None })
    }

    /// Whether messages say one and the same time, though they were logged one after the other.
    fn stamps_are_constant(&mut self) -> bool {
        if self.count <= LOOKED_AHEAD as u64 {
            return false;
        }
        let stamps: Vec<f64> = self.first_frames().iter().map(|frame| frame.timestamp).collect();
        stamps.len() > LOOKED_AHEAD && stamps.iter().all(|stamp| *stamp == stamps[0])
    }

    /// Whether chunks lie in the order of their times, so that one can seek a time.
    fn has_order(&self) -> bool {
        let Some(summary) = &self.summary else { return false };
        let mut chunks: Vec<_> =
            summary.chunk_indexes.iter().filter(|chunk| chunk.message_end_time > 0).collect();
        chunks.sort_by_key(|chunk| chunk.chunk_start_offset);
        chunks.windows(2).all(|pair| pair[0].message_end_time <= pair[1].message_start_time)
    }
}

impl FrameSource for McapRecording {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        loop {
            let message = self.message()?;
            if let Some(frame) = self.frame(&message) {
                return Some(frame);
            }
        }
    }

    fn expect_camera(&mut self, camera: &Camera) {
        self.recalibration.expect_camera(camera);
    }

    fn warning(&self) -> Option<String> {
        self.damage.text(&self.info.path, "images", self.seen, self.count)
    }

    fn skip_to(&mut self, start: f64) -> Option<f64> {
        /// Times in seconds are that good at least.
        const MARGIN_NS: u64 = 1_000;
        // Elsewhere frames are not logged at the time of their stamp, nor numbered.
        if !self.is_ours || !self.has_order() {
            return None;
        }
        let first = self.first_timestamp()?;
        let from = time::nanoseconds(first + start)?.saturating_sub(MARGIN_NS);
        let summary = self.summary.as_ref()?;
        let messages = MessagesFrom::new(&self.input, summary, &self.topic, from).ok()?;
        self.messages = Box::new(messages);
        Some(first)
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        let mut facts = self.facts.clone();
        facts.extend(self.range.map(|range| ("bits", range.text())));
        if self.by_log {
            facts.push(("times", "those at which messages were logged: their own stand still".into()));
        }
        facts
    }
}

/// The topics of a file.
///
/// # Errors
/// When it cannot be opened.
pub fn topics(input: &Input) -> Result<Topics> {
    Ok(Survey::of(input, false)?.topics)
}

/// All messages of a file, in its order.
///
/// # Errors
/// When it cannot be opened.
pub fn linear(input: &Input) -> Result<Messages> {
    linear_with(input, survey::summary(input)?.as_ref())
}

fn linear_with(input: &Input, summary: Option<&mcap::Summary>) -> Result<Messages> {
    Ok(Box::new(Linear::open(input, summary)?))
}

/// What `loopbox info` says beyond what it says of every source.
fn facts(head: &RecordedHead, survey: &Survey) -> Vec<(&'static str, String)> {
    let mut facts = survey.topics.facts();
    if let Some(source) = head.about.get("source") {
        let kind = head.about.get("kind").map_or("", String::as_str);
        facts.push(("recorded", format!("{source} ({kind})")));
    }
    if survey.dropped.count() > 0 {
        let text = format!("{} frames, left out of a replay: {}", survey.dropped.count(), survey.dropped);
        facts.push(("dropped", text));
    }
    if let Some(count) = survey.ending.get("left out").filter(|count| *count != "0") {
        facts.push(("missing", format!("{count} frames: the disk was too slow for them")));
    }
    facts
}

/// The calibration that came with the images: the attached files, else the first message.
fn calibration(
    input: &Input,
    head: &RecordedHead,
    survey: &Survey,
    topic: &str,
) -> Result<Option<FoundCalibration>> {
    if head.is_ours && !head.calibration.is_empty() {
        let name = head.calibration.camera.as_ref().map_or("no camera", |file| &file.name);
        let origin = format!("{name} in {}", input.path().display());
        return Ok(Some(FoundCalibration::Recorded { origin, files: Box::new(head.calibration.clone()) }));
    }
    let wanted = match survey.topics.calibration(topic) {
        Match::Found(wanted) => wanted,
        Match::Unclear(names) => return Ok(Some(FoundCalibration::unclear(&names, input.path(), topic))),
        Match::Others(_) => return Ok(None),
    };
    let of_topic = linear(input)?.flatten().filter(|message| message.channel.topic == wanted);
    let infos = of_topic.filter_map(|message| {
        let form = content(&message.channel)?.calibration()?;
        Some(unpacked(&message.data).and_then(|data| messages::read_calibration(form, &data)))
    });
    Ok(FoundCalibration::of_messages(&wanted, input.path(), topic, infos))
}
