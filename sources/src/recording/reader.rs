//! The description of a recording, and the frames that its run dropped.

use super::calibration::{CalibrationFiles, NamedFile};
use super::{HEAD_METADATA, LAG, PROFILE};
use mcap::records::Record;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::io::Read;

/// The head of a recording, before its first frame.
#[derive(Clone, Debug, Default)]
pub struct RecordedHead {
    /// Whether loopbox wrote it, so that frames are numbered.
    pub is_ours: bool,
    /// Its metadata: `source`, `kind`.
    pub about: BTreeMap<String, String>,
    /// The files of the calibration.
    pub calibration: CalibrationFiles,
}

/// Reads an MCAP file up to its first chunk. Damaged or missing entries are left out: the head of a foreign file is
/// empty.
pub fn read_head(mut file: impl Read, record_limit: usize) -> RecordedHead {
    let mut head = RecordedHead::default();
    let options =
        LinearReaderOptions::default().with_emit_chunks(true).with_record_length_limit(record_limit);
    let mut reader = LinearReader::new_with_options(options);
    while let Some(Ok(event)) = reader.next_event() {
        match event {
            LinearReadEvent::ReadRequest(count) => match file.read(reader.insert(count)) {
                Ok(read) => reader.notify_read(read),
                Err(_) => break,
            },
            LinearReadEvent::Record { opcode, data } => match mcap::parse_record(opcode, data) {
                Ok(Record::Header(header)) if header.profile != PROFILE => break,
                Ok(record) => {
                    if !head.take(record) {
                        break;
                    }
                }
                Err(_) => break,
            },
        }
    }
    head
}

impl RecordedHead {
    /// The number of frames that the mapping of the recorded run took; `None` if it is not the recording of a run.
    pub fn lag(&self) -> Option<usize> {
        self.about.get(LAG)?.parse().ok()
    }

    /// Takes what the record says; false at the first that is none of the head.
    fn take(&mut self, record: Record) -> bool {
        match record {
            Record::Header(_) => self.is_ours = true,
            Record::Metadata(metadata) if metadata.name == HEAD_METADATA => self.about = metadata.metadata,
            Record::Metadata(_) => {}
            Record::Attachment { header, data, .. } => {
                let Some((role, name)) = header.name.split_once('/') else { return true };
                let place = match role {
                    "camera" => &mut self.calibration.camera,
                    "response" => &mut self.calibration.response,
                    "vignette" => &mut self.calibration.vignette,
                    _ => return true,
                };
                *place = Some(NamedFile { name: name.into(), bytes: data.into_owned() });
            }
            _ => return false,
        }
        true
    }
}

#[derive(Deserialize)]
struct Dropped {
    frame: u32,
}

/// The frame that a message on the topic of dropped frames names.
pub fn dropped_number(data: &[u8]) -> Option<u32> {
    serde_json::from_slice::<Dropped>(data).ok().map(|dropped| dropped.frame)
}
