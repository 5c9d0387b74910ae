//! Bags read record by record.

use super::fields::Fields;
use super::{BAG_HEADER, CHUNK, CHUNK_INFO, CONNECTION, MAGIC, MESSAGE};
use anyhow::{Context, Result, bail};
use std::collections::{BTreeMap, VecDeque};
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::sync::Arc;

/// A connection: messages of one type on one topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Connection {
    /// The topic.
    pub topic: String,
    /// The type of its messages, as `sensor_msgs/Image`.
    pub kind: String,
}

/// A message.
#[derive(Clone, Debug)]
pub struct Message {
    /// Where it was sent.
    pub connection: Arc<Connection>,
    /// When it was received, nanoseconds.
    pub time: u64,
    /// The bytes.
    pub data: Vec<u8>,
}

/// What a bag's index says.
#[derive(Clone, Debug, Default)]
pub struct Content {
    /// Each connection with the number of its messages.
    pub connections: Vec<(Arc<Connection>, u64)>,
    /// Times of the first and last message, nanoseconds.
    pub span: Option<(u64, u64)>,
}

/// Reads the messages of a bag in the order of the file, whether it has an index or not.
pub struct BagReader<R> {
    file: R,
    /// The longest record to believe in.
    limit: usize,
    index_position: u64,
    position: u64,
    connections: BTreeMap<u32, Arc<Connection>>,
    ready: VecDeque<Message>,
    ended: bool,
}

impl<R: Read + Seek> BagReader<R> {
    /// Begins to read; refuses records and chunks longer than `limit` bytes.
    ///
    /// # Errors
    /// When it is no bag of format 2.0.
    pub fn new(mut file: R, limit: usize) -> Result<Self> {
        let mut magic = [0; MAGIC.len()];
        file.read_exact(&mut magic).context("it ends early")?;
        if magic != MAGIC {
            bail!("it is no bag of format 2.0");
        }
        let mut reader = Self {
            file,
            limit,
            index_position: 0,
            position: MAGIC.len() as u64,
            connections: BTreeMap::new(),
            ready: VecDeque::new(),
            ended: false,
        };
        let (header, _padding) = reader.record()?.context("it ends early")?;
        let fields = Fields::parse(&header)?;
        if fields.op()? != BAG_HEADER {
            bail!("it does not start with a bag's header");
        }
        reader.index_position = fields.u64("index_pos")?;
        Ok(reader)
    }

    /// What the index at the end says; `None` without a usable one. Messages can be read afterwards.
    pub fn content(&mut self) -> Option<Content> {
        let start = self.position;
        let content = (self.index_position >= start).then(|| self.read_index()).and_then(Result::ok);
        self.position = start;
        self.file.seek(SeekFrom::Start(start)).ok()?;
        content
    }

    fn read_index(&mut self) -> Result<Content> {
        self.position = self.file.seek(SeekFrom::Start(self.index_position))?;
        let (mut counts, mut span) = (BTreeMap::<u32, u64>::new(), None);
        let mut connections = BTreeMap::new();
        while let Some((header, data)) = self.record()? {
            let fields = Fields::parse(&header)?;
            match fields.op()? {
                CONNECTION => drop(connections.insert(fields.u32("conn")?, connection(&fields, &data)?)),
                CHUNK_INFO => {
                    for pair in data.chunks_exact(8) {
                        let [id, count] = [&pair[..4], &pair[4..]]
                            .map(|half| u32::from_le_bytes(half.try_into().unwrap_or_default()));
                        *counts.entry(id).or_default() += u64::from(count);
                    }
                    let (start, end) = (fields.time("start_time")?, fields.time("end_time")?);
                    let (first, last) = span.unwrap_or((start, end));
                    span = Some((start.min(first), end.max(last)));
                }
                _ => bail!("a record that does not belong into the index"),
            }
        }
        if connections.is_empty() {
            bail!("the index is empty");
        }
        let count = |id| counts.get(&id).copied().unwrap_or(0);
        let connections = connections.into_iter().map(|(id, c)| (Arc::new(c), count(id))).collect();
        Ok(Content { connections, span })
    }

    /// The next record's header and data; `None` at the end of the file.
    fn record(&mut self) -> Result<Option<(Vec<u8>, Vec<u8>)>> {
        let Some(header) = self.block()? else { return Ok(None) };
        let data = self.block()?.context("a record ends early")?;
        Ok(Some((header, data)))
    }

    /// A length and so many bytes; `None` at the end of the file.
    fn block(&mut self) -> Result<Option<Vec<u8>>> {
        let mut length = [0; 4];
        match self.file.read_exact(&mut length) {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
            read => read?,
        }
        let length = u32::from_le_bytes(length) as usize;
        if length > self.limit {
            bail!("a record claims {length} bytes");
        }
        // Grows with what is there, whatever the length claims.
        let mut block = Vec::new();
        self.file.by_ref().take(length as u64).read_to_end(&mut block)?;
        if block.len() < length {
            bail!("a record ends early");
        }
        self.position += 4 + length as u64;
        Ok(Some(block))
    }

    /// Reads on until messages are ready; false at the end.
    fn advance(&mut self) -> Result<bool> {
        while self.ready.is_empty() {
            // Behind the index position there are only connections and chunk infos.
            if self.index_position != 0 && self.position == self.index_position {
                return Ok(false);
            }
            let Some((header, data)) = self.record()? else {
                if self.index_position == 0 {
                    bail!("its recorder did not end it");
                }
                bail!("it ends before its index");
            };
            let fields = Fields::parse(&header)?;
            match fields.op()? {
                CHUNK => {
                    let unpacked = unpack(&fields, data, self.limit)?;
                    self.take_chunk(&unpacked)?;
                }
                CONNECTION => self.take_connection(&fields, &data)?,
                _ => {}
            }
        }
        Ok(true)
    }

    fn take_connection(&mut self, fields: &Fields, data: &[u8]) -> Result<()> {
        self.connections.insert(fields.u32("conn")?, Arc::new(connection(fields, data)?));
        Ok(())
    }

    fn take_chunk(&mut self, mut chunk: &[u8]) -> Result<()> {
        while !chunk.is_empty() {
            let (header, data);
            (header, chunk) = split_block(chunk)?;
            (data, chunk) = split_block(chunk)?;
            let fields = Fields::parse(header)?;
            match fields.op()? {
                CONNECTION => self.take_connection(&fields, data)?,
                MESSAGE => {
                    let known = self.connections.get(&fields.u32("conn")?);
                    let connection = Arc::clone(known.context("a message of no connection")?);
                    self.ready.push_back(Message {
                        connection,
                        time: fields.time("time")?,
                        data: data.to_vec(),
                    });
                }
                _ => {}
            }
        }
        Ok(())
    }
}

impl<R: Read + Seek> Iterator for BagReader<R> {
    type Item = Result<Message>;

    /// The next message; after the first error, none.
    fn next(&mut self) -> Option<Result<Message>> {
        if let Some(message) = self.ready.pop_front() {
            return Some(Ok(message));
        }
        if self.ended {
            return None;
        }
        let advanced = self.advance();
        self.ended = !matches!(advanced, Ok(true));
        // What a damaged chunk held before the damage is whole.
        match (self.ready.pop_front(), advanced) {
            (Some(message), advanced) => {
                self.ended |= advanced.is_err();
                Some(Ok(message))
            }
            (None, Err(error)) => Some(Err(error)),
            (None, Ok(_)) => None,
        }
    }
}

fn connection(fields: &Fields, data: &[u8]) -> Result<Connection> {
    Ok(Connection { topic: fields.text("topic")?, kind: Fields::parse(data)?.text("type")? })
}

fn split_block(bytes: &[u8]) -> Result<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>().context("a chunk ends early")?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize).context("a chunk ends early")
}

fn unpack(fields: &Fields, data: Vec<u8>, limit: usize) -> Result<Vec<u8>> {
    let size = fields.u32("size")? as usize;
    if size > limit {
        bail!("a chunk claims {size} bytes");
    }
    let mut unpacked = Vec::new();
    let read = match fields.text("compression")?.as_str() {
        "none" => return Ok(data),
        "lz4" => lz4::Decoder::new(data.as_slice())?.take(size as u64).read_to_end(&mut unpacked),
        "bz2" => bzip2_rs::DecoderReader::new(data.as_slice()).take(size as u64).read_to_end(&mut unpacked),
        other => bail!("the compression '{other}' is not known (none, bz2 and lz4 are)"),
    };
    read.context("a chunk does not unpack")?;
    Ok(unpacked)
}
