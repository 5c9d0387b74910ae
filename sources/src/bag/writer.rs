//! Bags written: uncompressed chunks with index, connections and chunk infos at the end.

use super::fields::{format, format_time};
use super::{BAG_HEADER, CHUNK, CHUNK_INFO, CONNECTION, INDEX_DATA, MAGIC, MESSAGE};
use std::io::{self, Seek, SeekFrom, Write};

/// A chunk ends here.
const CHUNK_BYTES: usize = 4 << 20;
/// Length of the bag's header record, padding included, as the format wants it.
const HEADER_BYTES: usize = 4096;

/// A type of message with its definition in a bag.
#[derive(Clone, Copy, Debug)]
pub struct MessageType {
    /// As `sensor_msgs/Image`.
    pub name: &'static str,
    /// Checksum of the definition, as ROS makes it.
    pub md5sum: &'static str,
    /// The definition with those it uses.
    pub definition: &'static str,
}

struct ChunkInfo {
    position: u64,
    start: u64,
    end: u64,
    counts: Vec<(u32, u32)>,
}

/// Writes a bag.
pub struct BagWriter<W> {
    out: W,
    connections: Vec<(&'static str, MessageType)>,
    chunk: Vec<u8>,
    /// `(connection, time, offset in the chunk)` of the messages of the open chunk.
    index: Vec<(u32, u64, u32)>,
    chunks: Vec<ChunkInfo>,
}

impl<W: Write + Seek> BagWriter<W> {
    /// Begins a bag.
    ///
    /// # Errors
    /// When the stream cannot be written to.
    pub fn create(mut out: W) -> io::Result<Self> {
        out.write_all(MAGIC)?;
        out.write_all(&bag_header(0, 0, 0))?;
        Ok(Self { out, connections: Vec::new(), chunk: Vec::new(), index: Vec::new(), chunks: Vec::new() })
    }

    /// Adds a connection; its number.
    pub fn connect(&mut self, topic: &'static str, kind: MessageType) -> u32 {
        let id = self.connections.len() as u32;
        self.connections.push((topic, kind));
        let record = connection(id, topic, &kind);
        self.chunk.extend(record);
        id
    }

    /// Writes a message received at `time` (nanoseconds).
    ///
    /// # Errors
    /// When the stream cannot be written to.
    pub fn message(&mut self, connection: u32, time: u64, data: &[u8]) -> io::Result<()> {
        self.index.push((connection, time, self.chunk.len() as u32));
        let fields =
            [("op", &[MESSAGE][..]), ("conn", &connection.to_le_bytes()), ("time", &format_time(time))];
        self.chunk.extend(record(&fields, data));
        if self.chunk.len() >= CHUNK_BYTES { self.end_chunk() } else { Ok(()) }
    }

    fn end_chunk(&mut self) -> io::Result<()> {
        let (Some(start), Some(end)) =
            (self.index.iter().map(|entry| entry.1).min(), self.index.iter().map(|entry| entry.1).max())
        else {
            return Ok(());
        };
        let position = self.out.stream_position()?;
        let size = (self.chunk.len() as u32).to_le_bytes();
        let fields = [("op", &[CHUNK][..]), ("compression", b"none"), ("size", &size)];
        self.out.write_all(&record(&fields, &self.chunk))?;
        let mut counts = Vec::new();
        for id in 0..self.connections.len() as u32 {
            let entries = self.index.iter().filter(|entry| entry.0 == id);
            let data: Vec<u8> = entries
                .flat_map(|&(_, time, at)| [&format_time(time)[..], &at.to_le_bytes()].concat())
                .collect();
            let count = (data.len() / 12) as u32;
            if count == 0 {
                continue;
            }
            let (ver, conn, number) = (1u32.to_le_bytes(), id.to_le_bytes(), count.to_le_bytes());
            let fields = [("op", &[INDEX_DATA][..]), ("ver", &ver), ("conn", &conn), ("count", &number)];
            self.out.write_all(&record(&fields, &data))?;
            counts.push((id, count));
        }
        self.chunks.push(ChunkInfo { position, start, end, counts });
        self.chunk.clear();
        self.index.clear();
        Ok(())
    }

    /// Ends the bag with its index.
    ///
    /// # Errors
    /// When the stream cannot be written to.
    pub fn finish(mut self) -> io::Result<W> {
        self.end_chunk()?;
        let index_position = self.out.stream_position()?;
        for (id, (topic, kind)) in self.connections.iter().enumerate() {
            self.out.write_all(&connection(id as u32, topic, kind))?;
        }
        for info in &self.chunks {
            let data: Vec<u8> =
                info.counts.iter().flat_map(|(id, n)| [id.to_le_bytes(), n.to_le_bytes()].concat()).collect();
            let fields = [
                ("op", &[CHUNK_INFO][..]),
                ("ver", &1u32.to_le_bytes()),
                ("chunk_pos", &info.position.to_le_bytes()),
                ("start_time", &format_time(info.start)),
                ("end_time", &format_time(info.end)),
                ("count", &(info.counts.len() as u32).to_le_bytes()),
            ];
            self.out.write_all(&record(&fields, &data))?;
        }
        self.out.seek(SeekFrom::Start(MAGIC.len() as u64))?;
        let header = bag_header(index_position, self.connections.len() as u32, self.chunks.len() as u32);
        self.out.write_all(&header)?;
        self.out.flush()?;
        Ok(self.out)
    }
}

fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let header = format(fields);
    let length = |bytes: &[u8]| (bytes.len() as u32).to_le_bytes();
    [&length(&header), header.as_slice(), &length(data), data].concat()
}

fn bag_header(index_position: u64, connections: u32, chunks: u32) -> Vec<u8> {
    let fields = [
        ("op", &[BAG_HEADER][..]),
        ("index_pos", &index_position.to_le_bytes()),
        ("conn_count", &connections.to_le_bytes()),
        ("chunk_count", &chunks.to_le_bytes()),
    ];
    // Both lengths count towards the record's.
    let padding = vec![b' '; HEADER_BYTES - 8 - format(&fields).len()];
    record(&fields, &padding)
}

fn connection(id: u32, topic: &str, kind: &MessageType) -> Vec<u8> {
    let data = format(&[
        ("topic", topic.as_bytes()),
        ("type", kind.name.as_bytes()),
        ("md5sum", kind.md5sum.as_bytes()),
        ("message_definition", kind.definition.as_bytes()),
    ]);
    record(&[("op", &[CONNECTION][..]), ("conn", &id.to_le_bytes()), ("topic", topic.as_bytes())], &data)
}
