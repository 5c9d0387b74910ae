//! Bags read record by record.

use super::fields::Fields;
use super::{BAG_HEADER, CHUNK, CHUNK_INFO, CONNECTION, MAGIC, MESSAGE};
use crate::salvage::{Found, Pieces};
use anyhow::{Context, Result, bail, ensure};
use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::sync::Arc;

const ENDS_EARLY: &str = "a record ends early";

/// A record: fields, and what they are about.
struct Record {
    header: Vec<u8>,
    data: Vec<u8>,
    /// Whether the data are all there.
    is_whole: bool,
}

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

/// The content of a bag by its index.
#[derive(Clone, Debug, Default)]
pub struct Content {
    /// Each connection with the number of its messages.
    pub connections: Vec<(Arc<Connection>, u64)>,
    /// Times of the first and last message, nanoseconds.
    pub span: Option<(u64, u64)>,
}

/// Reads the messages of a bag in the order of the file, whether it has an index or not, past what is damaged in it.
pub struct BagReader<R> {
    file: R,
    /// The longest record to believe in.
    limit: usize,
    index_position: u64,
    position: u64,
    connections: BTreeMap<u32, Arc<Connection>>,
    /// Where chunks begin, as far as an index says.
    chunks: Vec<u64>,
    found: Found<Message, anyhow::Error>,
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
            chunks: Vec::new(),
            found: Found::default(),
        };
        let record = reader.record()?.context("it ends early")?;
        let fields = Fields::parse(&record.header)?;
        if fields.op()? != BAG_HEADER {
            bail!("it does not start with a bag's header");
        }
        reader.index_position = fields.u64("index_pos")?;
        Ok(reader)
    }

    /// The content by the index at the end; `None` without a usable one. Messages can be read afterwards.
    pub fn content(&mut self) -> Option<Content> {
        let start = self.position;
        let content = (self.index_position >= start).then(|| self.read_index()).and_then(Result::ok);
        self.go_to(start).ok()?;
        content
    }

    fn go_to(&mut self, position: u64) -> Result<()> {
        self.position = self.file.seek(SeekFrom::Start(position))?;
        Ok(())
    }

    fn read_index(&mut self) -> Result<Content> {
        self.position = self.file.seek(SeekFrom::Start(self.index_position))?;
        let (mut counts, mut span) = (BTreeMap::<u32, u64>::new(), None);
        let (mut connections, mut chunks) = (BTreeMap::new(), Vec::new());
        while let Some(Record { header, data, is_whole }) = self.record()? {
            ensure!(is_whole, ENDS_EARLY);
            let fields = Fields::parse(&header)?;
            match fields.op()? {
                CONNECTION => drop(connections.insert(fields.u32("conn")?, connection(&fields, &data)?)),
                CHUNK_INFO => {
                    chunks.push(fields.u64("chunk_pos")?);
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
        chunks.sort_unstable();
        self.chunks = chunks;
        let count = |id| counts.get(&id).copied().unwrap_or(0);
        let connections =
            connections.into_iter().map(|(id, c)| (id, Arc::new(c))).collect::<BTreeMap<_, _>>();
        // A connection whose own record is damaged is known from the index.
        self.connections.extend(connections.iter().map(|(id, connection)| (*id, Arc::clone(connection))));
        let connections = connections.into_iter().map(|(id, c)| (c, count(id))).collect();
        Ok(Content { connections, span })
    }

    /// The next record; `None` at the end of the file.
    fn record(&mut self) -> Result<Option<Record>> {
        let Some((header, is_whole)) = self.block()? else { return Ok(None) };
        ensure!(is_whole, ENDS_EARLY);
        let (data, is_whole) = self.block()?.context(ENDS_EARLY)?;
        Ok(Some(Record { header, data, is_whole }))
    }

    /// A length and so many bytes, and whether they are all there; `None` at the end of the file.
    fn block(&mut self) -> Result<Option<(Vec<u8>, bool)>> {
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
        self.position += 4 + block.len() as u64;
        let is_whole = block.len() == length;
        Ok(Some((block, is_whole)))
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
                    self.found.messages.push_back(Message {
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

impl<R: Read + Seek> Pieces for BagReader<R> {
    type Message = Message;
    type Damage = anyhow::Error;

    fn advance(&mut self) -> Result<bool> {
        // Behind the index position there are only connections and chunk infos.
        if self.index_position != 0 && self.position == self.index_position {
            return Ok(false);
        }
        let start = self.position;
        let record = self.record();
        if record.is_err() {
            // Where it begins tells which chunk is the next.
            self.position = start;
        }
        let Some(Record { header, data, is_whole }) = record? else {
            if self.index_position == 0 {
                bail!("its recorder did not end it");
            }
            bail!("it ends before its index");
        };
        let fields = Fields::parse(&header).inspect_err(|_| self.position = start)?;
        match fields.op().inspect_err(|_| self.position = start)? {
            CHUNK => {
                let (records, unpacked) = unpack(&fields, data, self.limit)?;
                let read = self.take_chunk(&records);
                self.found.damage = unpacked.and(read).err();
            }
            CONNECTION if is_whole => self.found.damage = self.take_connection(&fields, &data).err(),
            _ => {}
        }
        if !is_whole {
            // What was there of it is taken; where it begins tells which chunk is the next.
            self.position = start;
            bail!(ENDS_EARLY);
        }
        Ok(true)
    }

    fn go_on(&mut self) -> bool {
        let next = self.chunks.partition_point(|start| *start <= self.position);
        self.chunks.get(next).copied().is_some_and(|start| self.go_to(start).is_ok())
    }

    fn found(&mut self) -> &mut Found<Message, anyhow::Error> {
        &mut self.found
    }
}

impl<R: Read + Seek> Iterator for BagReader<R> {
    type Item = Result<Message>;

    fn next(&mut self) -> Option<Result<Message>> {
        self.next_message()
    }
}

fn connection(fields: &Fields, data: &[u8]) -> Result<Connection> {
    Ok(Connection { topic: fields.text("topic")?, kind: Fields::parse(data)?.text("type")? })
}

fn split_block(bytes: &[u8]) -> Result<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk::<4>().context("a chunk ends early")?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize).context("a chunk ends early")
}

/// The records of a chunk, as far as they can be unpacked.
fn unpack(fields: &Fields, data: Vec<u8>, limit: usize) -> Result<(Vec<u8>, Result<()>)> {
    let size = fields.u32("size")? as usize;
    if size > limit {
        bail!("a chunk claims {size} bytes");
    }
    let mut unpacked = Vec::new();
    let read = match fields.text("compression")?.as_str() {
        "none" => return Ok((data, Ok(()))),
        "lz4" => lz4::Decoder::new(data.as_slice())?.take(size as u64).read_to_end(&mut unpacked),
        "bz2" => bzip2_rs::DecoderReader::new(data.as_slice()).take(size as u64).read_to_end(&mut unpacked),
        other => bail!("the compression '{other}' is not known (none, bz2 and lz4 are)"),
    };
    Ok((unpacked, read.map(|_| ()).context("a chunk does not unpack")))
}
