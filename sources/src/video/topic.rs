//! The images of a video whose packets are messages of a recording, as `foxglove.CompressedVideo` has them.

use super::decoder::Decoder;
use super::packets::{Codec, write_head, write_packet};
use crate::damage::Damage;
use crate::messages::{self, Form, VideoMessage};
use crate::pictures::Picture;
use crate::topic_recording::Stamped;
use crate::{FrameSource, SourceFrame, SourceInfo, time};
use anyhow::{Context, Result, bail};
use std::collections::BTreeMap;
use std::io::{BufWriter, Write};
use std::process::ChildStdin;
use std::sync::mpsc::{self, Receiver, Sender};

/// A video as messages of one topic.
pub struct TopicVideo {
    info: SourceInfo,
    facts: Vec<(&'static str, String)>,
    decoder: Decoder,
    fed: Receiver<Fed>,
    /// Seconds of the packets that gave no image yet, by number.
    times: BTreeMap<u64, f64>,
    next_index: u64,
    damage: Damage,
    /// Why the images ended before the messages did.
    failure: Option<String>,
}

/// What the thread that feeds the decoder tells of a message.
enum Fed {
    /// The number of a packet and when its image was taken, seconds.
    Packet(u64, f64),
    /// One that could not be read.
    Damaged(String),
}

type Messages = Box<dyn Iterator<Item = Result<Stamped>> + Send>;

impl TopicVideo {
    /// The images of the video in `messages`, which all have this form. An error among them is a damage, after which
    /// more may follow. What lies before the first key frame has no image.
    ///
    /// # Errors
    /// When no message holds a key frame, the codec is not read, or `ffmpeg` is not installed.
    pub fn start(
        info: SourceInfo,
        mut facts: Vec<(&'static str, String)>,
        form: Form,
        messages: impl Iterator<Item = Result<Stamped>> + Send + 'static,
    ) -> Result<Self> {
        let (sender, fed) = mpsc::channel();
        let mut packets = Packets { form, messages: Box::new(messages), number: 0, reports: sender };
        let path = info.path.display();
        let first = packets.find_map(|(message, number, time)| match Codec::named(&message.codec) {
            Ok(codec) => codec.can_begin_with(&message.data).then_some(Ok((codec, message, number, time))),
            Err(error) => Some(Err(error)),
        });
        let Some(first) = first else {
            bail!(
                "{path}: no message of the video holds a key frame, so that no image can be decoded\nhint: record from the camera's \
                 start, or have its encoder repeat key frames"
            );
        };
        let (codec, message, number, time) =
            first.with_context(|| format!("{path}: the video is not read"))?;
        let first = (message, number, time);
        let feed = move |to: ChildStdin| packets.feed(codec, first, to);
        let decoder = Decoder::of_packets(codec.decoder(), feed).with_context(|| path.to_string())?;
        facts.push(("codec", codec.decoder().to_owned()));
        let (times, damage) = (BTreeMap::new(), Damage::default());
        Ok(Self { facts, decoder, fed, times, next_index: 0, damage, failure: None, info })
    }

    /// The next image; `None` at the end.
    fn frame(&mut self) -> Result<Option<SourceFrame>> {
        let decoded = self.decoder.next()?;
        for fed in self.fed.try_iter() {
            match fed {
                Fed::Packet(number, time) => drop(self.times.insert(number, time)),
                Fed::Damaged(what) => self.damage.note(&what),
            }
        }
        let Some((number, picture)) = decoded else { return Ok(None) };
        // Numbers are the stream's seconds.
        let number = number.context("an image has no packet")?.round() as u64;
        let timestamp = self.times.remove(&number).context("an image of no packet")?;
        let index = self.next_index;
        self.next_index += 1;
        Ok(Some(SourceFrame { index, timestamp, captured: None, picture: Picture::Raw(picture) }))
    }
}

impl FrameSource for TopicVideo {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn next_frame(&mut self) -> Option<SourceFrame> {
        if self.failure.is_some() {
            return None;
        }
        self.frame().unwrap_or_else(|error| {
            self.failure = Some(format!("{error:#}"));
            None
        })
    }

    fn decodes(&self) -> bool {
        true
    }

    fn warning(&self) -> Option<String> {
        let (path, seen) = (&self.info.path, self.next_index);
        let count = self.info.frame_count.unwrap_or(0);
        if let Some(failure) = &self.failure {
            return Some(format!("{}: the video ends after {seen} images: {failure}", path.display()));
        }
        if let Some(damage) = self.damage.text(path, "images", seen, count) {
            return Some(damage);
        }
        let why = match self.decoder.troubles() {
            [] => "it begins between two key frames, or packets are missing".to_owned(),
            troubles => troubles.join("; "),
        };
        (seen < count).then(|| {
            format!(
                "{}: {} of {count} packets of the video gave no image: {why}",
                path.display(),
                count - seen
            )
        })
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        self.facts.clone()
    }
}

/// The messages of a video with their numbers and seconds; what is damaged is told.
struct Packets {
    form: Form,
    messages: Messages,
    number: u64,
    reports: Sender<Fed>,
}

impl Packets {
    /// Writes all packets from the first that can be decoded on, each told before it is written.
    fn feed(mut self, codec: Codec, first: (VideoMessage, u64, f64), to: ChildStdin) {
        let mut to = BufWriter::new(to);
        let mut written = write_head(&mut to, codec);
        let mut next = Some(first);
        // A reader that is gone, or a decoder, wants no more.
        while let Some((message, number, time)) = next
            && written.is_ok()
            && self.reports.send(Fed::Packet(number, time)).is_ok()
        {
            written = write_packet(&mut to, number, &message.data).and_then(|()| to.flush());
            next = self.next();
        }
    }
}

impl Iterator for Packets {
    type Item = (VideoMessage, u64, f64);

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let read = self.messages.next()?.and_then(|message| {
                self.number += 1;
                let data = messages::unpacked(&message.data)?;
                Ok((messages::read_video(self.form, &data)?, time::seconds(message.time)))
            });
            match read {
                Ok((video, recorded)) => {
                    let time = video.stamp.unwrap_or(recorded);
                    return Some((video, self.number - 1, time));
                }
                // Where nobody listens, nobody wants to know.
                Err(error) => drop(self.reports.send(Fed::Damaged(format!("{error:#}")))),
            }
        }
    }
}
