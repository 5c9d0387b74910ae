//! The messages of an indexed MCAP file from a time on, without reading what lies before.

use crate::input::{Bytes, Input};
use anyhow::Result;
use geometry::limits::MAX_BYTES;
use mcap::sans_io::indexed_reader::{IndexedReadEvent, IndexedReader, IndexedReaderOptions, ReadOrder};
use mcap::{Channel, McapError, McapResult, Message};
use std::collections::HashMap;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::sync::Arc;

/// Messages in the order of the file.
pub struct MessagesFrom {
    file: BufReader<Box<dyn Bytes>>,
    size: u64,
    reader: IndexedReader,
    channels: HashMap<u16, Arc<Channel<'static>>>,
    ended: bool,
}

impl MessagesFrom {
    /// Messages of `topic` logged at `start` (nanoseconds) or after.
    ///
    /// # Errors
    /// When the file cannot be opened, or the index makes no sense.
    pub fn new(input: &Input, summary: &mcap::Summary, topic: &str, start: u64) -> Result<Self> {
        let (file, size) = input.open()?;
        let options = IndexedReaderOptions::new()
            .with_order(ReadOrder::File)
            .include_topics([topic])
            .starting_at(start)
            .with_record_length_limit(MAX_BYTES);
        let reader = IndexedReader::new_with_options(summary, options)?;
        Ok(Self { file, size, reader, channels: summary.channels.clone(), ended: false })
    }

    fn read(&mut self, offset: u64, length: usize) -> McapResult<()> {
        if offset.checked_add(length as u64).is_none_or(|end| end > self.size) {
            return Err(McapError::BadIndex);
        }
        self.file.seek(SeekFrom::Start(offset))?;
        let mut chunk = vec![0; length];
        self.file.read_exact(&mut chunk)?;
        self.reader.insert_chunk_record_data(offset, &chunk)
    }

    fn advance(&mut self) -> Option<McapResult<Message<'static>>> {
        loop {
            let (offset, length) = match self.reader.next_event()? {
                Err(error) => return Some(Err(error)),
                Ok(IndexedReadEvent::ReadChunkRequest { offset, length }) => (offset, length),
                Ok(IndexedReadEvent::Message { header, data }) => {
                    let Some(channel) = self.channels.get(&header.channel_id) else { continue };
                    return Some(Ok(Message {
                        channel: Arc::clone(channel),
                        sequence: header.sequence,
                        log_time: header.log_time,
                        publish_time: header.publish_time,
                        data: data.to_vec().into(),
                    }));
                }
            };
            if let Err(error) = self.read(offset, length) {
                return Some(Err(error));
            }
        }
    }
}

impl Iterator for MessagesFrom {
    type Item = McapResult<Message<'static>>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let next = self.advance();
        self.ended = !matches!(next, Some(Ok(_)));
        next
    }
}
