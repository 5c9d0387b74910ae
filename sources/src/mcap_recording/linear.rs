//! The messages of an MCAP file in its order, past whatever is damaged in it.
//!
//! The crate `mcap` stops at the first damage. Records have their length, and the index has the position of every
//! chunk, so that a damaged chunk costs its own content and no more. Checksums of chunks are compared. A chunk whose
//! checksum fails is reported, and as much of it is read as possible.

use crate::input::{Bytes, Input};
use crate::salvage::{Found, Pieces};
use anyhow::Result;
use geometry::limits::MAX_BYTES;
use mcap::records::{ChunkHeader, Record, op};
use mcap::{Channel, McapError, McapResult, Message, Schema, parse_record};
use std::borrow::Cow;
use std::collections::HashMap;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::sync::Arc;

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Bytes of a record before its content: what it is, and how long.
const HEADER: u64 = 9;

/// Messages in the order of the file. An error is a damage, after which there may be more messages.
pub struct Linear {
    file: BufReader<Box<dyn Bytes>>,
    size: u64,
    /// Where the next record begins.
    position: u64,
    /// Chunks by where they begin, and how long they are, as far as an index says.
    chunks: Vec<(u64, u64)>,
    schemas: HashMap<u16, Arc<Schema<'static>>>,
    channels: HashMap<u16, Arc<Channel<'static>>>,
    found: Found<Message<'static>, McapError>,
    content: Vec<u8>,
}

impl Linear {
    /// Opens a file, with its index where there is one.
    ///
    /// # Errors
    /// When it cannot be opened.
    pub fn open(input: &Input, summary: Option<&mcap::Summary>) -> Result<Self> {
        let (file, size) = input.open()?;
        let (mut chunks, mut channels) = (Vec::new(), HashMap::new());
        if let Some(summary) = summary {
            chunks = summary.chunk_indexes.iter().map(|c| (c.chunk_start_offset, c.chunk_length)).collect();
            chunks.sort_unstable();
            channels.clone_from(&summary.channels);
        }
        Ok(Self {
            file,
            size,
            position: 0,
            chunks,
            schemas: HashMap::new(),
            channels,
            found: Found::default(),
            content: Vec::new(),
        })
    }

    /// Whether the index says the same of the chunk that begins here, where it says anything.
    fn agrees_with_index(&self, opcode: u8, length: u64) -> bool {
        match self.chunks.binary_search_by_key(&self.position, |(start, _)| *start) {
            Ok(place) => opcode == op::CHUNK && self.chunks[place].1 == HEADER + length,
            Err(_) => true,
        }
    }

    /// The end of the file, whose summary and magic tell that its recorder ended it.
    fn check_end(&mut self) -> McapResult<()> {
        let mut magic = [0; MAGIC.len()];
        let start = self.size.saturating_sub(MAGIC.len() as u64);
        self.file.seek(SeekFrom::Start(start))?;
        self.file.read_exact(&mut magic).map_err(|_| McapError::UnexpectedEof)?;
        if magic == MAGIC { Ok(()) } else { Err(McapError::UnexpectedEof) }
    }

    /// Goes on inside a chunk that is too large to be held; it must not be compressed.
    fn enter_chunk(&mut self, length: u64) -> McapResult<()> {
        let mut start = vec![0; 64.min(length as usize)];
        self.file.read_exact(&mut start)?;
        let Some((header, records)) =
            chunk_header(&start).filter(|(header, _)| header.compression.is_empty())
        else {
            self.position += HEADER + length;
            self.file.seek(SeekFrom::Start(self.position))?;
            return Err(McapError::ChunkTooLarge(length));
        };
        drop(header);
        self.position += HEADER + records as u64;
        self.file.seek(SeekFrom::Start(self.position))?;
        Ok(())
    }

    /// Takes what a chunk holds, as far as it can be read.
    fn take_chunk(&mut self, chunk: &[u8]) -> McapResult<()> {
        let (header, start) = chunk_header(chunk).ok_or(McapError::UnexpectedEoc)?;
        let packed = &chunk[start.min(chunk.len())..];
        let is_cut = (packed.len() as u64) < header.compressed_size;
        let packed = &packed[..packed.len().min(header.compressed_size as usize)];
        let (records, unpacked) = unpack(&header, packed);
        if is_cut {
            return self.take_records(&records).and(Err(McapError::UnexpectedEof));
        }
        let saved = header.uncompressed_crc;
        let calculated = if saved == 0 || unpacked.is_err() { saved } else { crc32fast::hash(&records) };
        let checked =
            if saved == calculated { unpacked } else { Err(McapError::BadChunkCrc { saved, calculated }) };
        // One wrong bit of what was packed may spoil all of it.
        if checked.is_err() && !header.compression.is_empty() {
            return checked;
        }
        let read = self.take_records(&records);
        checked.and(read)
    }

    fn take_records(&mut self, mut records: &[u8]) -> McapResult<()> {
        while let Some((header, rest)) = records.split_first_chunk::<{ HEADER as usize }>() {
            let [opcode, length @ ..] = *header;
            let length = usize::try_from(u64::from_le_bytes(length)).map_err(|_| McapError::UnexpectedEoc)?;
            let (content, rest) = rest.split_at_checked(length).ok_or(McapError::UnexpectedEoc)?;
            self.take(opcode, content)?;
            records = rest;
        }
        if records.is_empty() { Ok(()) } else { Err(McapError::UnexpectedEoc) }
    }

    /// Takes what a record says.
    fn take(&mut self, opcode: u8, content: &[u8]) -> McapResult<()> {
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            return Ok(());
        }
        match parse_record(opcode, content)? {
            Record::Schema { header, data } => {
                let data = Cow::Owned(data.into_owned());
                let (name, encoding) = (header.name, header.encoding);
                self.schemas.insert(header.id, Arc::new(Schema { id: header.id, name, encoding, data }));
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).cloned();
                // An index that is whole knows the schema of a channel whose own record is damaged.
                if schema.is_some() || !self.channels.contains_key(&channel.id) {
                    let about = Channel {
                        id: channel.id,
                        topic: channel.topic,
                        schema,
                        message_encoding: channel.message_encoding,
                        metadata: channel.metadata,
                    };
                    self.channels.insert(channel.id, Arc::new(about));
                }
            }
            Record::Message { header, data } => {
                let unknown = McapError::UnknownChannel(header.sequence, header.channel_id);
                let channel = Arc::clone(self.channels.get(&header.channel_id).ok_or(unknown)?);
                self.found.messages.push_back(Message {
                    channel,
                    sequence: header.sequence,
                    log_time: header.log_time,
                    publish_time: header.publish_time,
                    data: Cow::Owned(data.into_owned()),
                });
            }
            _ => {}
        }
        Ok(())
    }
}

impl Pieces for Linear {
    type Message = Message<'static>;
    type Damage = McapError;

    fn advance(&mut self) -> McapResult<bool> {
        if self.position == 0 {
            let mut magic = [0; MAGIC.len()];
            self.file.read_exact(&mut magic).map_err(|_| McapError::UnexpectedEof)?;
            if magic != MAGIC {
                return Err(McapError::BadMagic);
            }
            self.position = MAGIC.len() as u64;
        }
        let mut header = [0; HEADER as usize];
        self.file.read_exact(&mut header).map_err(|_| McapError::UnexpectedEof)?;
        let [opcode, length @ ..] = header;
        let length = u64::from_le_bytes(length);
        let left = self.size.saturating_sub(self.position + HEADER);
        let is_whole = length <= left && self.agrees_with_index(opcode, length);
        match opcode {
            op::DATA_END | op::FOOTER => return self.check_end().map(|()| false),
            op::CHUNK if is_whole && length > MAX_BYTES as u64 => {
                return self.enter_chunk(length).map(|()| true);
            }
            _ => {}
        }
        if !matches!(opcode, op::HEADER..=op::DATA_END | 0x80..) {
            return Err(McapError::BadIndex);
        }
        if opcode != op::CHUNK && (!is_whole || length > MAX_BYTES as u64) {
            return Err(McapError::UnexpectedEof);
        }
        let mut content = std::mem::take(&mut self.content);
        content.clear();
        let wanted = length.min(left).min(MAX_BYTES as u64);
        self.file.by_ref().take(wanted).read_to_end(&mut content)?;
        let taken = if opcode == op::CHUNK { self.take_chunk(&content) } else { self.take(opcode, &content) };
        self.content = content;
        if is_whole {
            self.position += HEADER + length;
            self.found.damage = taken.err();
            return Ok(true);
        }
        taken.and(Err(McapError::UnexpectedEof))
    }

    fn go_on(&mut self) -> bool {
        let next = self.chunks.partition_point(|(start, _)| *start <= self.position);
        let Some((start, _)) = self.chunks.get(next).filter(|(start, _)| *start < self.size) else {
            return false;
        };
        self.position = *start;
        self.file.seek(SeekFrom::Start(*start)).is_ok()
    }

    fn found(&mut self) -> &mut Found<Self::Message, McapError> {
        &mut self.found
    }
}

impl Iterator for Linear {
    type Item = McapResult<Message<'static>>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_message()
    }
}

/// The header of a chunk, and where its records begin.
fn chunk_header(chunk: &[u8]) -> Option<(ChunkHeader, usize)> {
    let number = |at: usize| Some(u64::from_le_bytes(chunk.get(at..at + 8)?.try_into().ok()?));
    let short = |at: usize| Some(u32::from_le_bytes(chunk.get(at..at + 4)?.try_into().ok()?));
    let name = chunk.get(32..32 + usize::try_from(short(28)?).ok().filter(|length| *length < 64)?)?;
    let start = 32 + name.len();
    let header = ChunkHeader {
        message_start_time: number(0)?,
        message_end_time: number(8)?,
        uncompressed_size: number(16)?,
        uncompressed_crc: short(24)?,
        compression: std::str::from_utf8(name).ok()?.to_owned(),
        compressed_size: number(start)?,
    };
    Some((header, start + 8))
}

/// The records of a chunk, as far as they can be unpacked.
fn unpack<'a>(header: &ChunkHeader, packed: &'a [u8]) -> (Cow<'a, [u8]>, McapResult<()>) {
    if header.uncompressed_size > MAX_BYTES as u64 && !header.compression.is_empty() {
        return (Cow::Borrowed(&[]), Err(McapError::ChunkTooLarge(header.uncompressed_size)));
    }
    let mut records = Vec::new();
    let read = match header.compression.as_str() {
        "" => return (Cow::Borrowed(packed), Ok(())),
        "zstd" => zstd::Decoder::new(packed)
            .and_then(|decoder| decoder.take(header.uncompressed_size).read_to_end(&mut records)),
        "lz4" => lz4::Decoder::new(packed)
            .and_then(|decoder| decoder.take(header.uncompressed_size).read_to_end(&mut records)),
        other => return (Cow::Borrowed(&[]), Err(McapError::UnsupportedCompression(other.to_owned()))),
    };
    let read = read.map(|_| ()).map_err(|error| McapError::DecompressionError(error.to_string()));
    (Cow::Owned(records), read)
}

#[cfg(test)]
#[path = "linear_tests.rs"]
mod tests;
