//! The content of an MCAP file, found before its frames are read.

use super::{Messages, linear};
use crate::input::{Bytes, Input};
use crate::messages::Content;
use crate::recording::{DROPPED_METADATA, DROPPED_TOPIC, NumberSet, dropped_number};
use crate::topics::Topics;
use anyhow::Result;
use geometry::limits::MAX_BYTES;
use mcap::McapError;
use mcap::records::Record;
use mcap::sans_io::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use std::collections::BTreeMap;
use std::io::{BufReader, Read, Seek, SeekFrom};

/// The content of an MCAP file.
#[derive(Default)]
pub struct Survey {
    /// Its topics.
    pub topics: Topics,
    /// Its index, where it has one that could be read.
    pub summary: Option<mcap::Summary>,
    /// Numbers of frames that the recorded run did not process.
    pub dropped: NumberSet,
    /// The metadata that the recorder wrote at the end.
    pub ending: BTreeMap<String, String>,
}

impl Survey {
    /// From the summary at the file's end, or from all its messages where there is none.
    ///
    /// # Errors
    /// When the file cannot be opened.
    pub fn of(input: &Input, is_ours: bool) -> Result<Self> {
        let (mut file, size) = input.open()?;
        if let Ok(Some(summary)) = read_summary(&mut file, size)
            && let Some(statistics) = &summary.stats
        {
            let mut survey = Self::default();
            for (id, channel) in &summary.channels {
                survey.count(channel, statistics.channel_message_counts.get(id).copied().unwrap_or(0));
            }
            survey.topics.span = Some((statistics.message_start_time, statistics.message_end_time));
            match read_ending(&mut file, &summary) {
                Some(ending) => {
                    survey.dropped = NumberSet::parse(ending.get("frames").map_or("", String::as_str));
                    survey.ending = ending;
                }
                None if is_ours => survey.dropped = Self::from_messages(linear(input)?).dropped,
                None => {}
            }
            survey.summary = Some(summary);
            return Ok(survey);
        }
        // A truncated file has no summary; the messages tell what it was.
        Ok(Self::from_messages(linear(input)?))
    }

    fn from_messages(messages: Messages) -> Self {
        let mut survey = Self::default();
        // What is damaged is told when frames are taken.
        for message in messages.flatten() {
            survey.count(&message.channel, 1);
            survey.topics.at(message.log_time);
            if message.channel.topic == DROPPED_TOPIC
                && let Some(number) = dropped_number(&message.data)
            {
                survey.dropped.insert(number);
            }
        }
        survey
    }

    fn count(&mut self, channel: &mcap::Channel, messages: u64) {
        let schema = channel.schema.as_ref().map_or("", |schema| &schema.name);
        self.topics.count(&channel.topic, schema, content(channel), messages);
    }
}

/// The content of a channel's messages.
pub fn content(channel: &mcap::Channel) -> Option<Content> {
    Content::of(&channel.schema.as_ref()?.name, &channel.message_encoding)
}

/// The index of a file; `None` where it has none that could be read.
///
/// # Errors
/// When the file cannot be opened.
pub fn summary(input: &Input) -> Result<Option<mcap::Summary>> {
    let (mut file, size) = input.open()?;
    Ok(read_summary(&mut file, size).ok().flatten())
}

fn read_summary(file: &mut BufReader<Box<dyn Bytes>>, size: u64) -> Result<Option<mcap::Summary>, McapError> {
    let options = SummaryReaderOptions::default().with_file_size(size).with_record_length_limit(MAX_BYTES);
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

/// The recorder's metadata at the end.
fn read_ending(
    file: &mut BufReader<Box<dyn Bytes>>,
    summary: &mcap::Summary,
) -> Option<BTreeMap<String, String>> {
    /// Longer than the numbers of any recording.
    const LONGEST: u64 = 64 << 20;
    let index = summary.metadata_indexes.iter().find(|index| index.name == DROPPED_METADATA)?;
    let body = index.length.checked_sub(9).filter(|&length| length < LONGEST)?;
    file.seek(SeekFrom::Start(index.offset)).ok()?;
    let mut record = Vec::new();
    file.take(body + 9).read_to_end(&mut record).ok()?;
    match mcap::parse_record(*record.first()?, record.get(9..)?) {
        Ok(Record::Metadata(metadata)) if metadata.name == DROPPED_METADATA => Some(metadata.metadata),
        _ => None,
    }
}
