//! The images of one topic of a bag, whatever the bag's container.

use crate::damage::Damage;
use crate::forward::LOOKED_AHEAD;
use crate::messages::{self, Content, Form, ImageMessage};
use crate::pictures::Picture;
use crate::recalibrated::{Around, Recalibration};
use crate::video::TopicVideo;
use crate::{FrameSource, SourceFrame, SourceInfo, time};
use anyhow::{Result, bail};
use geometry::Camera;
use std::collections::VecDeque;
use std::iter::Peekable;

/// A message of the topic, or of that of its camera's calibration.
pub struct Stamped {
    /// When it was recorded, nanoseconds.
    pub time: u64,
    /// Its bytes.
    pub data: Vec<u8>,
    /// The form of a calibration; `None` of images.
    pub calibration: Option<Form>,
}

/// An image that was read: when it was recorded, what it is, and what the calibration is around it.
type Read = (u64, Result<ImageMessage>, Around);

/// A recording of images as messages of one topic.
struct TopicRecording {
    info: SourceInfo,
    facts: Vec<(&'static str, String)>,
    form: Form,
    messages: Peekable<Box<dyn Iterator<Item = Result<Stamped>> + Send>>,
    /// Images that were read already.
    ahead: VecDeque<Read>,
    next_index: u64,
    damage: Damage,
    /// Whether stamps stand still, so that images have the times at which they were recorded.
    by_log: bool,
    recalibration: Recalibration,
}

/// Opens the images on a topic of this content, images or a video.
///
/// # Errors
/// When it is a video that cannot be decoded here, or neither.
pub fn open(
    info: SourceInfo,
    facts: Vec<(&'static str, String)>,
    content: Option<Content>,
    messages: impl Iterator<Item = Result<Stamped>> + Send + 'static,
) -> Result<Box<dyn FrameSource>> {
    match content {
        Some(Content::Image(form)) => Ok(Box::new(TopicRecording::new(info, facts, form, messages))),
        Some(Content::Video(form)) => {
            let of_video = |message: &Result<Stamped>| {
                message.as_ref().map_or(true, |message| message.calibration.is_none())
            };
            Ok(Box::new(TopicVideo::start(info, facts, form, messages.filter(of_video))?))
        }
        Some(Content::Calibration(_)) | None => bail!("{}: the topic holds no images", info.path.display()),
    }
}

impl TopicRecording {
    /// The images in `messages`, all of them of this form; an error is a damage, after which there may be more.
    fn new(
        info: SourceInfo,
        facts: Vec<(&'static str, String)>,
        form: Form,
        messages: impl Iterator<Item = Result<Stamped>> + Send + 'static,
    ) -> Self {
        let recalibration = Recalibration::of(info.camera.topic.as_deref().unwrap_or_default());
        let mut recording = Self {
            info,
            recalibration,
            facts,
            form,
            messages: (Box::new(messages) as Box<dyn Iterator<Item = Result<Stamped>> + Send>).peekable(),
            ahead: VecDeque::new(),
            next_index: 0,
            damage: Damage::default(),
            by_log: false,
        };
        recording.look_at_stamps();
        recording
    }

    /// The next image, with the time at which it was recorded.
    fn read(&mut self) -> Option<Read> {
        loop {
            match self.messages.next()? {
                Ok(Stamped { data, calibration: Some(form), .. }) => {
                    self.recalibration.see(messages::read_calibration(form, &data));
                }
                Ok(message) => {
                    let image = messages::read_image(self.form, &message.data);
                    let before = self.recalibration.current();
                    self.see_behind();
                    return Some((message.time, image, [before, self.recalibration.current()]));
                }
                Err(error) => self.damage.note(&format!("{error:#}")),
            }
        }
    }

    /// Takes in the calibration that lies behind an image.
    fn see_behind(&mut self) {
        let is_calibration =
            |next: &Result<Stamped>| matches!(next, Ok(Stamped { calibration: Some(_), .. }));
        if let Some(Ok(Stamped { data, calibration: Some(form), .. })) = self.messages.next_if(is_calibration)
        {
            self.recalibration.see(messages::read_calibration(form, &data));
        }
    }

    /// Finds out whether the first messages say one and the same time, though they were recorded one after the other.
    fn look_at_stamps(&mut self) {
        while self.ahead.len() <= LOOKED_AHEAD
            && let Some(image) = self.read()
        {
            self.ahead.push_back(image);
        }
        let stamps: Vec<Option<f64>> = self
            .ahead
            .iter()
            .map(|(_, image, _)| image.as_ref().ok().and_then(|image| image.stamp))
            .collect();
        let is_constant = stamps.len() > LOOKED_AHEAD && stamps.iter().all(|stamp| *stamp == stamps[0]);
        self.by_log = is_constant && stamps[0].is_some();
        if self.by_log {
            let what = "those at which messages were recorded: their own stand still";
            self.facts.push(("times", what.into()));
        }
    }
}

impl FrameSource for TopicRecording {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        let (recorded, image, around) = self.ahead.pop_front().or_else(|| self.read())?;
        let index = self.next_index;
        self.next_index += 1;
        let (stamp, picture) = match image {
            Ok(image) => (image.stamp, image.picture),
            Err(error) => (None, Picture::Broken(format!("{error:#}"))),
        };
        let timestamp = stamp.filter(|_| !self.by_log).unwrap_or_else(|| time::seconds(recorded));
        let picture = self.recalibration.judge(picture, (index, timestamp), &around);
        Some(SourceFrame { index, timestamp, captured: None, picture })
    }

    fn expect_camera(&mut self, camera: &Camera) {
        self.recalibration.expect_camera(camera);
    }

    fn warning(&self) -> Option<String> {
        let count = self.info.frame_count.unwrap_or(0);
        self.damage.text(&self.info.path, "images", self.next_index, count)
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        self.facts.clone()
    }
}
