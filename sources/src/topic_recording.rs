//! The images of one topic of a bag, whatever the bag's container.

use crate::messages::{self, Form};
use crate::pictures::Picture;
use crate::{FrameSource, SourceFrame, SourceInfo, time};
use anyhow::Result;

/// A message of the topic.
pub struct Stamped {
    /// When it was recorded, nanoseconds.
    pub time: u64,
    /// What it says.
    pub data: Vec<u8>,
}

/// A recording of images as messages of one topic.
pub struct TopicRecording {
    info: SourceInfo,
    facts: Vec<(&'static str, String)>,
    form: Form,
    messages: Box<dyn Iterator<Item = Result<Stamped>> + Send>,
    next_index: u64,
    warning: Option<String>,
}

impl TopicRecording {
    /// The images in `messages`, all of them of this form; after an error none is asked for.
    pub fn new(
        info: SourceInfo,
        facts: Vec<(&'static str, String)>,
        form: Form,
        messages: impl Iterator<Item = Result<Stamped>> + Send + 'static,
    ) -> Self {
        Self { info, facts, form, messages: Box::new(messages), next_index: 0, warning: None }
    }
}

impl FrameSource for TopicRecording {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        if self.warning.is_some() {
            return None;
        }
        let message = match self.messages.next()? {
            Ok(message) => message,
            Err(error) => {
                self.warning = Some(format!(
                    "{}: the bag is damaged or ends early; its {} whole images are used ({error:#})",
                    self.info.path.display(),
                    self.next_index
                ));
                return None;
            }
        };
        let index = self.next_index;
        self.next_index += 1;
        let (stamp, picture) = match messages::read_image(self.form, &message.data) {
            Ok(image) => (image.stamp, image.picture),
            Err(error) => (None, Picture::Broken(format!("{error:#}"))),
        };
        let timestamp = stamp.unwrap_or_else(|| time::seconds(message.time));
        Some(SourceFrame { index, timestamp, captured: None, picture })
    }

    fn warning(&self) -> Option<String> {
        self.warning.clone()
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        self.facts.clone()
    }
}
