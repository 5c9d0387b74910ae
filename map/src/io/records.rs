//! The intact records of an MCAP file.

use geometry::limits::MAX_BYTES;
use mcap::McapError;
use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::io::{self, Read};

/// Why reading records came to its end before the file's.
#[derive(Debug)]
pub(super) enum Stop<E> {
    /// The bytes make no sense from here on, or end.
    Damaged(McapError),
    /// The system could not read on.
    Failed(io::Error),
    /// The callback refused a record.
    Refused(E),
}

/// Gives each record of a file of `length` bytes to `take`, chunks unpacked are for
/// [`read_chunk`].
pub(super) fn read_file<E>(
    source: &mut impl Read,
    length: u64,
    take: &mut impl FnMut(u8, &[u8]) -> Result<(), E>,
) -> Result<(), Stop<E>> {
    let options = LinearReaderOptions::default()
        .with_emit_chunks(true)
        .with_validate_data_section_crc(true)
        // No record is longer than the file: a damaged length does not ask for more memory.
        .with_record_length_limit(usize::try_from(length).unwrap_or(usize::MAX).min(MAX_BYTES));
    read(LinearReader::new_with_options(options), source, take)
}

/// Gives each record of a chunk to `take`, after the chunk's checksum was found right.
pub(super) fn read_chunk<E>(
    chunk: &[u8],
    take: &mut impl FnMut(u8, &[u8]) -> Result<(), E>,
) -> Result<(), Stop<E>> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(MAX_BYTES);
    let length = (chunk.len() as u64).to_le_bytes();
    let mut source = [op::CHUNK].chain(&length[..]).chain(chunk);
    read(LinearReader::new_with_options(options), &mut source, take)
}

/// Feeds the reader from a source and gives away what it finds.
fn read<E>(
    mut reader: LinearReader,
    source: &mut impl Read,
    take: &mut impl FnMut(u8, &[u8]) -> Result<(), E>,
) -> Result<(), Stop<E>> {
    while let Some(event) = reader.next_event() {
        match event.map_err(Stop::Damaged)? {
            LinearReadEvent::ReadRequest(wanted) => match source.read(reader.insert(wanted)) {
                Ok(count) => reader.notify_read(count),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(Stop::Failed(error)),
            },
            LinearReadEvent::Record { data, opcode } => take(opcode, data).map_err(Stop::Refused)?,
        }
    }
    Ok(())
}
