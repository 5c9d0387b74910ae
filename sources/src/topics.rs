//! The topics of a recording in messages, and which of them to take.

use super::camera_topics::{Match, calibration_of};
use super::messages::Content;
use anyhow::{Result, bail};
use std::collections::BTreeMap;
use std::path::Path;

/// What is on a topic.
#[derive(Debug)]
pub struct Topic {
    /// The content that loopbox reads there; `None` for anything else.
    pub content: Option<Content>,
    /// The type of its messages.
    pub schema: String,
    /// How many there are.
    pub count: u64,
}

/// The topics of a recording by name, and its span in time.
#[derive(Debug, Default)]
pub struct Topics {
    by_name: BTreeMap<String, Topic>,
    /// Log times of the first and last message, nanoseconds.
    pub span: Option<(u64, u64)>,
}

impl Topics {
    /// Adds messages of a topic.
    pub fn count(&mut self, name: &str, schema: &str, content: Option<Content>, messages: u64) {
        if messages == 0 {
            return;
        }
        if let Some(topic) = self.by_name.get_mut(name) {
            topic.count += messages;
            return;
        }
        self.by_name.insert(name.to_owned(), Topic { content, schema: schema.to_owned(), count: messages });
    }

    /// Adds those of another file of the recording.
    pub fn add(&mut self, other: Self) {
        for (name, topic) in other.by_name {
            self.count(&name, &topic.schema, topic.content, topic.count);
        }
        for time in other.span.into_iter().flat_map(|(first, last)| [first, last]) {
            self.at(time);
        }
    }

    /// Widens the span to a log time.
    pub fn at(&mut self, time: u64) {
        let (first, last) = self.span.unwrap_or((time, time));
        self.span = Some((first.min(time), last.max(time)));
    }

    /// The topics whose schema is `wanted`, with the numbers of their messages.
    pub fn of_schema(&self, wanted: impl Fn(&str) -> bool) -> Vec<(String, u64)> {
        let found = self.by_name.iter().filter(|(_, topic)| wanted(&topic.schema));
        found.map(|(name, topic)| (name.clone(), topic.count)).collect()
    }

    /// Whether there are images.
    pub fn has_images(&self) -> bool {
        self.images().next().is_some()
    }

    fn images(&self) -> impl Iterator<Item = (&String, u64)> {
        let is_image = |topic: &Topic| matches!(topic.content, Some(Content::Image(_) | Content::Video(_)));
        let images = self.by_name.iter().filter(move |(_, topic)| is_image(topic));
        images.map(|(name, topic)| (name, topic.count))
    }

    /// Whether a topic is a video; where another holds the images themselves, they are taken, since a video loses some of them.
    fn is_video(&self, name: &str) -> bool {
        matches!(self.content(name), Some(Content::Video(_)))
    }

    /// The topic to take images from and how many there are: where one topic holds images and others hold videos, that one.
    ///
    /// # Errors
    /// When there are none, or several and `wanted` names none of them; `looked_for` is what would do.
    pub fn choose(&self, path: &Path, wanted: Option<&str>, looked_for: &str) -> Result<(String, u64)> {
        let names =
            || -> Vec<String> { self.images().map(|(name, n)| format!("{name} ({n} images)")).collect() };
        let has_images = self.images().any(|(name, _)| !self.is_video(name));
        let may_be_taken = |name: &str| match wanted {
            Some(wanted) => name == wanted,
            None => !(has_images && self.is_video(name)),
        };
        let mut candidates = self.images().filter(|(name, _)| may_be_taken(name));
        match (candidates.next(), candidates.next(), wanted) {
            (Some((name, count)), None, _) => Ok((name.clone(), count)),
            (None, _, Some(wanted)) if !names().is_empty() => {
                bail!(
                    "{}: no images on topic {wanted}\nhint: there are {}",
                    path.display(),
                    names().join(", ")
                )
            }
            (None, _, _) => {
                bail!(
                    "{}: no images in this file{}\nhint: looked for {looked_for}",
                    path.display(),
                    self.text()
                )
            }
            (Some(_), Some(_), _) => bail!(
                "{}: images on several topics\nhint: choose one with --topic: {}",
                path.display(),
                names().join(", ")
            ),
        }
    }

    /// What there is, topic by topic, for people.
    fn text(&self) -> String {
        if self.by_name.is_empty() {
            return ", nor any other message".to_owned();
        }
        let topic = |(name, topic): (&String, &Topic)| format!("{name} ({} × {})", topic.count, topic.schema);
        let topics: Vec<String> = self.by_name.iter().map(topic).collect();
        format!(", but {}", topics.join(", "))
    }

    /// The content of a topic that loopbox reads.
    pub fn content(&self, name: &str) -> Option<Content> {
        self.by_name.get(name)?.content
    }

    /// The calibration topic that is the camera's on the topic `images`.
    pub fn calibration(&self, images: &str) -> Match {
        let calibrations = self.by_name.iter();
        let calibrations: Vec<&str> = calibrations
            .filter(|(_, topic)| matches!(topic.content, Some(Content::Calibration(_))))
            .map(|(name, _)| name.as_str())
            .collect();
        let all: Vec<&str> = self.images().map(|(name, _)| name.as_str()).collect();
        calibration_of(images, &all, &calibrations)
    }

    /// Seconds from the first to the last message.
    pub fn duration(&self) -> Option<f64> {
        self.span.map(|(first, last)| last.saturating_sub(first) as f64 * 1e-9)
    }

    /// A line for each topic, for people.
    pub fn facts(&self) -> Vec<(&'static str, String)> {
        let topics = self.by_name.iter();
        topics.map(|(name, topic)| ("topic", format!("{name}  {} × {}", topic.count, topic.schema))).collect()
    }
}
